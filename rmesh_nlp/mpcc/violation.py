"""Whether a point is a local minimum of the violation: what "locally infeasible" rests on.

A solver that stops at a violation proves nothing: it may have run out of iterations, or be stuck in a
relaxation. Here the sum of the violations of all rows is minimised over complementary points by a
sequence of linear programs with equilibrium constraints within a trust region. Where the program of a point
lowers the linearised violation no further, over all branches, the point is a local minimum to first order.
R. Fletcher, S. Leyffer, D. Ralph, S. Scholtes, Local convergence of SQP methods for MPECs, SIAM J. Optim.
17 (2006); S. Leyffer, T. Munson, A globally convergent filter method for MPECs, 2007.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lpec import nearest_branch
from rmesh_nlp.mpcc.run import Run

_STEPS = 40
_RADIUS = 1.0  # relative to the largest unknown
_SMALLEST = 1e-7
_FLAT = 1e-4  # decrease of the violation, in units of itself or per length, that is none
_ACCEPTED = 0.1  # part of the predicted decrease


def is_locally_infeasible(run: Run, z: Array) -> bool:
    """Whether the violation has a positive local minimum, to first order, where a descent from ``z`` ends."""
    nlp, lifted = run.lifted.nlp, run.lifted
    if not np.all(np.isfinite(z)):
        return False
    least, radius = np.inf, _RADIUS * (1.0 + float(np.max(np.abs(z), initial=0.0)))
    for _ in range(_STEPS):
        run.check()
        near = nearest_branch(lifted, z, run.p, radius, run.seconds_left, only_violation=True)
        if near is None:
            return False
        _, _, rows, jacobian = lifted.linearise(z, run.p)
        predicted = _sum(rows + jacobian @ (near[0] - z), nlp.lbg, nlp.ubg)
        found = _sum(lifted.linearise(near[0], run.p)[2], nlp.lbg, nlp.ubg)
        if not np.isfinite(found) and not np.isfinite(least):
            return False
        decrease = least - predicted
        if np.isfinite(least) and decrease <= _FLAT * min(least, radius):
            return bool(least > run.options.feasibility * max(1.0, float(np.max(np.abs(z), initial=0.0))))
        if not np.isfinite(least) or least - found >= _ACCEPTED * decrease:
            z, least = near[0], found
        else:
            radius /= 4
        if radius < _SMALLEST:
            return False
    return False


def _sum(values: Array, lower: Array, upper: Array) -> float:
    return float(np.sum(np.maximum(np.maximum(lower - values, values - upper), 0.0)))
