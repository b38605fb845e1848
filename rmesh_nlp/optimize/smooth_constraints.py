"""Smooth constraints ``c(x) >= 0`` of a descent, many of them, few of which are met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.activity import ROW_WITH_MULTIPLIER

LARGEST_DENSE = 2_000_000
"""Entries of a least-squares matrix that is solved densely."""


@dataclass(frozen=True)
class Wall:
    """The rows at a point.

    Attributes
    ----------
    slack : (rows,) array
        Their values c, not negative.
    floor : (rows,) array
        Least value that a step from this point may leave; at most the slack.
    jacobian : (rows, n) sparse array, by rows
    """

    slack: Array
    floor: Array
    jacobian: sp.csr_array

    def fitted(self, gradient: Array, inside: NDArray[np.bool_]) -> Array:
        """Multipliers of active rows: non-negative least squares for ``gradient = jacobian^T multipliers``.

        Only the variables that are ``inside`` their bounds count; the others have multipliers of
        their own. Rows that are not active have zero.
        """
        multipliers = np.zeros(self.slack.size)
        active = np.flatnonzero(self.slack < ROW_WITH_MULTIPLIER)
        if active.size and np.any(inside):
            multipliers[active] = nonnegative_fit(self.jacobian[active][:, inside].T, gradient[inside])
        return multipliers


class Walls(Protocol):
    """Constraints that cost nothing beside the function."""

    def at(self, x: Array) -> Wall:
        """The rows at a point."""

    def hessian(self, x: Array, multipliers: Array) -> sp.csc_array:
        """The Hessian of ``multipliers . c``."""

    def back(self, x: Array, wall: Wall, lower: Array, upper: Array, scale: Array) -> Array | None:
        """A point of the box near ``x`` that obeys the rows, in the norm of ``scale``; None if none is found.

        ``wall`` is where the step to ``x`` began: rows that are not obeyed come back to its floor.
        """


def nonnegative_fit(matrix: Any, right: Array) -> Array:
    """Least squares ``matrix @ x = right`` with x >= 0, for a sparse matrix."""
    if matrix.shape[0] * matrix.shape[1] <= LARGEST_DENSE:
        return np.asarray(nnls(matrix.toarray(), right, maxiter=30 * matrix.shape[1])[0])
    return np.asarray(lsq_linear(matrix, right, bounds=(0, np.inf)).x)
