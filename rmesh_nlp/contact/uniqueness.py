"""Whether a solution with Coulomb friction is known to be the only one.

With the bound b of friction given, the contact forces ``lambda(b)`` are unique, and a solution with Coulomb
friction is a fixed point of ``b -> F lambda(b)``. For small F the map contracts everywhere and there is one
solution (J. Haslinger, Approximation of the Signorini problem with friction, obeying the Coulomb law, Math.
Methods Appl. Sci. 5 (1983) 422-437); for large F there may be many. The map is linear as long as the active
set stays. Its derivative vanishes where nothing slides, and a solution that sticks may have others that
slide or touch elsewhere: so the derivative is looked at with nodes sliding one way, as well, all of them and
those near the contact. Of 8,004 problems with two to six contact nodes and F from 1 to 6 93 have several
solutions; all of these have a derivative of at least one then.

That is no proof: patterns that slide by turns one way and the other have a derivative up to four times as
large. A bound over all patterns by norms holds for F below 0.2 on 12 x 6 squares and 0.09 on 48 x 24 (Example
6.3), where the least F with several solutions that was found on small meshes is 1.3.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from rmesh_nlp.contact.factorisation import Condensed
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, magnitude


def contraction(system: ContactSystem, state: Equilibrium) -> float:
    """Largest spectral radius of the derivative of ``F lambda(b)`` over active sets near a solution.

    These are that of the solution, and nodes that slide one way: every node, those that touch, and those with
    up to two nodes more or fewer at the ends of contact. Where only gaps hold a body every node touches:
    problems are refused in which that leaves a rigid motion.
    """
    if system.coulomb is None:
        return 0.0
    touching, nodes = state.active.touching, np.arange(system.offset.size)
    coupled = abs(system.normals @ system.stiffness @ system.normals.T) > 0
    gaps = system.normals @ state.u + system.offset
    nearest = nodes == np.argmin(gaps + state.normal_force)  # to a change, where all or none touch
    opens, closes = (coupled @ (beside | nearest) for beside in (~touching, touching))
    ends = np.flatnonzero(np.where(touching, opens, closes))
    changes = [few for size in range(3) for few in combinations(ends, size)]
    sets = [np.isin(nodes, few) ^ touching for few in changes if system.rigid is None]
    one_way, stiffness = np.ones(nodes.size, dtype=np.int8), condensed(system)  # signs of all change
    slide = [ActiveSet(each, one_way) for each in (one_way == 1, *sets)]
    return max(spectral_radius(system, stiffness, active) for active in (state.active, *slide))


def condensed(system: ContactSystem) -> Array:
    """(k, k) stiffness of gaps, and then of slips where friction acts, with all else free."""
    return Condensed(system.rotated.K, system.rotated.F, system.rotated.last).S


def spectral_radius(system: ContactSystem, stiffness: Array, active: ActiveSet) -> float:
    """That of the derivative of ``F lambda(b)`` with an active set held; ``stiffness`` is condensed."""
    assert system.coulomb is not None
    rotated = system.rotated
    slides = np.flatnonzero(active.touching & rotated.slips & (active.sliding != 0) & (system.coulomb > 0))
    if slides.size == 0:
        return 0.0
    free = np.flatnonzero(~np.append(active.touching, rotated.sticking(active)[rotated.slips]))
    slip = active.touching.size + np.searchsorted(np.flatnonzero(rotated.slips), slides)
    # friction is -s b, so the force on a slip falls by s with a bound
    force = np.zeros((stiffness.shape[0], slides.size))
    force[slip, np.arange(slides.size)] = -active.sliding[slides]
    change = np.linalg.solve(stiffness[np.ix_(free, free)], force[free])
    normal = stiffness[np.ix_(slides, free)] @ change
    return magnitude(np.linalg.eigvals(system.coulomb[slides, None] * normal))
