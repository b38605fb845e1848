"""The exact finish: fix every pair on one side, solve, and descend over the branches.

At a biactive point that is not S-stationary a relaxed solution is only accurate to ``sqrt(t)``. A branch
NLP (each pair fixed on one side by a bound) has no such error. Where its solution admits a linearised
descent direction in a neighbouring branch, the LPEC names that branch, and the search goes on there;
each step lowers f, so it ends. A. Nurkanovic and S. Leyffer, A globally convergent method for computing
B-stationary points of mathematical programs with equilibrium constraints, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lpec import descent, nearest_branch
from rmesh_nlp.mpcc.programs import BoolArray, Log, Programs
from rmesh_nlp.mpcc.stationarity import Label, Linearisation, label, linearisation, witness
from rmesh_nlp.nlp import NLPResult, Status

_DECREASE = 1e-9  # a branch is better if f falls by more than this, relative to 1 + |f|
_REACHES = (2.0, 20.0)  # radii of the search for a feasible branch, in units of the largest min(G, H)
_NEAR_BIACTIVE = 3e-5  # pairs closer to the corner than this are tried on both sides at once


@dataclass(frozen=True, eq=False)
class Finish:
    """End of the exact finish.

    Attributes
    ----------
    z : array
        Lifted point.
    f : float
    status : Status
        CONVERGED: S- or B-stationary; ACCEPTABLE: a label, B undecided; otherwise why it stopped.
    label : Label or None
    b_stationary : bool or None
    lin : Linearisation or None
    pivots, lpecs : int
    """

    z: Array
    f: float
    status: Status
    label: Label | None = None
    b_stationary: bool | None = None
    lin: Linearisation | None = None
    pivots: int = 0
    lpecs: int = 0

    @property
    def solved(self) -> bool:
        """Whether the point is exact and stationary."""
        return self.status in (Status.CONVERGED, Status.ACCEPTABLE)


def finish(programs: Programs, z: Array, p: Array, log: Log, *, search: bool) -> Finish:
    """Make the pairs of a relaxed point exact and descend to a stationary branch."""
    lifted, options = programs.lifted, programs.options
    fix_G = z[lifted.first] <= z[lifted.second]
    result = _solve(programs, log, z, p, fix_G)
    if search and not exact(programs, result.x, p):
        result, fix_G = _other_branch(programs, log, z, p, fix_G, result)
    if not exact(programs, result.x, p):
        status = Status.INACCURATE if result.converged else result.status
        return Finish(result.x, result.f, status)
    lpecs = 0
    for pivots in range(options.max_pivots):
        result = _tighten(programs, log, result, p, fix_G)
        lin = linearisation(lifted, result.x, p, options.activity)
        found = witness(lifted, lin, result.lam_g[: lifted.nlp.n_g], result.lam_x, options.stationarity)
        found = found or label(lifted, lin, options.stationarity)
        here = Finish(result.x, result.f, Status.CONVERGED, found, True, lin, pivots, lpecs)
        if found.name == "S":  # S implies B
            return here
        direction = descent(lifted, lin)
        lpecs += 1
        if direction is None:
            status = Status.STALLED if found.multipliers is None else Status.ACCEPTABLE
            return _changed(here, status, None, lpecs)
        if direction.decrease >= -options.stationarity * lin.scale:
            return _changed(here, Status.CONVERGED, True, lpecs)
        better = _solve(programs, log, result.x, p, direction.fix_G)
        if not (exact(programs, better.x, p) and better.f < result.f - _DECREASE * (1 + abs(result.f))):
            return _changed(here, Status.STALLED, False, lpecs)
        result, fix_G = better, direction.fix_G
    return _changed(here, Status.ITERATION_LIMIT, False, lpecs)


def _changed(finish: Finish, status: Status, b_stationary: bool | None, lpecs: int) -> Finish:
    return Finish(finish.z, finish.f, status, finish.label, b_stationary, finish.lin, finish.pivots, lpecs)


def _solve(programs: Programs, log: Log, z: Array, p: Array, fix_G: BoolArray) -> NLPResult:
    result = programs.branch(z, p, fix_G, ~fix_G)
    log.add("branch", 0.0, result)
    return result


def _other_branch(
    programs: Programs, log: Log, z: Array, p: Array, fix_G: BoolArray, result: NLPResult
) -> tuple[NLPResult, BoolArray]:
    """Branches that the linearisation at the relaxed point can satisfy, with a growing radius."""
    lifted = programs.lifted
    distance = float(np.max(np.minimum(z[lifted.first], z[lifted.second]), initial=0.0))
    for reach in _REACHES:
        near = nearest_branch(lifted, z, p, reach * max(distance, programs.options.activity))
        if near is None or np.array_equal(near[1], fix_G):
            continue
        fix_G = near[1]
        result = _solve(programs, log, near[0], p, fix_G)
        if exact(programs, result.x, p):
            break
    return result, fix_G


def _tighten(programs: Programs, log: Log, result: NLPResult, p: Array, fix_G: BoolArray) -> NLPResult:
    """Put pairs that end next to the corner into it, if that costs nothing.

    A weakly active member stops at a distance of the square root of the solver's tolerance from zero: too far to
    be called zero, near enough to hide a biactive pair and with it a descent direction.
    """
    lifted, options = programs.lifted, programs.options
    free = np.maximum(result.x[lifted.first], result.x[lifted.second])
    near = (free <= _NEAR_BIACTIVE) & (free > options.complementarity)
    if not np.any(near):
        return result
    tight = programs.branch(result.x, p, fix_G | near, ~fix_G | near)
    log.add("tightened", 0.0, tight)
    cost = tight.f - result.f
    return tight if exact(programs, tight.x, p) and cost <= _DECREASE * (1 + abs(result.f)) else result


def exact(programs: Programs, z: Array, p: Array) -> bool:
    """Whether the source problem is feasible and complementary at ``z``, within the scaled tolerances."""
    return programs.excess(z, p) <= 1.0
