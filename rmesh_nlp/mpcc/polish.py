"""From a relaxed solution to the exact one of its branch, without another interior-point solve.

A relaxed solution at t is O(t) away from the solution of the branch it belongs to, and its multipliers say
which rows and bounds are active. A few Newton steps on the KKT system of those (a primal-dual active set
method) end at rounding. The same system with the identity for the Hessian is a least-norm Gauss-Newton
projection onto the branch. Both are regularised: a branch may have more equations than free unknowns
(discretised dynamics), where an interior-point method has nothing to do or refuses.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.factors import factorised
from rmesh_nlp.mpcc.lifting import BoolArray, IntArray, Lifted
from rmesh_nlp.mpcc.lpec import steepness
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.budget import Budget

Active = NDArray[np.int8]
"""Of each row, then of each unknown: -1 at the lower bound, 1 at the upper, 0 at none; equations at -1."""

_STEPS = 12
_REACH = 1.0  # a correction that moves an unknown further than this, relative to 1 + |z|, is no correction
_PROXIMAL = 1e-10  # added to the Hessian: small, so that flat objectives end sharp
_DUAL = 1e-9  # subtracted in the block of the rows, which may be dependent
_STILL = 1e-8  # change of f, relative to 1 + |f|, of a last step that was not quadratic any more
_SHARP = 1e-3  # where Newton steps end, in units of what is accepted
_SHARE = 0.1  # of the tolerances: what follows shall not stumble over them
_VIOLATED = 1e-10  # distance beyond a bound, relative to 1 + |value|, from which on it becomes active


class _Branch:
    """Bounds of rows and unknowns of a branch: those of the lifted problem, zero for the fixed members."""

    def __init__(self, lifted: Lifted, zero: BoolArray) -> None:
        nlp = lifted.nlp
        self.lower, self.upper = np.append(nlp.lbg, nlp.lbx), np.append(nlp.ubg, nlp.ubx)
        self.n_rows = nlp.n_g
        self.uppermost = self.upper.copy()
        fixed = self.n_rows + lifted.pairs[zero]
        self.lower[fixed] = self.upper[fixed] = 0.0
        self.equal = self.lower == self.upper
        self.places = self.n_rows + lifted.pairs

    def release(self, active: Active, lam: Array, tolerance: float) -> Active:
        """Let a member with a multiplier of the wrong sign leave zero where both members of a pair are there.

        f falls along it; the other member becomes the fixed one. Of two such members the one with the larger
        multiplier leaves.
        """
        places = self.places[:, np.all(active[self.places] == -1, axis=0)]
        first = lam[places[0]] > lam[places[1]]
        places = np.where(first, places, places[::-1])[:, np.max(lam[places], axis=0) > tolerance]
        leaves, stays = places
        after = active.copy()
        self.equal[leaves], self.upper[leaves], after[leaves] = False, self.uppermost[leaves], 0
        self.equal[stays], self.upper[stays], after[stays] = True, 0.0, -1
        return after

    def first_active(self, values: Array, lam: Array, size: Array) -> Active:
        """Active where the multiplier outweighs the distance; both in units of ``size``."""
        value = values / size
        active = np.zeros(values.shape, dtype=np.int8)
        active[(value - self.lower / size) / (1 + np.abs(value)) < -lam * size] = -1
        active[(self.upper / size - value) / (1 + np.abs(value)) < lam * size] = 1
        active[self.equal] = -1
        return active

    def next_active(self, active: Active, values: Array, lam: Array, tolerance: float) -> Active:
        """Add what is violated, drop what has a multiplier of the wrong sign."""
        after = active.copy()
        after[(active == -1) & (lam > tolerance)] = 0
        after[(active == 1) & (lam < -tolerance)] = 0
        slack = _VIOLATED * (1 + np.abs(values))
        after[(active == 0) & (values < self.lower - slack)] = -1
        after[(active == 0) & (values > self.upper + slack)] = 1
        after[self.equal] = -1
        return after

    def step(
        self,
        active: Active,
        values: Array,
        slope: Array,
        jacobian: sp.csr_matrix,
        hessian: sp.csc_matrix,
        proximal: float,
        budget: Budget | None = None,
    ) -> tuple[Array, Array] | None:
        """Newton steps in z and in the multipliers of the rows; active bounds are met and eliminated.

        ``slope`` is the gradient of the Lagrangian without the bounds; None if the system is singular.
        """
        gap = np.where(active > 0, self.upper, self.lower) - values
        at_bound, on = active[self.n_rows :] != 0, np.flatnonzero(active[: self.n_rows])
        free = np.flatnonzero(~at_bound)
        step = np.zeros(at_bound.size)
        step[at_bound] = gap[self.n_rows :][at_bound]
        right = np.append(-(slope + hessian @ step)[free], (gap[: self.n_rows] - jacobian @ step)[on])
        system = _kkt_matrix(hessian, jacobian, free, on, proximal)
        if not np.all(np.isfinite(system.data)) or not np.all(np.isfinite(right)):
            return None
        try:
            solution = factorised(system, lambda solve: solve(right), budget)
        except RuntimeError:  # exactly singular
            return None
        step[free] = solution[: free.size]
        change = np.zeros(self.n_rows)
        change[on] = solution[free.size :]
        return step, change


def _kkt_matrix(
    hessian: sp.csc_matrix, jacobian: sp.csr_matrix, free: IntArray, on: IntArray, proximal: float
) -> sp.csc_matrix:
    """``[H A^T; A 0]`` of the free unknowns and the active rows, regularised; put together in one go."""
    n, size = free.size, free.size + on.size
    of_z, of_row = np.full(hessian.shape[0], -1), np.full(jacobian.shape[0], -1)
    of_z[free], of_row[on] = np.arange(n), np.arange(n, size)
    H, A, diagonal = hessian.tocoo(), jacobian.tocoo(), np.arange(size)
    rows = np.concatenate([of_z[H.row], of_row[A.row], of_z[A.col], diagonal])
    columns = np.concatenate([of_z[H.col], of_z[A.col], of_row[A.row], diagonal])
    shift = np.repeat([proximal, -_DUAL], [n, on.size])
    values = np.concatenate([H.data, A.data, A.data, shift])
    kept = (rows >= 0) & (columns >= 0)
    return sp.csc_matrix((values[kept], (rows[kept], columns[kept])), shape=(size, size))


def polish(run: Run, z: Array, zero: BoolArray, lam_rows: Array, lam_z: Array) -> tuple[Array, float] | None:
    """Newton's method on the KKT system of a branch: its point and f, None if it does not end near ``z``.

    Members leave zero where both of a pair are there and f falls along them.
    """
    lifted = run.lifted
    if lifted.hessian is None:
        return None
    branch, origin = _Branch(lifted, zero), z
    n_rows = branch.n_rows
    f, gradient, rows, jacobian = lifted.linearise(z, run.p)
    unit = max(1.0, float(np.max(np.abs(gradient), initial=0.0)))
    tolerance = _SHARE * run.options.stationarity * unit
    size = np.append(steepness(jacobian), np.ones(z.size))
    active = branch.first_active(np.append(rows, z), np.append(lam_rows, lam_z) / unit, size)
    lam_rows = np.where(active[:n_rows] != 0, lam_rows, 0.0)
    last = np.inf
    for _ in range(_STEPS):
        run.budget.check()
        hessian = lifted.curvature(z, run.p, lam_rows)
        slope = gradient + jacobian.T @ lam_rows
        step = branch.step(active, np.append(rows, z), slope, jacobian, hessian, _PROXIMAL, run.budget)
        if step is None or not _is_near(z + step[0], origin):
            return None
        before, z, lam_rows = f, z + step[0], lam_rows + step[1]
        f, gradient, rows, jacobian = lifted.linearise(z, run.p)
        lam_z = -(gradient + jacobian.T @ lam_rows)
        held = active[n_rows:] != 0
        residual = float(np.max(np.abs(lam_z[~held]), initial=0.0))
        if not np.isfinite(f) or not np.isfinite(residual):
            return None
        after = branch.next_active(active, np.append(rows, z), np.append(lam_rows, lam_z), tolerance)
        after = branch.release(after, np.append(lam_rows, lam_z), tolerance)
        worst = max(residual / tolerance, run.nlps.excess(z, run.p) / _SHARE)
        still = worst > 0.1 * last and abs(f - before) <= _STILL * (1 + abs(f))
        if np.array_equal(after, active) and (worst <= _SHARP or (worst <= 1.0 and still)):
            return z, f
        active, last = after, worst
        lam_rows = np.where(active[:n_rows] != 0, lam_rows, 0.0)
    return None


def _is_near(z: Array, origin: Array) -> bool:
    return bool(np.all(np.isfinite(z)) and np.all(np.abs(z - origin) <= _REACH * (1 + np.abs(origin))))
