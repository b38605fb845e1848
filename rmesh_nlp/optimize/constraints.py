"""Constraints ``c(x) >= 0`` linearised at a point, and the multipliers that fit a gradient there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.optimize import lsq_linear, nnls

from rmesh_nlp.evaluation import Array, Mask
from rmesh_nlp.optimize.activity import BOUND_OF_AN_NLP

LARGEST_DENSE = 2_000_000
"""Entries of a matrix that is kept densely: of a least-squares problem, or a Hessian."""


@dataclass(frozen=True)
class Linearised:
    """The constraints at a point: ``slack`` (rows,) has their values c."""

    slack: Array
    jacobian: sp.csr_array

    def fitted(self, gradient: Array, inside: Mask) -> Array:
        """Multipliers of active rows: non-negative least squares for ``gradient = jacobian^T multipliers``.

        Only the variables ``inside`` their bounds count: the others have multipliers of their own.
        """
        multipliers = np.zeros(self.slack.size)
        active = np.flatnonzero(self.slack < BOUND_OF_AN_NLP)
        if active.size and np.any(inside):
            multipliers[active] = nonnegative_fit(self.jacobian[active][:, inside].T, gradient[inside])
        return multipliers


def stacked(parts: Sequence[Linearised]) -> Linearised:
    """Several constraints, one after the other."""
    slack = np.concatenate([part.slack for part in parts])
    return Linearised(slack, sp.vstack([part.jacobian for part in parts]))


def nonnegative_fit(matrix: sp.sparray, right: Array) -> Array:
    """Least squares ``matrix @ x = right`` with x >= 0."""
    if matrix.shape[0] * matrix.shape[1] <= LARGEST_DENSE:
        return nnls(matrix.toarray(), right, maxiter=30 * matrix.shape[1])[0]
    return lsq_linear(matrix, right, bounds=(0, np.inf)).x
