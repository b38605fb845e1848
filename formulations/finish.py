"""The finish of a formulation: from any valid end on to a stationary point, or back what it got.

An interior point meets weakly active move limits to the square root of its tolerance only, and rounding can
hold the multipliers of many least areas off it. For the energy Newton steps on the reduced energy go on from
there.

q -> F(X(q), u(q)), any other objective, has kinks where contact changes. Minima lie on them as often as not,
and there the gradient that an outer solver follows is that of one side. In the KKT model gaps and forces are
unknowns of their own, and a pair that stays on the kink is an equation: the exact finish of
:mod:`rmesh_nlp.mpcc.finish` minimises on the branch of the point, kinks being its bounds, and goes on over
neighbouring branches that descend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formulations.ipopt import exact, pull
from formulations.outer_solvers import NestedSettings, solved
from rmesh_nlp.evaluation import ROUNDING, Array, is_finite
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.mpcc import MPCCSolver
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work

EXACT_FINISH = "exact finish of the KKT model"


@dataclass(frozen=True)
class Finished:
    """Outer variables, whether they are stationary, and what ran for it; empty if nothing better is known."""

    q: Array
    is_stationary: bool
    method: str = ""


def finished(outer: Outer, q: Array, monitor: Monitor) -> Finished:
    """A stationary point from a valid end ``q``, or ``q`` itself where none is reached that is not above."""
    if not outer.is_valid(q):
        return Finished(q, False)
    point = outer.function(q)
    if q.size == 0 or is_stationary(outer, point):
        return Finished(q, True)
    last, method = (_newton if outer.objective.collapses else _exact)(outer, point, monitor)
    if not (is_finite(last) and outer.is_valid(last)):
        return Finished(q, False)
    end = outer.function(last)
    violation, value = outer.merit(point)
    if not outer.merit(end) <= (violation, value + ROUNDING * abs(value)):  # not so of NaN
        return Finished(q, False)
    return Finished(last, is_stationary(outer, end), method)


def is_stationary(outer: Outer, point: ReducedPoint) -> bool:
    """To the tolerance of the solve, over the branches of the contact where there are several."""
    if outer.residual(point) <= outer.tolerance and (point.is_energy or not np.any(point.weak)):
        return True
    return not point.is_energy and bool(outer.branches(point).b_stationary)


def is_above(energy: float, start: float) -> bool:
    """Whether an end is above the start, whose valley a barrier may leave."""
    return energy > start + ROUNDING * abs(start)


def _newton(outer: Outer, point: ReducedPoint, monitor: Monitor) -> tuple[Array, str]:
    """Newton steps on the reduced energy."""
    track = monitor.track(outer)
    result = solved(outer.near(), point.q, track.exact, NestedSettings())
    monitor.work += Work(kkt_factorisations=result.factorised)
    monitor.budget.check()
    return result.q, result.method


def _exact(outer: Outer, point: ReducedPoint, monitor: Monitor) -> tuple[Array, str]:
    """The exact finish of the KKT model, and a contact solve."""
    track, program = monitor.track(outer), outer.kkt
    unit = pull(outer.at_start.gradient) / program.value
    # the point is near, but its multipliers are not known: a barrier below Ipopt's own, but not at its end
    with monitor.budget.during("build"):
        solver = MPCCSolver(program.mpcc, ipopt_exact=exact(1 / unit, 1e-4))
    result = solver.finish(program.point(point), budget=monitor.budget.share())
    iterations = result.counts["ipopt_iterations"]
    monitor.work += Work(kkt_factorisations=iterations)
    q = outer.clipped(program.split(result.x)[0])
    if is_finite(q) and outer.is_valid(q):
        track.exact(iterations, q)
    monitor.budget.check()
    return q, EXACT_FINISH
