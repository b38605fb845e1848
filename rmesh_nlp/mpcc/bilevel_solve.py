"""Bilevel programs whose lower level is not convex: KKT conditions, and cuts by values of the lower level.

KKT conditions hold at every stationary point of the lower level. Where a search finds a y_k with a lower
value than that of an end, each bilevel solution obeys ``f(x, y) <= f(x, y_k)`` wherever y_k is feasible, and
the MPCC is solved again with that row. Where the feasible set moves with x the row holds or y_k violates a
constraint: with the violations r(x) of y_k, positive where it is infeasible ::

    f(x, y) - f(x, y_k) <= s,   0 <= s  _|_  w >= 0,   sum lambda_i r_i(x) + w >= 0,   sum lambda = 1.

On a constraint that moves y_k would be infeasible beside its own x, and the row without effect: y_k is as far
inside as a fifth of the gain allows. Where linear equations move y_k moves with them, by least squares; other
equations that move allow no cut. Disjunction and inner points are those of A. Mitsos, P. Lemonidis,
P. I. Barton, Global solution of bilevel programs with a nonconvex inner program, J. Global Optim. 42 (2008)
475-513.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array, flat, magnitude
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
    and no lower end was left for want of cuts. What else an MPCCResult has, such as ``status``, is that of
    ``result``: ``iteration_limit`` if cuts ran out, or no longer helped.
    """

    x: Array
    y: Array
    f: float
    success: bool
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
    moving, made = _moving(level), list[ca.Function]()
    has_pairs = moving is not None and not moving[0].is_empty()  # cuts have s and w, which may hide branches
    points, before = [program.start(x0, parameters)], np.full(level.size, np.inf)
    found: list[MPCCResult] = []
    while True:
        solver = MPCCSolver(program, chosen)
        results = [solver(point, p=parameters, budget=budget) for point in points]
        if has_pairs:
            results += [solver.finish(point, p=parameters, budget=budget) for point in points[1:]]
        ends = [end for result in results for end in result.ends or (result,)]
        end = min(ends, key=_rank)
        while has_pairs and made and not budget.is_over():  # a start takes the least s and w
            lower_end = solver.finish(end.x[: level.size], p=parameters, budget=budget)
            if _rank(lower_end) >= _rank(end) or not is_below(lower_end.f, end.f):
                break
            end = lower_end
            ends.append(end)
        found += [end for end in ends if end.success]
        lowest, at = _lower(level, end, parameters), end.x[: level.size]
        if (
            lowest is None
            or moving is None
            or len(made) == cuts
            or budget.is_over()
            or np.allclose(at, before)
        ):
            break
        before, x, (violations, slope) = at, at[: level.n_upper], moving
        y = type(program.x)(ca.DM(_inside(level, violations, end, lowest, parameters)))
        y += ca.sparsify(slope) @ (ca.vertcat(program.parts["upper"], program.p) - np.append(x, parameters))
        program = _with_cut(program, level, violations, y, made)
        points = [points[0], at, level.start(x, lowest, p=parameters)]
    is_proved = end.success and lowest is None
    others = (other for other in sorted(found, key=_rank) if not is_proved or is_below(other.f, end.f))
    best = next((other for other in others if _lower(level, other, parameters) is None), end)
    if lowest is not None and best.success and (best is end or not is_same(end.f, best.f)):
        status = budget.stopped or Status.ITERATION_LIMIT
        said = f"{status.message} The MPCC has a point with f = {end.f:g} that no cut excludes."
        best = replace(best, status=status, success=False, message=said)
    x, y, _ = level.split(best.x)
    return BilevelResult(x, y, best.f, best.success, len(made), best)


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


def _moving(level: LowerLevel) -> tuple[Symbolic, Array] | None:
    """Violations of the inequalities that move with the upper level, and how y_k moves to keep equations.

    Nothing if equations move that are not linear, or that y alone cannot keep.
    """
    nlp, (entry, sign, bound, equal) = level.nlp, level.sides
    column, slope = ca.vertcat(nlp.x, nlp.g), np.zeros((nlp.n_x, nlp.p.shape[0]))
    depends = np.array(ca.which_depends(nlp.g, nlp.p, 1, True), dtype=bool)
    moves = np.append(np.zeros(nlp.n_x, dtype=bool), depends)[entry]
    if np.any(moves & equal):
        equations, both = column[entry[equal].tolist()], ca.vertcat(nlp.x, nlp.p)
        if any(ca.which_depends(equations, both, 2, True)):
            return None
        by_y, by_x = np.split(ca.evalf(ca.jacobian(equations, both)).full(), [nlp.n_x], axis=1)
        slope, moves = -np.linalg.pinv(by_y) @ by_x, ~equal
        if magnitude(by_y @ slope + by_x) > ZERO:
            return None
    # one entry taken at no place is a row of none
    rows = ca.reshape(column[entry[moves].tolist()], -1, 1)
    return ca.DM(sign[moves]) * (rows - ca.DM(bound[moves])), slope


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


def _with_cut(
    program: MPCC, level: LowerLevel, violations: Symbolic, y: Symbolic, made: list[ca.Function]
) -> MPCC:
    """The program with the cut by ``y``, which is added to those ``made``."""
    nlp, kind, upper = level.nlp, type(program.x), ca.vertcat(program.parts["upper"], program.p)
    lower, n = ca.Function("lower", [nlp.x, nlp.p], [nlp.f, violations]), violations.shape[0]
    value, rows = lower(y, upper)
    gain = lower(program.parts["lower"], upper)[0] - value
    made.append(ca.Function("cut", [program.parts["lower"], upper], [gain, rows]))
    if n == 0:
        return program.extended(g=gain, ubg=0)
    s, w, weights = kind.sym("s"), kind.sym("w"), kind.sym("lambda", n)
    longer = program.extended(
        x=ca.vertcat(s, w, weights), lbx=0, G=s, H=w,
        g=ca.vertcat(gain - s, -ca.dot(weights, rows) - w, ca.sum1(weights) - 1),
        lbg=[-np.inf, -np.inf, 0], ubg=0,
    )  # fmt: skip

    def completion(own: Array, p: Array) -> Array:
        """The least s and w of each cut, and its most violated row."""
        x, y, _ = level.split(own)
        parts = []
        for cut in made:
            gain, rows = (flat(part) for part in cut(y, np.append(x, p)))
            parts += [np.maximum([gain[0], -np.max(rows)], 0.0), np.eye(n)[np.argmax(rows)]]
        return np.concatenate(parts)

    return replace(longer, n_added=longer.n_x - level.size, completion=completion)
