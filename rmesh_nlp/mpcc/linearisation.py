"""First-order data of the lifted problem at a point, and the multipliers that belong to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import IntArray, Lifted


@dataclass(frozen=True, eq=False)
class Linearisation:
    """First-order data of the lifted problem at a point, with its active sets.

    Attributes
    ----------
    gradient : array
    jacobian : csr_matrix
    row_lower, row_upper, z_lower, z_upper : bool arrays
        Which bounds of rows and unknowns are active; the zero bound of a member is left to its pair.
    G_zero, H_zero : bool arrays
        Which members are at zero. Biactive: both.
    scale : float
        ``max(1, |gradient|_inf)``: the unit of a stationarity residual.
    """

    gradient: Array
    jacobian: sp.csr_matrix
    row_lower: NDArray[np.bool_]
    row_upper: NDArray[np.bool_]
    z_lower: NDArray[np.bool_]
    z_upper: NDArray[np.bool_]
    G_zero: NDArray[np.bool_]
    H_zero: NDArray[np.bool_]

    @property
    def biactive(self) -> IntArray:
        """Pairs with both members at zero."""
        return np.flatnonzero(self.G_zero & self.H_zero).astype(np.int64)

    @property
    def scale(self) -> float:
        """Unit of a stationarity residual."""
        return max(1.0, float(np.max(np.abs(self.gradient), initial=0.0)))


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the lifted problem: of rows, of bounds of z, of the members of the pairs."""

    rows: Array
    z: Array
    G: Array
    H: Array


def linearisation(lifted: Lifted, z: Array, p: Array, tolerance: float, corner: float) -> Linearisation:
    """Derivatives and active sets at ``z``.

    A row or bound is active within ``tolerance (1 + |bound|)``, a member is zero below ``corner``. A row with
    a steep gradient is measured in units of it: what counts is how far away in the unknowns the bound is.
    """
    _, gradient, rows, jacobian = lifted.linearise(z, p)
    steep = steepness(jacobian)
    nlp = lifted.nlp
    zero = lifted.member & (nlp.lbx == 0)
    return Linearisation(
        gradient=gradient,
        jacobian=jacobian,
        row_lower=_active(rows / steep, nlp.lbg / steep, tolerance),
        row_upper=_active(rows / steep, nlp.ubg / steep, tolerance),
        z_lower=_active(z, nlp.lbx, tolerance) & ~zero,
        z_upper=_active(z, nlp.ubx, tolerance),
        G_zero=np.abs(z[lifted.first]) <= corner,
        H_zero=np.abs(z[lifted.second]) <= corner,
    )


def steepness(jacobian: sp.csr_matrix) -> Array:
    """Largest entry of each row, at least 1."""
    if jacobian.shape[1] == 0:
        return np.ones(jacobian.shape[0])
    largest: Array = abs(jacobian).max(axis=1).toarray().ravel()
    return np.maximum(1.0, largest)


def _active(value: Array, bound: Array, tolerance: float) -> NDArray[np.bool_]:
    finite = np.isfinite(bound)
    return finite & (
        np.abs(value - np.where(finite, bound, 0.0)) <= tolerance * (1 + np.abs(np.where(finite, bound, 0.0)))
    )


def lagrangian_gradient(lifted: Lifted, lin: Linearisation, m: Multipliers) -> Array:
    """Gradient of the MPCC Lagrangian in z."""
    value = lin.gradient + lin.jacobian.T @ m.rows + m.z
    np.add.at(value, lifted.first, m.G)
    np.add.at(value, lifted.second, m.H)
    return value
