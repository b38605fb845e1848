"""Smooth constraints ``c(x) >= 0`` of a descent, of which few are active: linearisation and projection.

The steps that obey the linearised rows in a box are a polyhedron. The projection on it is that of the norm
``d . scale d``. Its dual has one unknown per row, is concave and piecewise quadratic, and nearly all
multipliers are zero: Newton's method on the active rows takes a few small systems, damped at a kink (a
semismooth Newton method: L. Qi, J. Sun, A nonsmooth version of Newton's method, Math. Programming 58 (1993)
353-367).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.activity import ROW_OF_A_STEP, ROW_WITH_MULTIPLIER

LARGEST_DENSE = 2_000_000
"""Entries of a least-squares matrix that is solved densely."""

MAX_STEPS, EXACT = 200, 1e-10
"""Newton steps on the dual of a projection, one factorisation each, and violation of a row at which it
ends."""

REGULAR = 1e-10
"""Part of a row's own coupling that is added to it: the rows of one element may depend on each other."""

DAMPING, DAMPING_UP, DAMPING_DOWN = 1e-4, 10.0, 0.01
"""First such part where a Newton step does not raise the dual enough; factors after failure and success."""

SHORTEN, SEARCHES, SUFFICIENT = 0.3, 8, 1e-4
"""Factor between the parts of a Newton step that are tried before it is damped, how many are tried, and least
part of the slope of the dual that an accepted one gives (Armijo's rule)."""


@dataclass(frozen=True)
class Linearised:
    """The constraints at a point.

    ``slack`` (rows,) has their values c, not negative, and ``floor`` the least ones that a step from this
    point may leave, at most the slack.
    """

    slack: Array
    floor: Array
    jacobian: sp.csr_array

    def fitted(self, gradient: Array, inside: NDArray[np.bool_]) -> Array:
        """Multipliers of active rows: non-negative least squares for ``gradient = jacobian^T multipliers``.

        Only the variables ``inside`` their bounds count: the others have multipliers of their own.
        """
        multipliers = np.zeros(self.slack.size)
        active = np.flatnonzero(self.slack < ROW_WITH_MULTIPLIER)
        if active.size and np.any(inside):
            multipliers[active] = nonnegative_fit(self.jacobian[active][:, inside].T, gradient[inside])
        return multipliers


def stacked(parts: Sequence[Linearised]) -> Linearised:
    """Several constraints, one after the other."""
    slack, floor = (np.concatenate([getattr(part, name) for part in parts]) for name in ("slack", "floor"))
    return Linearised(slack, floor, sp.csr_array(sp.vstack([part.jacobian for part in parts])))


class Constraints(Protocol):
    """Constraints that cost nothing beside the function."""

    def at(self, x: Array) -> Linearised:
        """The rows at a point."""

    def hessian(self, x: Array, multipliers: Array) -> sp.csc_array:
        """The Hessian of ``multipliers . c``."""

    def back(self, x: Array, rows: Linearised, lower: Array, upper: Array, scale: Array) -> Array | None:
        """A point of the box near ``x`` in the norm of ``scale`` that obeys the rows; None if none is found.

        Violated rows come back to the floor of ``rows``, those where the step to ``x`` began.
        """


def nonnegative_fit(matrix: sp.sparray, right: Array) -> Array:
    """Least squares ``matrix @ x = right`` with x >= 0."""
    if matrix.shape[0] * matrix.shape[1] <= LARGEST_DENSE:
        return np.asarray(nnls(matrix.toarray(), right, maxiter=30 * matrix.shape[1])[0])
    return np.asarray(lsq_linear(matrix, right, bounds=(0, np.inf)).x)


@dataclass(frozen=True)
class Face:
    """A face of the polyhedron: some rows are active, some variables are at their bounds.

    At a gradient r, ``precondition`` is ``r / scale`` less what leads out of the face, ``multipliers`` those
    of the rows by least squares.
    """

    precondition: Callable[[Array], Array]
    multipliers: Callable[[Array], Array]


@dataclass(frozen=True)
class Polyhedron:
    """Steps d with ``lower <= d <= upper`` and ``slack + jacobian d >= 0``, in the norm ``d . scale d``."""

    lower: Array
    upper: Array
    slack: Array
    jacobian: sp.csr_array
    scale: Array

    def nearest(self, d: Array) -> Array:
        """The projection of ``d`` if d = 0 is in the set, or a point on the way there if it is not found."""
        near = self.project(d)
        change = self.jacobian @ near
        short = self.slack + change < -ROW_OF_A_STEP
        if np.any(short):
            near = near * np.min(self.slack[short] / -change[short])
        return near

    def project(self, d: Array) -> Array:
        """The projection of ``d``, as exactly as Newton's method finds it."""
        multipliers = np.zeros(self.slack.size)
        near, dual = self._lagrangian(d, multipliers)
        damping = REGULAR
        for _ in range(MAX_STEPS):
            value = self.slack + self.jacobian @ near
            if np.all(np.where(multipliers > 0, np.abs(value), -value) <= EXACT):
                break
            pulling = np.flatnonzero((multipliers > 0) | (value < 0))
            inside = (near > self.lower) & (near < self.upper)
            newton = np.zeros(multipliers.size)
            newton[pulling] = -self._coupled(pulling, inside, damping)(value[pulling])
            damping = max(DAMPING, DAMPING_UP * damping)
            for k in range(SEARCHES):
                trial = np.maximum(multipliers + SHORTEN**k * newton, 0.0)
                near_there, dual_there = self._lagrangian(d, trial)
                slope = -float(value @ (trial - multipliers))
                if slope > 0 and dual_there >= dual + SUFFICIENT * slope:
                    multipliers, near, dual = trial, near_there, dual_there
                    damping = max(REGULAR, DAMPING_DOWN * damping)
                    break
        return near

    def active(self, d: Array) -> NDArray[np.int64]:
        """The rows that are active at ``d``."""
        return np.flatnonzero(self.slack + self.jacobian @ d <= ROW_OF_A_STEP)

    def face(self, rows: NDArray[np.int64], inside: NDArray[np.bool_]) -> Face:
        """The face where these rows are active and only the variables ``inside`` are free."""
        weight = inside / self.scale
        if rows.size == 0:
            return Face(lambda r: weight * r, lambda r: np.zeros(0))
        jacobian, solve = self.jacobian[rows], self._coupled(rows, inside, REGULAR)

        def multipliers(r: Array) -> Array:
            return solve(jacobian @ (weight * r))

        return Face(lambda r: weight * (r - jacobian.T @ multipliers(r)), multipliers)

    def _lagrangian(self, d: Array, multipliers: Array) -> tuple[Array, float]:
        """Where the Lagrangian of the projection is least over the box, and its value there: the dual."""
        near = np.clip(d + (self.jacobian.T @ multipliers) / self.scale, self.lower, self.upper)
        distance = 0.5 * float((near - d) @ (self.scale * (near - d)))
        return near, distance - float(multipliers @ (self.slack + self.jacobian @ near))

    def _coupled(
        self, rows: NDArray[np.int64], inside: NDArray[np.bool_], damping: float
    ) -> Callable[[Array], Array]:
        """Solves with ``J scale^-1 J^T`` of the given rows and the variables ``inside``."""
        jacobian = self.jacobian[rows]
        weighted = jacobian.copy()
        weighted.data = weighted.data * (inside / self.scale)[weighted.indices]
        added = sp.diags_array(damping * self._whole[rows])
        solve: Callable[[Array], Array] = splu(sp.csc_array(weighted @ jacobian.T + added)).solve
        return solve

    @cached_property
    def _whole(self) -> Array:
        """Diagonal of the coupling if all variables are free; 1 for a row without variables."""
        whole = np.asarray(self.jacobian.power(2) @ (1 / self.scale))
        return np.where(whole > 0, whole, 1.0)
