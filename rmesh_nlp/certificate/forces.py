"""Bounds of the normal force on a foundation, from bounds of energies.

Let P(h) be the least energy with the foundation raised by h along its normal: ``n . v + offset - h >= 0``.
The dual energy is ``D(sigma) + h int p`` then, so P is convex, the normal force ``R = int p`` of the exact
solution is a subgradient at 0, and for every s > 0

    (lower - upper(-s)) / s  <=  R  <=  (upper(s) - lower) / s,

``lower`` a lower bound of P(0), ``upper(h)`` the energy of a displacement that is admissible for the raised
foundation. With a gap g between the bounds each side is off by about ``g / s + s P'' / 2``, least for
``s = (2 g / P'')^(1/2)``. Any s is valid.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, Continuous
from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Place
from rmesh_nlp.problem.data import ContactSet

TRIALS = 3
"""Lengths s that are tried on each side: from the relative error, and twice from the change of the force."""


def force_bounds(exact: Admissible, lower: float) -> dict[str, tuple[float, float]]:
    """Lower and upper bounds of the normal force by contact boundary, infinite where there is none.

    ``exact`` is an admissible displacement of a problem without level functions, ``lower`` a bound of the
    least energy.
    """
    if not exact.problem.obstacles:
        return {}
    continuous = Continuous(exact.parts, exact.body.nodes)
    bounds = {}
    for contact in continuous.space.contact_sets:
        if not contact.rows.size:  # every gap is given
            continue
        boundary = contact.obstacle.boundary
        name = boundary.value if isinstance(boundary, Place) else boundary
        below, above = (_bound(continuous, contact, exact, lower, side) for side in (-1, 1))
        bounds[name] = (max(below, 0.0), above)
    return bounds


def _bound(continuous: Continuous, contact: ContactSet, exact: Admissible, lower: float, side: int) -> float:
    """The best bound, from below (-1) or above (1), of the lengths that are tried."""
    room = continuous.room(contact) if side > 0 else np.inf
    best, active, force = np.inf, exact.state.active, _force(contact, exact)
    rounding = ROUNDING * exact.strain  # of energies
    gap = max(exact.energy - lower, rounding)
    s = float(np.max(np.abs(exact.displacement)) * np.sqrt(gap / max(exact.strain, 1e-300)))
    for _ in range(TRIALS):
        s = min(s, room)
        if not s > 0:
            break
        trial = continuous.shifted(contact, side * s).solve(active, tighten=False)
        active, last = trial.state.active, _force(contact, trial)
        if trial.status is Status.CONVERGED:
            best = min(best, (trial.energy + trial.doubt - lower) / s)
        # the energy changes by the work of the mean force
        gap = max(trial.energy - lower - side * s * (force + last) / 2, rounding)
        bend = side * (last - force) / s
        s = float(np.sqrt(2 * gap / bend)) if bend > 0 else 4 * s
    return float(side * best)


def _force(contact: ContactSet, found: Admissible) -> float:
    return float(np.sum(found.state.normal_force[contact.rows]))
