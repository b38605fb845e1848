"""Bounds of normal forces, and of other slopes of least energies, from bounds of energies.

Let P be a convex function with ``lower <= P(0)`` and ``P(s) <= upper(s)``. For every s > 0 a slope R of P
at 0 obeys

    (lower - upper(-s)) / s  <=  R  <=  (upper(s) - lower) / s.

- Integral of the pressure p times a weight phi, 1 for the normal force: P(s) is the least energy with the
  foundation raised by s phi along its normal, so that ``n . v + offset - s phi >= 0``. The dual energy is
  ``D(sigma) + s int p phi`` then, so P is convex, and its slope is that of the exact solution, ``int p phi``.
  ``upper(s)`` is the energy of a displacement that is admissible there.
- Linear quantity Q: P(s) is minus the least energy under a load more, whose work is ``s Q(v)``. That energy
  is the least of functions that are affine in s, so P is convex, and its slope is Q of the exact solution.
  ``-upper(s)`` is a lower bound of the energy under the load, ``-lower`` an upper one without it.

With a gap g between the bounds each side is off by about ``g / s + s P'' / 2``, least for
``s = (2 g / P'')^(1/2)``. Any s is valid.

An admissible displacement v obeys ``int p (n . v + offset) <= g``, so what acts where its gap is at least
``g / f`` is at most f.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.display import Spans
from rmesh_nlp.evaluation import ROUNDING, magnitude
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem.coefficients import Coefficient, at
from rmesh_nlp.problem.data import ContactSet


def force_bounds(
    exact: Admissible, lower: float, contact: ContactSet, weight: Coefficient = 1.0
) -> tuple[float, float]:
    """Bounds, from below and above, of the integral of the pressure of a contact set times a weight.

    ``exact`` is an admissible displacement, ``lower`` a bound of the least energy. A bound is infinite where
    there is none. The force of a straight tool that may move along its normal is known.
    """
    continuous, active, rows = exact.continuous, exact.state.active, contact.rows
    shape = continuous.space.interpolant(weight, exact.body.nodes)[0, contact.nodes]
    tool, is_whole = contact.obstacle, not callable(weight)
    is_straight = is_whole and tool.level is None
    if is_straight and tool.force is not None and not np.any(np.array(tool.normal)[~np.array(tool.moves)]):
        return (float(np.dot(tool.force, tool.normal)),) * 2

    def upper(by: float) -> float:
        raised = continuous.shifted(contact, lambda x, y: by * at(weight, x, y))
        if not raised.is_open:
            return np.inf
        trial = raised.solve(active)
        return trial.energy + trial.doubt if trial.status is Status.CONVERGED else np.inf

    gap = max(exact.energy - lower, ROUNDING * exact.strain)
    size = magnitude(exact.displacement) * np.sqrt(min(gap / max(exact.strain, 1e-300), 1.0))
    gaps = (exact.system.normals @ exact.state.u + exact.system.offset)[rows]
    raised = 0 * exact.system.offset
    raised[rows] = shape
    bent = exact.system.response(active, 0 * exact.system.load, raised)
    now = (active.touching * exact.state.normal_force)[rows]
    # where the load alone gives the force it is zero up to rounding, and s large, but not without limit
    least = ROUNDING * float(now @ shape) ** 2 / gap
    bend = max(float(bent @ (exact.system.stiffness @ bent)), least)
    low, high = slope_bounds(upper, lower, gap, bend, float(max(size, np.min(gaps))))
    return max(low, 0.0) if is_whole else low, high


BEYOND = 0.05
"""Part of a force that may act outside of the intervals that are given."""


def within(exact: Admissible, lower: float, contact: ContactSet, force: float) -> Spans:
    """Intervals of x or y, whichever the boundary is longer in, in which all but ``BEYOND`` of a force acts.

    The force is at least ``force``. There are none where they would be all of the boundary.
    """
    most = (exact.energy + exact.doubt - lower) / max(BEYOND * force, 1e-300)
    cells = [each for each in exact.continuous.cells if each.contact.number == contact.number]
    points = np.hstack([each.points for each in cells])
    axis = int(np.argmax(np.ptp(points, axis=(1, 2))))
    is_near = np.concatenate([each.near(exact.displacement, most) for each in cells])
    if np.all(is_near):
        return {}
    x = np.where(is_near, points[axis], np.nan)[np.any(is_near, axis=1)]
    x = x[np.argsort(np.nanmin(x, axis=1))]
    begin, reach = np.nanmin(x, axis=1), np.maximum.accumulate(np.nanmax(x, axis=1))
    is_first = begin > np.append(-np.inf, reach)[:-1]
    return {"xy"[axis]: np.stack([begin[is_first], reach[np.roll(is_first, -1)]], axis=1).tolist()}


PARTS = (1, 1 / 8)
"""Of the best s that are tried, the next one where P is infinite there."""


def slope_bounds(
    upper: Callable[[float], float], lower: float, gap: float, bend: float, flat: float
) -> tuple[float, float]:
    """Bounds, from below and above, of the slope of P at 0.

    ``gap`` is that of the bounds at 0, ``bend`` P'' of the computed solution, ``flat`` the s where that is
    zero.
    """
    best = float(np.sqrt(2 * gap / bend)) if bend > 0 else flat

    def side(sign: int) -> float:
        steps = (best * part for part in PARTS if best > 0)
        return sign * next((b for s in steps if (b := (upper(sign * s) - lower) / s) < np.inf), np.inf)

    return side(-1), side(1)
