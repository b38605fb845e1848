"""Multipliers of a linearised point: ``lambda`` with ``gradient + M lambda = 0``.

The columns of M are the gradients of active rows, of active bounds and of zero members of pairs. Those with
which a solve ended prove S where they have its signs. Linear programs over the same columns (see
``stationarity``) decide the cases that are left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Index, Mask, magnitude
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.lpec import Linearisation


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the lifted problem: of rows, of bounds of z, of members (2, n_pairs)."""

    rows: Array
    z: Array
    pairs: Array


@dataclass(frozen=True, eq=False)
class Columns:
    """Gradients of what is active at a linearised point: rows, then bounds, then zero members of pairs.

    Attributes
    ----------
    matrix : sparse (n_x, number of columns)
    mask : bool array
        Which of the rows, unknowns and raveled pairs have a column.
    ends : int, int
        Where the rows and where the unknowns end among these.
    unknowns : int array
        The unknown that a bound or a member is, of the columns after the ``n_rows`` first.
    pair : int array
        Of each column the pair that it is a member of, or -1.
    corner : bool array
        Of each column whether it is a member of a biactive pair.
    may_fall, may_rise : bool arrays
        Whether a multiplier may be negative (of a lower bound, and of every member) and positive, with the
        signs of W. With those of S multipliers of the corner may not rise.
    """

    matrix: sp.csc_matrix
    mask: Mask
    ends: tuple[int, int]
    unknowns: Index
    pair: Index
    corner: Mask
    may_fall: Mask
    may_rise: Mask

    @property
    def n_rows(self) -> int:
        """Number of active rows."""
        return self.corner.size - self.unknowns.size

    def signed(self, values: Array) -> Array:
        """Each multiplier cut to the signs that S allows."""
        may_rise = self.may_rise & ~self.corner
        fallen, risen = np.minimum(values, 0.0), np.maximum(values, 0.0)
        return np.where(self.may_fall, fallen, 0.0) + np.where(may_rise, risen, 0.0)

    def scattered(self, values: Array) -> Multipliers:
        """Multipliers of the columns at their places."""
        every = np.zeros(self.mask.size)
        every[self.mask] = values
        rows, z, pairs = np.split(every, self.ends)
        return Multipliers(rows, z, pairs.reshape(2, -1))


def columns_of(lifted: Lifted, lin: Linearisation) -> Columns:
    """What is active at a linearised point."""
    n_g, n_x, k = lifted.nlp.n_g, lifted.nlp.n_x, lifted.pairs.shape[1]
    members, none = lifted.pairs.ravel(), np.zeros(n_g + n_x, dtype=bool)
    may_fall, may_rise = np.append(lin.lower, lin.zero), np.append(lin.upper, lin.zero)
    mask, eye = may_fall | may_rise, sp.identity(n_x, format="csc")
    return Columns(
        matrix=sp.hstack([lin.jacobian.T, eye, eye[:, members]], format="csc")[:, mask],
        mask=mask,
        ends=(n_g, n_g + n_x),
        unknowns=np.append(np.arange(n_x), members)[mask[n_g:]],
        pair=np.append(np.full(none.size, -1), np.tile(np.arange(k), 2))[mask],
        corner=np.append(none, lin.zero & lin.zero[::-1])[mask],
        may_fall=may_fall[mask],
        may_rise=may_rise[mask],
    )


def proving(lifted: Lifted, lin: Linearisation, lam_rows: Array, tolerance: float) -> Multipliers | None:
    """Multipliers with the signs of S from those of the rows at the end of a solve; None if they have others.

    Those of bounds and members are what the Lagrangian leaves to them. It is stationary within ``tolerance``.
    """
    columns = columns_of(lifted, lin)
    n_rows, unknowns = columns.n_rows, columns.unknowns
    active = columns.mask[: lam_rows.size]
    values = columns.signed(np.append(lam_rows[active], np.zeros(unknowns.size)))
    rest = -(lin.gradient + columns.matrix @ values)
    # an unknown may be a member of several pairs: the one with the freest sign takes all
    order = np.argsort(columns.corner[n_rows:], kind="stable")
    distinct, first = np.unique(unknowns[order], return_index=True)
    values[n_rows + order[first]] = rest[distinct]
    values = columns.signed(values)
    residual = magnitude(lin.gradient + columns.matrix @ values)
    return columns.scattered(values) if residual <= tolerance * lin.scale else None
