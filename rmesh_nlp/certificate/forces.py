"""Bounds of normal forces, and of other slopes of least energies, from bounds of energies.

Let P be a convex function with ``lower <= P(0)`` and ``P(s) <= upper(s)``. For every s > 0 a slope R of P
at 0 obeys

    (lower - upper(-s)) / s  <=  R  <=  (upper(s) - lower) / s.

- Normal force: P(s) is the least energy with the foundation raised by s along its normal, so that ``n . v +
  offset - s >= 0``. The dual energy is ``D(sigma) + s int p`` then, so P is convex, and its slope is that of
  the exact solution, ``int p``. ``upper(s)`` is the energy of a displacement that is admissible there.
- Linear quantity Q: P(s) is minus the least energy under a load more, whose work is ``s Q(v)``. That energy
  is the least of functions that are affine in s, so P is convex, and its slope is Q of the exact solution.
  ``-upper(s)`` is a lower bound of the energy under the load, ``-lower`` an upper one without it.

With a gap g between the bounds each side is off by about ``g / s + s P'' / 2``, least for
``s = (2 g / P'')^(1/2)``. Any s is valid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.evaluation import ROUNDING, magnitude
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Place
from rmesh_nlp.problem.data import ContactSet


def force_bounds(exact: Admissible, lower: float) -> dict[str, tuple[float, float]]:
    """Lower and upper bounds of the normal force by contact boundary, infinite where there is none.

    ``exact`` is an admissible displacement of a problem without level functions, ``lower`` a bound of the
    least energy. That of a tool is known if it moves along its normal.
    """
    if not exact.problem.obstacles:
        return {}
    continuous, active = exact.continuous, exact.state.active
    bounds, gap = {}, max(exact.energy - lower, ROUNDING * exact.strain)
    size = float(magnitude(exact.displacement) * np.sqrt(gap / max(exact.strain, 1e-300)))
    gaps = exact.system.normals @ exact.state.u + exact.system.offset
    for contact in continuous.space.contact_sets:
        if not contact.rows.size:  # every gap is given
            continue
        obstacle = contact.obstacle
        name = obstacle.boundary.value if isinstance(obstacle.boundary, Place) else obstacle.boundary
        if obstacle.force is not None and np.all(np.array(obstacle.moves) | (np.array(obstacle.normal) == 0)):
            bounds[name] = (float(np.dot(obstacle.force, obstacle.normal)),) * 2  # it is in equilibrium
            continue

        def upper(by: float, contact: ContactSet = contact) -> float:
            trial = continuous.shifted(contact, by).solve(active)
            return trial.energy + trial.doubt if trial.status is Status.CONVERGED else np.inf

        raised = exact.system.offset.copy()
        raised[contact.rows] -= 1.0
        force = exact.system.with_offset(raised).equilibrium(active).normal_force
        now = exact.state.normal_force[contact.rows]
        # where the load alone gives the force it is zero up to rounding, and s large, but not without limit
        least = ROUNDING * np.sum(now) ** 2 / gap
        touches = np.any(active.touching[contact.rows])
        bend = max(float(np.sum(force[contact.rows] - now)), least) if touches else 0.0
        flat = max(size, np.min(gaps[contact.rows]))
        low, high = slope_bounds(upper, lower, gap, bend, flat, continuous.room(contact))
        bounds[name] = max(low, 0.0), high
    return bounds


def slope_bounds(
    upper: Callable[[float], float], lower: float, gap: float, bend: float, flat: float, room: float = np.inf
) -> tuple[float, float]:
    """Bounds, from below and above, of the slope of P at 0.

    ``gap`` is that of the bounds at 0, ``bend`` P'' of the computed solution, ``flat`` the s where that is
    zero, and ``room`` the largest s above 0.
    """
    best = float(np.sqrt(2 * gap / bend)) if bend > 0 else flat
    bounds = []
    for side, s in ((-1, best), (1, min(best, room))):
        bounds.append(side * (upper(side * s) - lower) / s if s > 0 else side * np.inf)
    return float(bounds[0]), float(bounds[1])
