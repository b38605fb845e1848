"""What is tried while no stationary point is found: phase I, then homotopies from moved starts.

Phase I begins at the point nearest to a solution so far. Where it shows a minimum of the violation, that is
the answer. Else homotopies that reckon with dependent equations come last, and from elsewhere, as the cause
may be the start itself: functions that are not defined beside it, or a valley that leads to a violation.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from rmesh_nlp.evaluation import Array, is_finite, magnitude
from rmesh_nlp.mpcc.finish import finish
from rmesh_nlp.mpcc.homotopy import Path, follow, ran_out
from rmesh_nlp.mpcc.lpec import nearest_branch
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status

_STEPS = 80
_SHRINK = 0.25  # of the trust region
_FLAT = 1e-4  # decrease of the violation, in units of itself or per length, that is none
_NEAR = 20.0  # bounds are near if they are no further apart than this, in units of 1 + |x0|
_SPREADS = (-1.0, 1.5)  # exponents of ten of the distance of random starts, in the same units


def rescue(run: Run, paths: list[Path], x0: Array, z0: Array) -> None:
    """Add a path for each attempt to ``paths`` until one has ended, or the violation has a minimum."""
    if any(path.ended for path in paths):
        return
    paths.append(Path())
    run.rescues += 1
    z, status = phase_one(run, z0 if run.nearest is None else run.nearest[0])
    if status is Status.CONVERGED:
        paths[-1].keep(finish(run, z, search=False))
    else:
        paths[-1].failure = status
    if status is Status.INFEASIBLE and not ran_out(paths):
        run.is_infeasible = True
        return
    for x in itertools.islice(moved_starts(run.lifted.source, x0, run.options.seed), run.options.moves):
        if any(path.ended for path in paths):
            break
        paths.append(Path())
        run.rescues += 1
        follow(run, paths[-1], run.lifted.start(x, run.p[:-1]), dependent=True)


def phase_one(run: Run, z: Array) -> tuple[Array, Status]:
    """Look for a feasible complementary point near ``z``, on the lower one of branches that do as well.

    A linear program with equilibrium constraints (LPEC) names the branch that lowers the sum of the
    violations of all rows most within a trust region, and Ipopt minimises that sum on the branch. The region
    shrinks where the branch does not keep what the linearisation promised. Where no branch lowers it, the
    point is a local minimum of the violation to first order: "locally infeasible" rests on it. A solver that
    stops at a violation proves nothing. The LPEC is that of MPECopt: A. Nurkanovic and S. Leyffer, A globally
    convergent method for computing B-stationary points of mathematical programs with equilibrium constraints,
    arXiv 2501.13835, 2025.

    CONVERGED: the point is feasible and complementary; INFEASIBLE: a local minimum of a positive violation,
    to first order; STALLED: neither was shown.
    """
    lifted, nlp = run.lifted, run.lifted.nlp
    z = np.clip(z, nlp.lbx, nlp.ubx)
    z[lifted.pairs[lifted.smaller(z)]] = 0.0
    size = 1.0 + magnitude(z)
    tolerance, radius, only_violation = run.options.feasibility * size, size, False
    for _ in range(_STEPS):
        gradient, rows, jacobian = lifted.linearise(z, run.p)
        if not all(is_finite(part) for part in (z, gradient, rows, jacobian.data)):
            break
        violation = _sum(rows, nlp.lbg, nlp.ubg)
        slope = 0.0 * gradient if only_violation else gradient
        near = nearest_branch(lifted, z, run.p, radius, slope, run.budget)
        if near is None:
            break
        trial, zero = near
        decrease = violation - _sum(rows + jacobian @ (trial - z), nlp.lbg, nlp.ubg)
        if decrease <= _FLAT * min(violation, radius):
            if only_violation:
                return z, Status.INFEASIBLE if violation > tolerance else Status.CONVERGED
            only_violation = True  # a minimum of the violation is shown without the objective
            continue
        if not np.isfinite(run.excess(trial)):  # the functions are not defined there
            radius *= _SHRINK
            continue
        least = run.least_violation(trial, zero)
        if least.f <= tolerance:
            return least.x, Status.CONVERGED
        if violation - least.f > _FLAT * violation:
            z = least.x
        else:
            radius *= _SHRINK
    return z, Status.STALLED


def _sum(values: Array, lower: Array, upper: Array) -> float:
    return float(np.sum(np.maximum(np.maximum(lower - values, values - upper), 0.0)))


def moved_starts(mpcc: MPCC, x0: Array, seed: int) -> Iterator[Array]:
    """Seeded random starts without end, within the bounds.

    An unknown is uniform between its bounds where these are near each other, else normal around x0 and, in
    turn, around 0: a given start may itself be far away from everything.
    """
    lower, upper, random = mpcc.lbx, mpcc.ubx, np.random.default_rng(seed)
    for centre in itertools.cycle((x0, np.zeros_like(x0))):
        unit = 1 + np.abs(centre)
        near = (upper - lower) <= _NEAR * unit
        share = random.uniform(size=x0.size)
        spread = 10.0 ** random.uniform(*_SPREADS)
        around = np.clip(centre + spread * unit * random.normal(size=x0.size), lower, upper)
        inside = np.where(near, lower, 0.0) + share * np.where(near, upper - lower, 0.0)
        yield np.where(near, inside, around)
