"""What is tried while no stationary point is found: phase I, then homotopies from other t0 and moved starts.

Phase I begins at the point nearest to a solution so far. Where it shows a minimum of the violation, that is
the answer. Else homotopies with smaller and larger t0 come last, and from elsewhere, as the cause may be the
start itself: functions that are not defined beside it, or a valley that leads to a violation.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rmesh_nlp.evaluation import Array, Mask, is_finite, magnitude
from rmesh_nlp.mpcc.finish import finish
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.mpcc.lpec import nearest_branch, steepness
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import beyond
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status

_STEPS = 80
_SHRINK = 0.1  # of the trust region
_SEEN = 1e-6  # violation in units of a step that linear programs tell from zero, see ``steepness``
_LEVEL = 1e-2  # part of the violation whose decrease over the length of the point is none
_FLAT = 1e-4  # the same for what Ipopt finds on a branch, and for a violation that is closed
_NEAR = 20.0  # bounds are near if they are no further apart than this, in units of 1 + |x0|
_SHARES = (1e-2, 1e2, 1.0)  # of t0, in turn: what repeats a failure is no rescue
_SAME = 2  # homotopies from the given start, the first ones
_SPREADS = (-1.0, 1.5)  # exponents of ten of the distance of random starts, in the same units


def rescue(run: Run, paths: list[Path]) -> None:
    """Add a path for each attempt to ``paths`` until one has ended, or the violation has a minimum."""
    mpcc, p, options = run.lifted.source, run.p[:-1], run.options
    if not any(path.ended for path in paths):
        paths.append(Path())
        run.rescues += 1
        z, status = phase_one(run, run.nearest[0])
        run.is_infeasible = status is Status.INFEASIBLE
        if status is Status.CONVERGED:
            paths[-1].keep(finish(run, z, search=False))
        else:
            paths[-1].failure = status
    moved = (run.lifted.start(mpcc.start(x, p), p) for x in moved_starts(mpcc, run.z0, options.seed))
    for k in range(options.moves):
        if any(path.ended for path in paths) or run.is_infeasible:
            return
        paths.append(Path())
        run.rescues += 1
        z = run.z0 if k < _SAME else next(moved)
        t0 = max(_SHARES[k % len(_SHARES)] * options.t0, options.t_final)
        follow(run, paths[-1], z, t0=t0)


def phase_one(run: Run, z: Array) -> tuple[Array, Status]:
    """Look for a feasible complementary point near ``z``, on the lower one of branches that do as well.

    Ipopt minimises the sum of the violations of all rows on the branch next to ``z``. Where a linear program
    without complementarity does not lower the sum within a trust region, no branch does: the point is a
    local minimum of the violation to first order, and "locally infeasible" rests on it. It is asked of ``z``
    first, where an infeasible relaxation may have ended. Else a linear program with equilibrium constraints
    (LPEC) names the branch that lowers it most, the first time the one with the lower objective of those that
    do as well. The region shrinks where the branch does not keep what the linearisation promised. A solver
    that stops at a violation proves nothing. The LPEC is that of MPECopt: A. Nurkanovic and S. Leyffer, A
    globally convergent method for computing B-stationary points of mathematical programs with equilibrium
    constraints, arXiv 2501.13835, 2025.

    CONVERGED: the point is feasible and complementary; INFEASIBLE: a local minimum of a positive violation,
    to first order; STALLED: neither was shown.
    """
    lifted, nlp = run.lifted, run.lifted.nlp
    z = np.clip(z, nlp.lbx, nlp.ubx)
    if _nearest(run, z, np.inf) is Status.INFEASIBLE:
        return z, Status.INFEASIBLE
    own = lifted.smaller(z)
    z[lifted.pairs[own]] = 0.0
    radius, tried = np.inf, np.zeros_like(own)
    for k in range(_STEPS):
        if run.exact(z):
            return z, Status.CONVERGED
        near = _nearest(run, z, radius)
        if isinstance(near, _Nearest) and near.rest <= _FLAT * near.violation:
            near = _nearest(run, z, radius, lifted.value(z, run.p)[1] * (k == 0))
        if isinstance(near, Status):
            return z, near
        trial, zero = near.z, near.zero
        if k == 0 and near.rest > _FLAT * near.violation:  # no branch closes it: one after the other
            trial, zero = z, own
        radius = near.radius * _SHRINK
        # the functions may not be defined there, and z may be the least of this branch already
        if np.isfinite(run.excess(trial)) and np.any(zero != tried):
            least, tried = run.least_violation(trial, zero), zero
            if is_finite(least.x) and least.f <= (1 - _FLAT) * near.violation:
                z, radius = least.x, near.radius
    return z, Status.STALLED


class _Nearest(NamedTuple):
    """Where the linearised rows are violated least, in which branch, and how far was looked.

    ``violation`` at the point itself and the ``rest`` are sums.
    """

    z: Array
    zero: Mask
    radius: float
    violation: float
    rest: float


def _nearest(run: Run, z: Array, radius: float, slope: Array | None = None) -> _Nearest | Status:
    """Look within ``radius``, and within what linear programs can see; without a slope off branches too.

    INFEASIBLE if the violation has a minimum instead of falling, STALLED if nothing is shown. Of several
    steps that do as well the one down the slope is taken; such a program shows no minimum.
    """
    nlp, size = run.lifted.nlp, 1.0 + magnitude(z)
    _, rows, jacobian = run.lifted.linearise(z, run.p)
    if not all(map(is_finite, (rows, jacobian.data, 0.0 if slope is None else slope))):
        return Status.STALLED
    steep = steepness(jacobian)
    away = beyond(rows, nlp.lbg, nlp.ubg)
    seen, violation = float(np.sum(away / steep)), float(np.sum(away))
    radius = min(radius, size, seen / _SEEN)
    if min(seen, radius / size) <= _SEEN:  # too small to show anything
        return Status.STALLED
    near = nearest_branch(run.lifted, z, rows, jacobian, radius, slope, run.budget)
    if near is None:
        return Status.STALLED
    rest = float(np.sum(beyond(rows + jacobian @ (near[0] - z), nlp.lbg, nlp.ubg)))
    falls, level = (violation - rest) * max(1.0, size / radius), _LEVEL * min(violation, size)
    if falls <= level and not np.any(slope):  # it cannot rise: then the program was too coarse
        return Status.INFEASIBLE if falls >= -level else Status.STALLED
    return _Nearest(*near, radius, violation, rest)


def moved_starts(mpcc: MPCC, x0: Array, seed: int) -> Iterator[Array]:
    """Seeded random starts without end, within the bounds; those of ``mixed`` leave out what it adds.

    The answers of a lower level to random x are few, so its variables are drawn as well.
    An unknown is uniform between its bounds where these are near each other, else normal around x0 and, in
    turn, around 0: a given start may itself be far away from everything.
    """
    n = mpcc.n_own if mpcc.lower_level is None else mpcc.n_x
    random = np.random.default_rng(seed)
    x0, lower, upper = x0[:n], mpcc.lbx[:n], mpcc.ubx[:n]
    for centre in itertools.cycle((x0, np.zeros_like(x0))):
        unit = 1 + np.abs(centre)
        near = (upper - lower) <= _NEAR * unit
        inside = random.uniform(np.where(near, lower, 0.0), np.where(near, upper, 0.0))
        spread = 10.0 ** random.uniform(*_SPREADS)
        around = np.clip(centre + spread * unit * random.normal(size=n), lower, upper)
        yield np.where(near, inside, around)
