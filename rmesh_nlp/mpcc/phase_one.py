"""Phase I: a feasible complementary point, or a local minimum of the violation.

A linear program with equilibrium constraints (LPEC) names the branch that lowers the sum of the violations
of all rows most within a trust region, and Ipopt minimises that sum on the branch. The region shrinks where
the branch does not keep what the linearisation promised. Where no branch lowers it, the point is a local
minimum of the violation to first order: "locally infeasible" rests on it. A solver that stops at a violation
proves nothing. The LPEC is that of MPECopt: A. Nurkanovic and S. Leyffer, A globally convergent method for
computing B-stationary points of mathematical programs with equilibrium constraints, arXiv 2501.13835, 2025.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lpec import nearest_branch
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status

_STEPS = 80
_SHRINK = 0.25  # of the trust region
_FLAT = 1e-4  # decrease of the violation, in units of itself or per length, that is none


def phase_one(run: Run, z: Array) -> tuple[Array, Status]:
    """Look for a feasible complementary point near ``z``, on the lower one of branches that do as well.

    CONVERGED: the point is feasible and complementary; INFEASIBLE: a local minimum of a positive violation,
    to first order; STALLED: neither was shown.
    """
    lifted, nlp = run.lifted, run.lifted.nlp
    z = np.clip(z, nlp.lbx, nlp.ubx)
    z[lifted.pairs[lifted.smaller(z)]] = 0.0
    size = 1.0 + float(np.max(np.abs(z), initial=0.0))
    tolerance, radius, only_violation = run.options.feasibility * size, size, False
    for _ in range(_STEPS):
        _, gradient, rows, jacobian = lifted.linearise(z, run.p)
        if not all(np.all(np.isfinite(part)) for part in (z, gradient, rows, jacobian.data)):
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
        if not np.isfinite(run.nlps.excess(trial, run.p)):  # the functions are not defined there
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
