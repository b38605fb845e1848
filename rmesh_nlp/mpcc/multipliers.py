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
    lin : Linearisation
    matrix : sparse (n_x, number of columns)
    active : int array
        The active ones of the rows and of the unknowns, in one numbering.
    members : int array
        Places of the zero members in the raveled pairs.
    unknowns : int array
        The unknown that a bound or a member is, of the columns after the ``n_rows`` first.
    corner : bool array
        Of each column whether it is a member of a biactive pair.
    may_fall, may_rise : bool arrays
        Whether a multiplier may be negative (of a lower bound, and of every member) and positive, with the
        signs of W. With those of S multipliers of the corner may not rise.
    """

    lin: Linearisation
    matrix: sp.csc_matrix
    active: Index
    members: Index
    unknowns: Index
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
        own, pairs = np.zeros(self.lin.lower.size), np.zeros(self.lin.zero.shape)
        own[self.active], pairs.reshape(-1)[self.members] = np.split(values, [self.active.size])
        n_rows = self.lin.jacobian.shape[0]
        return Multipliers(own[:n_rows], own[n_rows:], pairs)

    def gathered(self, multipliers: Multipliers) -> Array:
        """The multipliers of the columns."""
        own = np.append(multipliers.rows, multipliers.z)[self.active]
        return np.append(own, multipliers.pairs.reshape(-1)[self.members])


def columns_of(lifted: Lifted, lin: Linearisation) -> Columns:
    """What is active at a linearised point."""
    n_g, active = lifted.nlp.n_g, np.flatnonzero(lin.lower | lin.upper)
    rows = active[active < n_g]
    unknowns = np.append(active[rows.size :] - n_g, lifted.pairs[lin.zero])
    eye, every = sp.identity(lifted.nlp.n_x, format="csc"), np.ones(np.count_nonzero(lin.zero), dtype=bool)
    return Columns(
        lin=lin,
        matrix=sp.hstack([lin.jacobian[rows].T, eye[:, unknowns]], format="csc"),
        active=active,
        members=np.flatnonzero(lin.zero),
        unknowns=unknowns,
        corner=np.append(np.zeros(active.size, dtype=bool), (lin.zero & lin.zero[::-1])[lin.zero]),
        may_fall=np.append(lin.lower[active], every),
        may_rise=np.append(lin.upper[active], every),
    )


def proving(lifted: Lifted, lin: Linearisation, lam_rows: Array, tolerance: float) -> Multipliers | None:
    """Multipliers with the signs of S from those of the rows at the end of a solve; None if they have others.

    Those of bounds and members are what the Lagrangian leaves to them. It is stationary within ``tolerance``.
    """
    columns = columns_of(lifted, lin)
    n_rows, unknowns = columns.n_rows, columns.unknowns
    values = columns.signed(np.append(lam_rows[columns.active[:n_rows]], np.zeros(unknowns.size)))
    rest = -(lin.gradient + columns.matrix @ values)
    # an unknown may be a member of several pairs: the one with the freest sign takes all
    order = np.argsort(columns.corner[n_rows:], kind="stable")
    distinct, first = np.unique(unknowns[order], return_index=True)
    values[n_rows + order[first]] = rest[distinct]
    values = columns.signed(values)
    residual = magnitude(lin.gradient + columns.matrix @ values)
    return columns.scattered(values) if residual <= tolerance * lin.scale else None
