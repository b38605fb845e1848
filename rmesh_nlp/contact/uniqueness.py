"""Whether a solution with Coulomb friction is known to be the only one.

With the bound b of friction given, the contact forces ``lambda(b)`` are unique, and a solution with Coulomb
friction is a fixed point of ``b -> F lambda(b)``. For small F the map contracts everywhere and there is one
solution (J. Haslinger, Approximation of the Signorini problem with friction, obeying the Coulomb law, Math.
Methods Appl. Sci. 5 (1983) 422-437); for large F there may be many. The map is linear as long as the active
set stays. Its derivative vanishes where nothing slides, and a solution that sticks may have others that
slide: so the derivative is looked at with all nodes sliding, one way and the other, as well.

That is no proof: patterns that slide by turns one way and the other have a derivative up to four times as
large. A bound over all patterns by norms holds for F below 0.2 on 12 x 6 squares and 0.09 on 48 x 24 (Example
6.3), where the least F with several solutions that was found on small meshes is 3.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.contact.sensitivity import TangentResponse
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium


def contraction(system: ContactSystem, state: Equilibrium) -> float:
    """Largest spectral radius of the derivative of ``F lambda(b)``: as at a solution, and if all nodes slide.

    Gaps hold every body then: problems are refused in which they leave a rigid motion.
    """
    every = np.ones(system.offset.size, dtype=bool)
    all_slide = ActiveSet(every, np.ones(every.size, dtype=np.int8))  # either way: signs of all change
    return max(spectral_radius(system, active) for active in (state.active, all_slide))


def spectral_radius(system: ContactSystem, active: ActiveSet) -> float:
    """That of the derivative of ``F lambda(b)`` with an active set held."""
    if system.coulomb is None:
        return 0.0
    slides = np.flatnonzero(active.touching & (active.sliding != 0) & (system.coulomb > 0))
    if slides.size == 0:
        return 0.0
    bounded = replace(system, slip_bound=np.ones(system.offset.size), coulomb=None)
    respond, tangents = TangentResponse(bounded, active), bounded.tangents[slides]
    factor, way = system.coulomb[slides], active.sliding[slides]

    # friction is -s b, so the force out of balance rises by s with a bound
    none = np.zeros((system.offset.size, slides.size))
    normal = respond((tangents.T * way).toarray(), none, none)[1][slides]
    return float(np.max(np.abs(np.linalg.eigvals(factor[:, None] * normal))))
