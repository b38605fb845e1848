"""Whether a solution with Coulomb friction is known to be the only one near it.

With the bound b of friction given, the contact forces ``lambda(b)`` are unique, and a solution with Coulomb
friction is a fixed point of ``b -> F lambda(b)``. Where the spectral radius of its derivative is below one,
the solution is alone in a neighbourhood, and it follows small changes of the data. For small F the map
contracts everywhere and there is one solution (J. Haslinger, Approximation of the Signorini problem with
friction, obeying the Coulomb law, Math. Methods Appl. Sci. 5 (1983) 422-437); for large F there may be many.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.contact.sensitivity import TangentResponse
from rmesh_nlp.contact.system import ContactSystem, Equilibrium


def contraction(system: ContactSystem, state: Equilibrium) -> float:
    """Spectral radius of the derivative of ``F lambda(b)`` at a solution, its active set held."""
    if system.coulomb is None:
        return 0.0
    active = state.active
    bounded = replace(system, slip_bound=system.bound(state.normal_force), coulomb=None)
    slides = np.flatnonzero(active.touching & (active.sliding != 0) & (system.coulomb > 0))
    if slides.size == 0:
        return 0.0
    # the friction of a sliding node is -s b: the force out of balance rises by s
    force = bounded.tangents[slides].T.toarray() * active.sliding[slides]
    none = np.zeros((system.offset.size, slides.size))
    _, normal, _ = TangentResponse(bounded, active)(force, none, none)
    change = system.coulomb[slides, None] * normal[slides]
    return float(np.max(np.abs(np.linalg.eigvals(change))))
