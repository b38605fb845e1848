"""Multipliers of a linearised point by least squares, which decide its label if there are no others.

The stationarity of a point asks for ``lambda`` with ``gradient + M lambda = 0``, the columns of M the
gradients of active rows, of active bounds and of zero members of pairs. With one sparse factorisation ::

    [ I    M  ] [ r ]   [ -gradient ]
    [ M^T  -e ] [ l ] = [     0     ]

is solved, and once more for random multipliers, which come back if the columns are independent. Linear
programs over the same columns (see ``stationarity``) decide the cases that are left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.factors import factorised
from rmesh_nlp.mpcc.lifting import BoolArray, IntArray, Lifted
from rmesh_nlp.mpcc.lpec import Linearisation
from rmesh_nlp.optimize.budget import Budget

_PROXIMAL = 1e-12  # columns have length one
_REFINEMENTS = 4  # each takes out what the proximal term left
_RECOVERED = 1e-6  # independent columns give back random multipliers this well


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


def only_multipliers(
    lifted: Lifted, lin: Linearisation, tolerance: float, budget: Budget | None = None
) -> Multipliers | None:
    """Multipliers with the signs of W if there are no others; None if there are, or none at all.

    With them the Lagrangian is stationary within ``tolerance``.
    """
    columns = Columns(lifted, lin)
    matrix, slack = columns.matrix, tolerance * lin.scale
    n, k = matrix.shape
    if not k:
        return None
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=0)).ravel())
    size = np.where(length > 0, length, 1.0)
    scaled = matrix @ sp.diags(1.0 / size)
    random = np.random.default_rng(0).normal(size=k)
    gradients = np.stack([-(scaled @ random), lin.gradient], axis=1)
    system = sp.bmat([[sp.identity(n), scaled], [scaled.T, -_PROXIMAL * sp.identity(k)]], format="csc")

    def refined(solve: Callable[[Array], Array]) -> Array:
        values = np.zeros((k, 2))
        for _ in range(_REFINEMENTS):
            rests = np.vstack([-(gradients + scaled @ values), np.zeros((k, 2))])
            values = values + np.stack([solve(rest)[n:] for rest in rests.T], axis=1)
        return values

    try:
        again, values = factorised(system, refined, budget).T
    except RuntimeError:  # exactly singular
        return None
    own = signed(values / size, columns.may_fall, columns.may_rise)
    is_only = np.max(np.abs(again - random)) <= _RECOVERED
    is_stationary = np.max(np.abs(lin.gradient + matrix @ own)) <= slack
    return columns.scattered(own) if is_only and is_stationary else None


def signed(values: Array, may_fall: BoolArray, may_rise: BoolArray) -> Array:
    """Each multiplier cut to the signs it may have."""
    return np.where(may_fall, np.minimum(values, 0.0), 0.0) + np.where(may_rise, np.maximum(values, 0.0), 0.0)
