"""From a relaxed solution to the exact one of its branch, without another interior-point solve.

A relaxed solution at t is O(t) away from the solution of the branch it belongs to, and its multipliers say
which rows and bounds are active. A few Newton steps on the KKT system of those (a primal-dual active set
method) end at rounding. The same system with the identity for the Hessian is a least-norm Gauss-Newton
projection onto the branch. Both are regularised: a branch may have more equations than free unknowns
(discretised dynamics), where an interior-point method has nothing to do or refuses.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.linearisation import steepness
from rmesh_nlp.mpcc.programs import BoolArray
from rmesh_nlp.mpcc.run import Run

_STEPS = 12
_REACH = 1.0  # a correction that moves an unknown further than this, relative to 1 + |z|, is no correction
# Added to the Hessian: small, so that flat objectives end sharp, then larger, for directions without
# curvature in which rounding of the gradient would be a long step.
_PROXIMAL = (1e-10, 1e-7)
_DUAL = 1e-9  # subtracted in the block of the rows, which may be dependent
_STILL = 1e-8  # change of f, relative to 1 + |f|, of a last step that was not quadratic any more
_SHARP = 1e-3  # where Newton steps end, in units of what is accepted
_SHARE = 0.1  # of the tolerances: what follows shall not stumble over them


@dataclass(frozen=True, eq=False)
class Polished:
    """A point of a branch with multipliers of the lifted program."""

    z: Array
    f: float
    lam_rows: Array
    lam_z: Array


@dataclass(frozen=True, eq=False)
class _Active:
    """Active rows and bounds: -1 at the lower, 1 at the upper, 0 not active; equations count as lower."""

    rows: NDArray[np.int8]
    z: NDArray[np.int8]

    def same(self, other: _Active) -> bool:
        return np.array_equal(self.rows, other.rows) and np.array_equal(self.z, other.z)


class _Branch:
    """Bounds of a branch: those of the lifted program, and zero for the fixed members."""

    def __init__(self, lifted: Lifted, fix_G: BoolArray, fix_H: BoolArray) -> None:
        nlp = lifted.nlp
        self.lower, self.upper = nlp.lbx.copy(), nlp.ubx.copy()
        places = np.concatenate([lifted.first[fix_G], lifted.second[fix_H]])
        self.lower[places] = self.upper[places] = 0.0
        self.row_lower, self.row_upper = nlp.lbg, nlp.ubg
        self.pinned = self.lower == self.upper
        self.equal = self.row_lower == self.row_upper

    def first_active(
        self, z: Array, rows: Array, lam_z: Array, lam_rows: Array, unit: float, steep: Array
    ) -> _Active:
        """Active where the multiplier, in units of the objective's gradient, outweighs the distance.

        Rows are divided by ``steep``, the size of their gradients, and their multipliers multiplied.
        """
        lower, upper = self.row_lower / steep, self.row_upper / steep
        return _Active(
            _outweigh(rows / steep, lower, upper, lam_rows * steep / unit, self.equal),
            _outweigh(z, self.lower, self.upper, lam_z / unit, self.pinned),
        )

    def next_active(
        self, before: _Active, z: Array, rows: Array, lam_z: Array, lam_rows: Array, tolerance: float
    ) -> _Active:
        """Add what is violated, drop what has a multiplier of the wrong sign."""
        return _Active(
            _exchange(before.rows, rows, self.row_lower, self.row_upper, lam_rows, self.equal, tolerance),
            _exchange(before.z, z, self.lower, self.upper, lam_z, self.pinned, tolerance),
        )


def _outweigh(value: Array, lower: Array, upper: Array, lam: Array, equal: BoolArray) -> NDArray[np.int8]:
    active = np.zeros(value.shape, dtype=np.int8)
    active[(value - lower) / (1 + np.abs(value)) < -lam] = -1
    active[(upper - value) / (1 + np.abs(value)) < lam] = 1
    active[equal] = -1
    return active


def _exchange(
    active: NDArray[np.int8],
    value: Array,
    lower: Array,
    upper: Array,
    lam: Array,
    equal: BoolArray,
    tolerance: float,
) -> NDArray[np.int8]:
    after = active.copy()
    after[(active == -1) & (lam > tolerance)] = 0
    after[(active == 1) & (lam < -tolerance)] = 0
    slack = 1e-10 * (1 + np.abs(value))
    after[(active == 0) & (value < lower - slack)] = -1
    after[(active == 0) & (value > upper + slack)] = 1
    after[equal] = -1
    return after


def polish(
    run: Run, z: Array, fix_G: BoolArray, lam_rows: Array, lam_z: Array, fix_H: BoolArray | None = None
) -> Polished | None:
    """Newton's method on the KKT system of the branch; None if it does not end, exact, near ``z``.

    G is zero where ``fix_G``, H where ``fix_H`` (None: elsewhere).
    """
    branch = _Branch(run.programs.lifted, fix_G, ~fix_G if fix_H is None else fix_H)
    for proximal in _PROXIMAL:
        found = _newton(run, z, branch, lam_rows, lam_z, proximal)
        if found is not None:
            return found
    return None


def _newton(
    run: Run, z: Array, branch: _Branch, lam_rows: Array, lam_z: Array, proximal: float
) -> Polished | None:
    lifted, options = run.programs.lifted, run.programs.options
    if lifted.hessian is None:
        return None
    origin, room = z, _REACH * (1 + np.abs(z))
    f, gradient, rows, jacobian = lifted.linearise(z, run.p)
    unit = max(1.0, float(np.max(np.abs(gradient), initial=0.0)))
    tolerance = _SHARE * options.stationarity * unit
    active = branch.first_active(z, rows, lam_z, lam_rows, unit, steepness(jacobian))
    lam_rows = np.where(active.rows != 0, lam_rows, 0.0)
    last = np.inf
    for _ in range(_STEPS):
        run.check()
        hessian = lifted.curvature(z, run.p, lam_rows)
        step = _newton_step(branch, active, z, gradient, rows, jacobian, hessian, lam_rows, proximal)
        if step is None:
            return None
        before, z, lam_rows = f, z + step[0], lam_rows + step[1]
        if not np.all(np.isfinite(z)) or np.any(np.abs(z - origin) > room):
            return None
        f, gradient, rows, jacobian = lifted.linearise(z, run.p)
        lam_z = -(gradient + jacobian.T @ lam_rows)
        residual = float(np.max(np.abs(lam_z[active.z == 0]), initial=0.0))
        if not np.isfinite(f) or not np.isfinite(residual):
            return None
        after = branch.next_active(active, z, rows, lam_z, lam_rows, tolerance)
        worst = max(residual / tolerance, run.programs.excess(z, run.p) / _SHARE)
        still = worst > 0.1 * last and abs(f - before) <= _STILL * (1 + abs(f))
        if after.same(active) and (worst <= _SHARP or (worst <= 1.0 and still)):
            return Polished(z, f, lam_rows, np.where(active.z != 0, lam_z, 0.0))
        active, last = after, worst
        lam_rows = np.where(active.rows != 0, lam_rows, 0.0)
    return None


def project(run: Run, z: Array, fix_G: BoolArray) -> Array | None:
    """A point of the branch near ``z`` by Gauss-Newton steps of least norm; None if there is none."""
    lifted = run.programs.lifted
    branch = _Branch(lifted, fix_G, ~fix_G)
    origin, room = z, _REACH * (1 + np.abs(z))
    _, _, rows, jacobian = lifted.linearise(z, run.p)
    zero, none = np.zeros(rows.size), np.zeros(z.size)
    active = branch.first_active(z, rows, none, zero, 1.0, np.ones(rows.size))
    identity = sp.identity(z.size, format="csc")
    for _ in range(_STEPS):
        run.check()
        active = branch.next_active(active, z, rows, none, zero, 1.0)
        step = _newton_step(branch, active, z, none, rows, jacobian, identity, zero, 0.0)
        if step is None:
            return None
        z = z + step[0]
        if not np.all(np.isfinite(z)) or np.any(np.abs(z - origin) > room):
            return None
        if run.programs.excess(z, run.p) <= _SHARE:
            return z
        _, _, rows, jacobian = lifted.linearise(z, run.p)
    return z if run.exact(z) else None


def _newton_step(
    branch: _Branch,
    active: _Active,
    z: Array,
    gradient: Array,
    rows: Array,
    jacobian: sp.csr_matrix,
    hessian: sp.csc_matrix,
    lam_rows: Array,
    proximal: float,
) -> tuple[Array, Array] | None:
    """Steps in z and in the multipliers of the rows; active bounds are met exactly and eliminated."""
    at_bound = active.z != 0
    free, on = np.flatnonzero(~at_bound), np.flatnonzero(active.rows)
    step = np.zeros(z.size)
    bound = np.where(active.z > 0, branch.upper, branch.lower)
    step[at_bound] = bound[at_bound] - z[at_bound]
    aim = np.where(active.rows > 0, branch.row_upper, branch.row_lower)[on]
    A = jacobian[on].tocsc()
    right = np.concatenate(
        [
            -(gradient + jacobian.T @ lam_rows + hessian @ step)[free],
            aim - rows[on] - A @ step,
        ]
    )
    inner = A[:, free]
    system = sp.bmat(
        [
            [hessian[free][:, free] + proximal * sp.identity(free.size), inner.T],
            [inner, -_DUAL * sp.identity(on.size)],
        ],
        format="csc",
    )
    if not np.all(np.isfinite(system.data)) or not np.all(np.isfinite(right)):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01).solve(right)
    except RuntimeError:  # exactly singular
        return None
    step[free] = solution[: free.size]
    change = np.zeros(lam_rows.size)
    change[on] = solution[free.size :]
    return step, change
