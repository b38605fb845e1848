"""Multipliers of a linearised point: ``lambda`` with ``gradient + M lambda = 0``.

The columns of M are the gradients of active rows, of active bounds and of zero members of pairs. Those with
which a solve ended prove S where they have its signs. Linear programs over the same columns (see
``stationarity``) decide the cases that are left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.lpec import Linearisation


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the lifted problem: of rows, of bounds of z, of members (2, n_pairs)."""

    rows: Array
    z: Array
    pairs: Array


class Columns:
    """Gradients of the rows, the bounds of z and the members of pairs at a linearised point.

    Attributes
    ----------
    matrix : sparse (n_x, number of columns)
    corner : bool array
        Of each column whether it is a member of a biactive pair.
    low, high : arrays
        Bounds of the multipliers with the signs of S: that of an active lower bound, and of every zero
        member, may be negative; that of a member of the corner may not be positive.
    """

    def __init__(self, lifted: Lifted, lin: Linearisation) -> None:
        self._ends = lifted.nlp.n_g, lin.lower.size
        eye = sp.identity(lifted.nlp.n_x, format="csc")
        self.matrix = sp.hstack([lin.jacobian.T, eye, eye[:, lifted.pairs.ravel()]], format="csc")
        corner = lin.zero & lin.zero[::-1]
        self.corner = np.append(np.zeros_like(lin.lower), corner)
        self.low = np.where(np.append(lin.lower, lin.zero), -np.inf, 0.0)
        self.high = np.where(np.append(lin.upper, lin.zero & ~corner), np.inf, 0.0)

    def split(self, values: Array) -> Multipliers:
        """Multipliers of the columns by their kinds."""
        rows, z, pairs = np.split(values, self._ends)
        return Multipliers(rows, z, pairs.reshape(2, -1))


def proving(lifted: Lifted, lin: Linearisation, lam_rows: Array, tolerance: float) -> Multipliers | None:
    """Multipliers with the signs of S from those of the rows at the end of a solve; None if they have others.

    Those of bounds and members are what the Lagrangian leaves to them. It is stationary within ``tolerance``.
    """
    columns, n_rows, n_x = Columns(lifted, lin), lifted.nlp.n_g, lifted.nlp.n_x
    values = np.zeros(columns.corner.size)
    values[:n_rows] = lam_rows[:n_rows]
    values = np.clip(values, columns.low, columns.high)
    rest = -(lin.gradient + columns.matrix @ values)
    # an unknown may be a member of several pairs: the one with the freest sign takes all
    order = np.argsort(columns.corner, kind="stable")
    order = order[(columns.low < columns.high)[order] & (order >= n_rows)]
    unknowns, first = np.unique(np.append(np.arange(n_x), lifted.pairs)[order - n_rows], return_index=True)
    values[order[first]] = rest[unknowns]
    values = np.clip(values, columns.low, columns.high)
    residual = magnitude(lin.gradient + columns.matrix @ values)
    return columns.split(values) if residual <= tolerance * lin.scale else None
