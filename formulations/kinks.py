"""From a kink of the reduced objective on, by the exact finish of the KKT model.

q -> F(X(q), u(q)) has kinks where contact changes. Minima lie on them as often as not, and there the gradient
that an outer solver follows is that of one side: it goes to and fro, or its steps shrink to nothing. In the
KKT model gaps and forces are unknowns of their own, and a pair that stays on the kink is an equation: the
exact finish of :mod:`rmesh_nlp.mpcc.finish` minimises on the branch of the point, kinks being its bounds, and
goes on over neighbouring branches that descend.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.models.kkt_model import COMMON, TIGHT_OTHERS
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.mpcc import MPCCSolver
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work

EXACT_FINISH = "exact finish of the KKT model"

WINDOW, CREEPING = 10, 1e-2
"""A descent has met a kink if its last so many iterates had several contact sets, and the best of them is
below those before by less than this part of the decrease so far: of the violation of constraints, and once
they hold of the objective."""

LONG, STILL = 50, 1e-3
"""The same for a descent that gets nowhere, whatever its contact sets. Of 187 solves of the corpus none stops
by it; on a membrane over a bump, whose gaps at nodes let it go on for 845 iterations and 11,273 contact
solves, one does after 300."""

BARRIER = 1e-4
"""Ipopt's first barrier in units of the objective: the point is near, but its multipliers are not known. From
eight stalled descents 1e-4 took 177 iterations in all, 1e-12 233, 1e-2 876, and all ended stationary."""

FINISH: Mapping[str, Any] = {
    **COMMON,
    "mu_init": BARRIER,
    "tol": TIGHT_OTHERS,
    "acceptable_tol": 1e3 * TIGHT_OTHERS,
}
POLISH: Mapping[str, Any] = {
    **COMMON,
    "mu_init": 1e-10,
    "tol": 0.1 * TIGHT_OTHERS,
    "acceptable_tol": 100 * TIGHT_OTHERS,
    "bound_push": 1e-10,
    "bound_frac": 1e-10,
}
"""Ipopt's options of the finish, and of a second one from its end where that is not yet stationary.

Bounds and areas with small multipliers are met to the root of the tolerance: on a slab of 36 x 18 squares
with Coulomb friction the first one left a rate of descent of 1e-5; the second, 23 iterations, left none."""


class Zigzag:
    """Tells that a descent does not get on: where it goes to and fro over kinks, or anywhere."""

    def __init__(self, *, at_kinks: bool = True) -> None:
        self._best: list[tuple[float, float]] = []
        self._window, self._part, least = (WINDOW, CREEPING, 2) if at_kinks else (LONG, STILL, 1)
        self._least, self._contact = least, deque[bytes](maxlen=self._window)

    def __call__(self, point: ReducedPoint, violation: float, value: float) -> bool:
        """Take note of an iterate; whether the descent is to stop.

        ``violation`` is that of constraints, ``value`` that of the objective.
        """
        self._best.append(min([(violation, value), *self._best[-1:]]))
        self._contact.append(point.equilibrium.active.key())
        if len(self._best) <= self._window or len(set(self._contact)) < self._least:
            return False
        # what counts before constraints hold is their violation, then the objective
        which = 0 if self._best[-1 - self._window][0] > 0 else 1
        first = next(best[1] for best in self._best if best[0] == 0) if which else self._best[0][0]
        before, now = self._best[-1 - self._window][which], self._best[-1][which]
        return before - now <= self._part * (first - now)


def is_stationary(outer: Outer, point: ReducedPoint) -> bool:
    """To the tolerance of the solve, over the branches of the contact where there are several."""
    if not np.any(point.weak) and outer.residual(point) <= outer.tolerance:
        return True
    return bool(outer.branches(point).b_stationary)


def finished(outer: Outer, point: ReducedPoint, monitor: Monitor) -> tuple[ReducedPoint | None, int]:
    """The contact solution where the exact finish from ``point`` ends, and its Ipopt iterations.

    None if it ends at invalid outer variables, or the objective has risen by the contact solve there.
    """
    end, iterations = _finished(outer, point, monitor, FINISH)
    if end is None or is_stationary(outer, end):
        return end, iterations
    monitor.budget.check()
    closer, added = _finished(outer, end, monitor, POLISH)
    return closer or end, iterations + added


def _finished(
    outer: Outer, point: ReducedPoint, monitor: Monitor, ipopt: Mapping[str, Any]
) -> tuple[ReducedPoint | None, int]:
    program = outer.kkt
    with monitor.budget.during("build"):
        solver = MPCCSolver(program.mpcc, ipopt_exact=ipopt)
    start = program.point(point)
    result = solver.finish(start, budget=monitor.budget.share())
    iterations = result.counts["ipopt_iterations"]
    monitor.work += Work(kkt_factorisations=iterations)
    q = outer.clipped(program.split(result.x)[0])
    if not (np.all(np.isfinite(q)) and outer.is_valid(q)):
        return None, iterations
    end = outer.function(q)
    violation, value = outer.merit(point)
    is_lower = outer.merit(end) <= (violation, value + ROUNDING * abs(value))
    return (end if is_lower else None), iterations
