"""Bilevel programs whose lower level is not convex: KKT conditions, and cuts by values of the lower level.

KKT conditions hold at every stationary point of the lower level. Where a search finds a y_k with a lower
value than that of an end, each bilevel solution obeys ``f(x, y) <= f(x, y_k)`` wherever y_k is feasible, and
the MPCC is solved again with that row. Where the feasible set moves with x the row holds or y_k violates a
constraint: with the violations r(x) of y_k, positive where it is infeasible ::

    f(x, y) - f(x, y_k) <= s,   0 <= s  _|_  w >= 0,   max_i r_i(x) + w >= 0.

On a constraint that moves y_k would be infeasible beside its own x, and the row without effect: y_k is as far
inside as a fifth of the gain allows. Equations that move allow no cut. Disjunction and inner points are those
of A. Mitsos, P. Lemonidis, P. I. Barton, Global solution of bilevel programs with a nonconvex inner program,
J. Global Optim. 42 (2008) 475-513.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.bilevel import bilevel
from rmesh_nlp.mpcc.finish import is_below
from rmesh_nlp.mpcc.lower_level import LowerLevel
from rmesh_nlp.mpcc.options import Options, OptionsLike
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import MPCCResult, is_same
from rmesh_nlp.mpcc.solver import MPCCSolver
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.optimize.nlp import Symbolic
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status

_STARTS = 100  # of the last search for a lower value
_GIVEN_UP = 0.2  # part of the gain of a lower value that may be given up to be further inside


@dataclass(frozen=True, eq=False)
class BilevelResult:
    """End of a bilevel program: both levels' variables, and the MPCC with its ``cuts`` that led there.

    ``success``: the MPCC's, no search found a lower value of the lower level, the last one from 100 starts,
    and no lower end was left for want of cuts. What else an MPCCResult has, such as ``f`` and ``status``, is
    that of ``result``: ``iteration_limit`` if cuts ran out, or no longer helped.
    """

    x: Array
    y: Array
    cuts: int
    result: MPCCResult

    def __getattr__(self, name: str) -> Any:
        return getattr(object.__getattribute__(self, "result"), name)

    def __str__(self) -> str:
        return f"{self.result}; {self.cuts} cut{'s' * (self.cuts != 1)}"


def solve_bilevel(
    upper: Mapping[str, Any],
    lower: Mapping[str, Any],
    x0: ArrayLike,
    *,
    variables: Symbolic,
    p: ArrayLike = (),
    starts: int = 10,
    cuts: int = 20,
    options: OptionsLike = None,
    **changes: object,
) -> BilevelResult:
    """Solve a bilevel program, convex in the lower level or not.

    Parameters
    ----------
    upper, lower, variables
        As of :func:`bilevel`.
    x0 : array_like
        Start of the upper level's variables, or of all unknowns of the MPCC.
    p : array_like
        Values of the parameters.
    starts : int
        Of each solve: the given one and seeded random ones, of which the lowest end counts.
    cuts : int
        Most cuts.
    options, **changes
        Of each solve, as of :func:`solve`; limits are those of all together.

    Raises
    ------
    ValueError
        As :func:`bilevel` and :func:`solve`.
    """
    program = bilevel(upper, lower, variables=variables)
    level, chosen = program.lower_level, Options.of(options).having({"starts": starts, **changes})
    assert level is not None
    parameters, budget = program.parameters(p), chosen.budget()
    violations, made = _moving(level), 0
    has_pairs = violations is not None and not violations.is_empty()
    points, before = [program.start(x0, parameters)], np.full(level.size, np.inf)
    found: list[MPCCResult] = []
    while True:
        solver = MPCCSolver(program, chosen)
        results = [solver(point, p=parameters, budget=budget) for point in points]
        if has_pairs and made:  # cuts have s and w, which hide branches where they are not least
            results += [solver.finish(point, p=parameters, budget=budget) for point in points[1:]]
            is_lower = True
            while is_lower:
                best = min(results, key=_rank)
                results.append(solver.finish(best.x[: level.size], p=parameters, budget=budget))
                is_lower = _rank(results[-1]) < _rank(best) and is_below(results[-1].f, best.f)
        ends = [end for result in results for end in result.ends or (result,)]
        found += [end for end in ends if end.success]
        end = min(ends, key=_rank)
        lowest, at = _lower(level, end, parameters), end.x[: level.size]
        is_stuck = violations is None or made == cuts or np.allclose(at, before)
        if lowest is None or is_stuck or budget.is_over():
            break
        before, y = at, _inside(level, violations, end, lowest, parameters)
        program, made = _with_cut(program, level, violations, y), made + 1
        points = [points[0], at, level.start(at[: level.n_upper], lowest, p=parameters)]
    is_proved = end.success and lowest is None
    others = (other for other in sorted(found, key=_rank) if not is_proved or is_below(other.f, end.f))
    best = next((other for other in others if _lower(level, other, parameters) is None), end)
    if lowest is not None and best.success and (best is end or not is_same(end.f, best.f)):
        status = budget.stopped or Status.ITERATION_LIMIT
        said = f"{status.message} The MPCC has a point with f = {end.f:g} that no cut excludes."
        best = replace(best, status=status, success=False, message=said)
    x, y, _ = level.split(best.x)
    return BilevelResult(x, y, made, best)


def _rank(end: MPCCResult) -> tuple[bool, float]:
    """Sort key: stationary points of the MPCC, the lowest first."""
    return not (end.success or end.status is Status.NO_MINIMUM), end.f


def _lower(level: LowerLevel, end: MPCCResult, p: Array) -> Array | None:
    """Variables with a lower value of the lower level than that of an end, if a search has found some.

    A success is searched once more, from more starts.
    """
    check = end.lower_level
    if check is None or not (end.success and check.searched):
        return None if check is None else check.lower
    x, y, _ = level.split(end.x)
    lowest = level.lowest(x, y, p=p, n=_STARTS, seed=1)
    return lowest.x if lowest.converged and check.f - lowest.f > ZERO * (1 + abs(check.f)) else None


def _moving(level: LowerLevel) -> Symbolic | None:
    """Violations of the inequalities that move with the upper level; nothing if equations move."""
    nlp, (entry, sign, bound, equal) = level.nlp, level.sides
    depends = np.array(ca.which_depends(nlp.g, nlp.p, 1, True), dtype=bool)
    moves = np.append(np.zeros(nlp.n_x, dtype=bool), depends)[entry]
    # one entry taken at no place is a row of none
    rows = ca.reshape(ca.vertcat(nlp.x, nlp.g)[entry[moves].tolist()], -1, 1)
    return None if np.any(moves & equal) else ca.DM(sign[moves]) * (rows - ca.DM(bound[moves]))


def _inside(level: LowerLevel, violations: Symbolic, end: MPCCResult, lowest: Array, p: Array) -> Array:
    """A point with most of the gain of ``lowest``, as far inside moving inequalities as that allows."""
    nlp, parameters = level.nlp, np.append(end.x[: level.n_upper], p)
    if violations.is_empty():
        return lowest
    assert end.lower_level is not None
    value = float(ca.Function("value", [nlp.x, nlp.p], [nlp.f])(lowest, parameters))
    room, most = type(nlp.x).sym("room"), type(nlp.x).sym("most")
    rows = ca.vertcat(nlp.f - most, violations + room)
    inner = nlp.extended(x=room, p=most, weight=0, f=-room, g=rows, ubx=1, ubg=0)
    given_up = value + _GIVEN_UP * (end.lower_level.f - value)
    inside = Solver(inner)(np.append(lowest, 0.0), p=np.append(parameters, given_up))
    return inside.x[:-1] if inside.converged and inside.x[-1] > ZERO else lowest


def _with_cut(program: MPCC, level: LowerLevel, violations: Symbolic, y: Array) -> MPCC:
    """The program with the cut by ``y``."""
    nlp, kind, upper = level.nlp, type(program.x), ca.vertcat(program.parts["upper"], program.p)
    values = ca.Function("lower", [nlp.x, nlp.p], [nlp.f, ca.mmax(violations)])
    value, violation = values(ca.DM(y), upper)
    gain = values(program.parts["lower"], upper)[0] - value
    if violations.is_empty():
        return program.extended(g=gain, ubg=0)
    least = ca.Function("cut", [program.x, program.p], [ca.fmax(ca.vertcat(gain, -violation), 0)])
    s, w = kind.sym("s"), kind.sym("w")
    longer = program.extended(
        x=ca.vertcat(s, w), lbx=0, G=s, H=w, g=ca.vertcat(gain - s, -violation - w), ubg=0
    )
    return replace(longer, completions={**program.completions, program.n_x: least})
