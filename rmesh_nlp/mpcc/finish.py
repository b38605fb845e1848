"""The exact finish: fix every pair on one side, solve, and descend over the branches.

At a biactive point that is not S-stationary a relaxed solution is only accurate to ``sqrt(t)``. A branch
NLP (each pair fixed on one side by a bound) has no such error. Where its solution admits a linearised
descent direction in a neighbouring branch, the LPEC names that branch, and the search goes on there;
each step lowers f, so it ends. A. Nurkanovic and S. Leyffer, A globally convergent method for computing
B-stationary points of mathematical programs with equilibrium constraints, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import BoolArray
from rmesh_nlp.mpcc.lpec import Direction, Linearisation, linearise
from rmesh_nlp.mpcc.options import LARGE
from rmesh_nlp.mpcc.phase_one import phase_one
from rmesh_nlp.mpcc.polish import polish
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.stationarity import Stationarity, stationarity
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

_DECREASE = 1e-9  # a branch is better if f falls by more than this, relative to 1 + |f|
_REACH = 2.0  # first radius of the search for a feasible branch, in units of the largest min(G, H)
_SIGN_STEPS = 200  # cheap: each starts at the solution of the one before
_TRUST = (None, 1e-1, 1e-3)  # relative radii within which a lower point of the descent branch is sought


@dataclass(frozen=True, eq=False)
class Finish:
    """End of the exact finish: a lifted point, its weighted objective, and its label if it is exact.

    ``status`` is CONVERGED: S- or B-stationary; ACCEPTABLE: a label, B undecided; otherwise why it stopped.
    """

    z: Array
    f: float
    status: Status
    stationarity: Stationarity | None = None
    lin: Linearisation | None = None
    pivots: int = 0
    lpecs: int = 0

    @property
    def solved(self) -> bool:
        """Whether the point is exact and stationary."""
        return self.status in (Status.CONVERGED, Status.ACCEPTABLE)

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Sort key: solved before exact but not stationary before inexact, then the lower objective."""
        return self.solved, self.stationarity is not None, -self.f if np.isfinite(self.f) else -np.inf


def finish(run: Run, z: Array, *, search: bool, warm: NLPResult | None = None) -> Finish:
    """Make the pairs of a relaxed point exact and descend to a stationary branch.

    From the multipliers ``warm`` of the lifted problem at ``z`` Newton's method is tried before the interior
    point, or the interior point begins with them. ``search`` looks for another branch if the one next to the
    point is infeasible.
    """
    zero = run.lifted.smaller(z)
    if warm is not None and run.options.newton_finish:
        near = polished(run, warm)
        if near is not None:
            near = pivot(run, near)
            if near.solved:
                return near
        warm = None
    result = run.branch(z, zero, warm=warm)
    if warm is not None and not run.exact(result.x):
        result = run.branch(z, zero)
    if search and not run.exact(result.x):
        result = _other_branch(run, z, zero, result)
    if not run.exact(result.x):
        return Finish(result.x, result.f, Status.INACCURATE if result.converged else result.status)
    if result.status is Status.UNBOUNDED:
        return Finish(result.x, result.f, Status.UNBOUNDED)
    return pivot(run, _labelled(run, result.x, result.f, (result.lam_g, result.lam_x)))


def polished(run: Run, warm: NLPResult) -> Finish | None:
    """The exact point next to a relaxed one by Newton's method, labelled; None if there is none.

    Of large problems members leave the corner again where f falls along them, and nothing else is tried.
    """
    release = run.lifted.source.n_pairs >= LARGE
    point = polish(run, warm.x, run.lifted.smaller(warm.x), warm.lam_g, warm.lam_x, release=release)
    if point is None:
        return None
    run.record("polished", 0.0, point.z)
    return _labelled(run, point.z, point.f, (point.lam_rows, point.lam_z))


def _linearised(run: Run, z: Array) -> Linearisation:
    return linearise(run.lifted, z, run.p, run.options.activity, run.options.corner)


def _labelled(run: Run, z: Array, f: float, offered: tuple[Array, Array] | None) -> Finish:
    """Label an exact point; ``offered`` multipliers of an NLP may prove S."""
    lin = _linearised(run, z)
    is_large = run.lifted.source.n_pairs >= LARGE
    result = stationarity(run.lifted, lin, run.options.stationarity, offered, run.budget, is_large)
    return Finish(z, f, result.status, result, lin, 0, int(result.label != "S"))


def pivot(run: Run, point: Finish) -> Finish:
    """Descend over the branches, from one that is not B-stationary to the one its LPEC names."""
    lpecs = point.lpecs
    for pivots in range(run.options.max_pivots + 1):
        point = replace(point, pivots=pivots, lpecs=lpecs)
        direction = None if point.stationarity is None else point.stationarity.direction
        if direction is None:
            return point
        if pivots == run.options.max_pivots:
            break
        better = _descend(run, point, direction)
        if better is None:
            return point
        if better.status is Status.UNBOUNDED:  # feasible points of ever lower objective in one branch
            return Finish(better.x, better.f, Status.UNBOUNDED, pivots=pivots + 1, lpecs=lpecs)
        point = _labelled(run, better.x, better.f, (better.lam_g, better.lam_x))
        lpecs += point.lpecs
    return replace(point, status=Status.ITERATION_LIMIT)


def _descend(run: Run, point: Finish, direction: Direction) -> NLPResult | None:
    """Solve the branch of the direction; near the point if its solution far away is not lower."""
    aim = point.f - _DECREASE * (1 + abs(point.f))
    for reach in _TRUST:
        radius = None if reach is None else reach * (1 + np.abs(point.z))
        better = run.branch(point.z, direction.zero, radius=radius)
        if run.exact(better.x) and better.f < aim:
            return better
    return None


def _other_branch(run: Run, z: Array, zero: BoolArray, result: NLPResult) -> NLPResult:
    """The solution of a feasible branch near the relaxed point: by signs, which is cheap, then by phase I.

    ``result`` if there is none.
    """
    by_signs = _follow_signs(run, z, zero)
    if by_signs is not None:
        return by_signs
    distance = float(np.max(np.min(z[run.lifted.pairs], axis=0), initial=0.0))
    near = phase_one(run, z, radius=_REACH * max(distance, run.options.corner))
    if near.status is not Status.CONVERGED:
        return result
    better = run.branch(near.z, near.zero)
    return better if run.exact(better.x) else replace(better, x=near.z, f=run.objective(near.z))


def _follow_signs(run: Run, z: Array, zero: BoolArray) -> NLPResult | None:
    """Primal-dual active set: leave the signs free, and switch every pair whose sign comes out wrong.

    Where the pairs determine the rest (a lower level with one solution) it moves a contact boundary
    node by node: an obstacle problem of a thousand pairs takes 2.5 s, by phase I more than a minute.
    M. Hintermueller, K. Ito, K. Kunisch, The primal-dual active set strategy as a semismooth Newton method,
    SIAM J. Optim. 13 (2002) 865-888. None if it does not end in an exact point.
    """
    worst = np.inf
    for _ in range(_SIGN_STEPS):
        result = run.branch(z, zero, phase="signs", free_signs=True)
        z = result.x
        G, H = z[run.lifted.pairs]
        free = np.where(zero[0], H, G)
        wrong, before, worst = free < -run.options.complementarity, worst, -float(np.min(free, initial=0.0))
        if not result.converged or worst > before:
            return None
        if not np.any(wrong):
            result = run.branch(z, zero)
            return result if run.exact(result.x) else None
        zero = zero ^ wrong
    return None
