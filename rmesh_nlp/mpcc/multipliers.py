"""Multipliers of a linearised point: ``lambda`` with ``gradient + M lambda = 0``.

The columns of M are the gradients of active rows, of active bounds and of zero members of pairs. Those with
which a solve ended prove S where they have its signs. Linear programs over the same columns (see
``stationarity``) decide the cases that are left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import BoolArray, IntArray, Lifted
from rmesh_nlp.mpcc.lpec import Linearisation


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the lifted problem: of rows, of bounds of z, of members (2, n_pairs)."""

    rows: Array
    z: Array
    pairs: Array


@dataclass(frozen=True, eq=False)
class Columns:
    """Gradients of what is active at a linearised point: rows, then bounds, then zero members of pairs."""

    lifted: Lifted
    lin: Linearisation

    @cached_property
    def rows(self) -> IntArray:
        """Active rows."""
        return np.flatnonzero(self.lin.row_lower | self.lin.row_upper).astype(np.int64)

    @cached_property
    def bounds(self) -> IntArray:
        """Unknowns at a bound of their own."""
        return np.flatnonzero(self.lin.z_lower | self.lin.z_upper).astype(np.int64)

    @cached_property
    def members(self) -> IntArray:
        """Places of the zero members in the raveled pairs."""
        return np.flatnonzero(self.lin.zero).astype(np.int64)

    @cached_property
    def corner(self) -> BoolArray:
        """Of each zero member whether its pair is biactive."""
        both = self.lin.zero & self.lin.zero[::-1]
        return np.asarray(both[self.lin.zero])

    @cached_property
    def matrix(self) -> sp.csc_matrix:
        """M, (n_x, number of columns)."""
        eye = sp.identity(self.lifted.nlp.n_x, format="csc")
        places = (self.bounds, self.lifted.pairs[self.lin.zero])
        return sp.hstack([self.lin.jacobian[self.rows].T, *(eye[:, p] for p in places)], format="csc")

    @cached_property
    def may_fall(self) -> BoolArray:
        """Whether a multiplier may be negative: that of a lower bound, and of every member."""
        lin = self.lin
        yes = np.ones(self.members.size, dtype=bool)
        return np.concatenate([lin.row_lower[self.rows], lin.z_lower[self.bounds], yes])

    @cached_property
    def may_rise(self) -> BoolArray:
        """Whether it may be positive, with the signs of W: that of biactive members may."""
        lin = self.lin
        yes = np.ones(self.members.size, dtype=bool)
        return np.concatenate([lin.row_upper[self.rows], lin.z_upper[self.bounds], yes])

    @cached_property
    def may_rise_in_s(self) -> BoolArray:
        """The same with the signs of S: that of biactive members may not."""
        own = np.zeros(self.rows.size + self.bounds.size, dtype=bool)
        return self.may_rise & ~np.append(own, self.corner)

    def scattered(self, values: Array) -> Multipliers:
        """Multipliers of the columns at their places."""
        nlp, pairs = self.lifted.nlp, np.zeros(self.lifted.pairs.shape)
        lam = Multipliers(np.zeros(nlp.n_g), np.zeros(nlp.n_x), pairs)
        ends = np.cumsum([self.rows.size, self.bounds.size])
        lam.rows[self.rows], lam.z[self.bounds], pairs.reshape(-1)[self.members] = np.split(values, ends)
        return lam


def proving(lifted: Lifted, lin: Linearisation, lam_rows: Array, tolerance: float) -> Multipliers | None:
    """Multipliers with the signs of S from those of the rows at the end of a solve; None if they have others.

    Those of bounds and members are what the Lagrangian leaves to them. It is stationary within ``tolerance``.
    """
    columns, slack = Columns(lifted, lin), tolerance * lin.scale
    n_rows, n_bounds = columns.rows.size, columns.bounds.size
    rows = signed(lam_rows[columns.rows], lin.row_lower[columns.rows], lin.row_upper[columns.rows])
    values = np.append(rows, np.zeros(n_bounds + columns.members.size))
    rest = -(lin.gradient + columns.matrix @ values)
    # an unknown may be a member of several pairs: the one with the freest sign takes all
    places = np.append(columns.bounds, lifted.pairs[lin.zero])
    order = np.argsort(np.append(np.zeros(n_bounds, dtype=bool), columns.corner), kind="stable")
    unknowns, first = np.unique(places[order], return_index=True)
    values[n_rows + order[first]] = rest[unknowns]
    values = signed(values, columns.may_fall, columns.may_rise_in_s)
    residual = np.abs(lin.gradient + columns.matrix @ values)
    return columns.scattered(values) if np.max(residual, initial=0.0) <= slack else None


def signed(values: Array, may_fall: BoolArray, may_rise: BoolArray) -> Array:
    """Each multiplier cut to the signs it may have."""
    return np.where(may_fall, np.minimum(values, 0.0), 0.0) + np.where(may_rise, np.maximum(values, 0.0), 0.0)
