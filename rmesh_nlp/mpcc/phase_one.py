"""Phase I: a feasible complementary point, or a local minimum of the violation.

The sum of the violations of all rows is minimised over complementary points, as MPECopt does: a linear
program with equilibrium constraints (LPEC) gives a step and a branch within a trust region. The region
shrinks where the step does not lower the violation as it was predicted, and grows where it does, or where
no complementary point is within reach. Where the linearised violation is closed, Newton steps go onto the
branch. Where no branch lowers it, the point is a local minimum of the violation to first order: "locally
infeasible" rests on this. A solver that stops at a violation proves nothing.
A. Nurkanovic and S. Leyffer, A globally convergent method for computing B-stationary points of mathematical
programs with equilibrium constraints, arXiv 2501.13835, 2025; R. Fletcher, S. Leyffer, D. Ralph, S. Scholtes,
Local convergence of SQP methods for MPECs, SIAM J. Optim. 17 (2006).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import BoolArray
from rmesh_nlp.mpcc.lpec import nearest_branch
from rmesh_nlp.mpcc.polish import project
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status

_STEPS = 80
_SMALLEST = 1e-7  # radius, relative to the first one, that is given up
_GROW, _SHRINK, _LARGEST = 2.0, 0.25, 10.0
_REACH = 4.0  # growth until complementary points are within the region
_ON = 1e-5  # members are zero within this, in units of the radius: tolerance of the integer program
_CLOSED = 1e-6  # predicted violation, relative to the largest unknown, that is none
_FLAT = 1e-4  # decrease of the violation, in units of itself or per length, that is none
_ACCEPTED, _GOOD = 0.1, 0.75  # parts of the predicted decrease


@dataclass(frozen=True, eq=False)
class Feasibility:
    """End of phase I: a point, the members that are zero there, and what it is.

    ``status`` is CONVERGED: feasible and complementary; INFEASIBLE: a local minimum of a positive
    violation, to first order; STALLED: neither was shown.
    """

    z: Array
    zero: BoolArray
    status: Status


def phase_one(run: Run, z: Array) -> Feasibility:
    """Look for a feasible complementary point near ``z``.

    Of steps that lower the violation alike that with the lowest linearised objective is taken, and none where
    a minimum of the violation is to be shown.
    """
    lifted, nlp = run.lifted, run.lifted.nlp
    z = np.clip(z, nlp.lbx, nlp.ubx)  # relaxed solutions may lie outside, then no step is complementary
    size = 1.0 + float(np.max(np.abs(z), initial=0.0))
    radius, least, zero, only_violation = size, np.inf, lifted.smaller(z), False
    smallest, refused = _SMALLEST * radius, np.inf
    for _ in range(_STEPS):
        run.budget.check()
        _, gradient, rows, jacobian = lifted.linearise(z, run.p)
        if not all(np.all(np.isfinite(part)) for part in (z, gradient, rows, jacobian.data)):
            break
        near = nearest_branch(lifted, z, run.p, radius, run.budget, only_violation=only_violation)
        if near is None or radius < smallest:
            break
        trial, sides = near
        at = lifted.pairs[sides]
        if np.max(trial[at], initial=0.0) > _ON * radius:
            radius *= _REACH
            continue
        trial[at] = 0.0
        predicted = _sum(rows + jacobian @ (trial - z), nlp.lbg, nlp.ubg)
        if predicted <= _CLOSED * size:
            exact = project(run, trial, sides)
            if exact is not None and run.exact(exact):
                return Feasibility(exact, sides, Status.CONVERGED)
        violation, decrease = _sum(lifted.linearise(trial, run.p)[2], nlp.lbg, nlp.ubg), least - predicted
        if np.isfinite(least) and decrease <= _FLAT * min(least, radius):
            if _REACH * radius < min(refused, _REACH * size):
                radius *= _REACH
            elif only_violation:
                return Feasibility(
                    z, zero, Status.INFEASIBLE if _is_violated(run, z, least) else Status.STALLED
                )
            else:  # a minimum of the violation is shown without the objective
                only_violation = True
        elif not np.isfinite(least) or least - violation >= _ACCEPTED * decrease:
            if np.isfinite(least) and least - violation >= _GOOD * decrease:
                radius = min(_GROW * radius, _LARGEST * size)
            z, zero, least, refused = trial, sides, violation, np.inf
        else:
            radius, refused = _SHRINK * radius, radius
        if not np.isfinite(least):
            break
    return Feasibility(z, zero, Status.STALLED)


def _is_violated(run: Run, z: Array, violation: float) -> bool:
    return violation > run.options.feasibility * max(1.0, float(np.max(np.abs(z), initial=0.0)))


def _sum(values: Array, lower: Array, upper: Array) -> float:
    return float(np.sum(np.maximum(np.maximum(lower - values, values - upper), 0.0)))
