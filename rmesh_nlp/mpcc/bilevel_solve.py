"""Bilevel programs whose lower level is not convex: KKT conditions, and cuts by values of the lower level.

KKT conditions hold at every stationary point of the lower level. Where a search finds a y_k with a lower
value than that of an end, each bilevel solution obeys ``f(x, y) <= f(x, y_k)`` wherever y_k is feasible, and
the MPCC is solved again with that row. Where the feasible set moves with x the row holds or y_k violates a
constraint: with the violations r(x) of y_k, positive where it is infeasible ::

    f(x, y) - f(x, y_k) <= s,   0 <= s  _|_  w >= 0,   sum lambda_i r_i(x) + w >= 0,   sum lambda = 1.

A. Mitsos, P. Lemonidis, P. I. Barton, Global solution of bilevel programs with a nonconvex inner program,
J. Global Optim. 42 (2008) 475-513.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.bilevel import bilevel
from rmesh_nlp.mpcc.lower_level import LowerLevel
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.mpcc.solver import MPCCSolver
from rmesh_nlp.optimize.nlp import Symbolic
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True, eq=False)
class BilevelResult:
    """End of a bilevel program: both levels' variables, and the MPCC with its ``cuts`` that led there.

    ``success``: the MPCC's, and no search found a lower value of the lower level, from as many starts as
    ``lower_level.searched`` says. What else an MPCCResult has, such as ``status``, is that of ``result``.
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
    options: Options | None = None,
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
        Most cuts. Where an equation of the lower level depends on x a cut holds at its own x alone.
    options, **changes
        Of each solve, as of :func:`solve`; limits are those of all together.

    Raises
    ------
    ValueError
        As :func:`bilevel` and :func:`solve`.
    """
    program = bilevel(upper, lower, variables=variables)
    level, chosen = program.lower_level, (options or Options()).having({"starts": starts, **changes})
    assert level is not None
    parameters, budget = program.parameters(p), chosen.budget()
    points = [program.start(x0, parameters)]
    found: list[MPCCResult] = []
    for made in itertools.count():
        solver = MPCCSolver(program, chosen)
        results = [solver(point, p=parameters, budget=budget) for point in points]
        ends = [end for result in results for end in result.ends or (result,)]
        found += [end for end in ends if end.success]
        end = min(ends, key=lambda end: (not (end.success or end.status is Status.NO_MINIMUM), end.f))
        lowest = None if end.lower_level is None else end.lower_level.lower
        if lowest is None or made == cuts or budget.is_over():
            break
        x, y, multipliers = level.split(end.x)
        program = _with_cut(program, level, lowest)
        points = [points[0], np.concatenate([x, y, multipliers]), level.start(x, lowest, p=parameters)]
    best = min(found, key=lambda end: end.f, default=end)
    x, y, _ = level.split(best.x)
    return BilevelResult(x, y, best.f, best.success, made, best)


def _with_cut(program: MPCC, level: LowerLevel, lowest: Array) -> MPCC:
    """The program with the cut by ``lowest``; a start of the program without cuts is completed by zeros."""
    nlp, sides = level.nlp, level.sides
    kind, upper = type(program.x), ca.vertcat(program.parts["upper"], program.p)
    depends = np.array(ca.which_depends(nlp.g, nlp.p, 1, True), dtype=bool)
    moves = np.append(np.zeros(nlp.n_x, dtype=bool), depends)[sides.entry]
    entries = [ca.vertcat(nlp.x, nlp.g)[int(entry)] for entry in sides.entry[moves]]
    sign, bound = ca.DM(sides.sign[moves]), ca.DM(sides.bound[moves])
    rows = sign * (ca.vertcat(kind(0, 1), *entries) - bound)
    lower = ca.Function("lower", [nlp.x, nlp.p], [nlp.f, rows])
    value, violations = lower(kind(ca.DM(lowest)), upper)
    gain, n = lower(program.parts["lower"], upper)[0] - value, len(entries)
    if n == 0:
        return program.extended(g=gain, ubg=0)
    s, w, weights = kind.sym("s"), kind.sym("w"), kind.sym("lambda", n)
    longer = program.extended(
        x=ca.vertcat(s, w, weights), lbx=0, G=s, H=w,
        g=ca.vertcat(gain - s, -ca.dot(weights, violations) - w, ca.sum1(weights) - 1),
        lbg=[-np.inf, -np.inf, 0], ubg=0,
    )  # fmt: skip
    return replace(longer, n_added=longer.n_x - level.size)
