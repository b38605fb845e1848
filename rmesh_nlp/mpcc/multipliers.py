"""Multipliers of a linearised point by least squares: a cheap proof of S, and the label if they are unique.

The stationarity of a point asks for ``lambda`` with ``gradient + M lambda = 0``, the columns of M the
gradients of active rows, of active bounds and of zero members of pairs. With one sparse factorisation ::

    [ I    M  ] [ r ]   [ -gradient ]
    [ M^T  -e ] [ l ] = [     0     ]

is solved; what comes out with the wrong sign is set to zero and left out, and the rest is solved again.
Linear programs over the same columns (see ``stationarity``) decide the cases that are left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
_ROUNDS = 8  # of leaving out what has the wrong sign
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


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Multipliers that were found: ``s_stationary`` proves S; ``unique`` ones of W decide the label."""

    multipliers: Multipliers
    s_stationary: bool
    unique: bool


def by_least_squares(
    lifted: Lifted, lin: Linearisation, tolerance: float, budget: Budget | None = None
) -> LeastSquares | None:
    """Multipliers with which the Lagrangian is stationary within ``tolerance``; None if none were found.

    First with the signs of W, then with those of S.
    """
    columns = Columns(lifted, lin)
    matrix, slack = columns.matrix, tolerance * lin.scale
    if not matrix.shape[1]:
        return None
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=0)).ravel())
    size = np.where(length > 0, length, 1.0)
    scaled = matrix @ sp.diags(1.0 / size)
    try:
        random = np.random.default_rng(0).normal(size=size.size)
        gradients = (-(scaled @ random), lin.gradient)
        again, values = _least_squares(scaled, gradients, np.zeros(size.size), budget)
        unique = bool(np.max(np.abs(again - random)) <= _RECOVERED)
        if unique:
            own = signed(values / size, columns.may_fall, columns.may_rise)
            if np.max(np.abs(lin.gradient + matrix @ own), initial=0.0) > slack:
                return None
            is_s = bool(np.all((own <= slack) | columns.may_rise_in_s))
            return LeastSquares(columns.scattered(own), is_s, True)
        multipliers = _with_signs(scaled, columns, values, slack, budget)
    except RuntimeError:  # exactly singular
        return None
    return None if multipliers is None else LeastSquares(columns.scattered(multipliers / size), True, False)


def _least_squares(
    matrix: sp.csc_matrix, gradients: Sequence[Array], start: Array, budget: Budget | None
) -> list[Array]:
    """Multipliers for each gradient, by refinements from a start, with one factorisation."""
    n, k = matrix.shape
    system = sp.bmat([[sp.identity(n), matrix], [matrix.T, -_PROXIMAL * sp.identity(k)]], format="csc")

    def refined(solve: Callable[[Array], Array]) -> list[Array]:
        iterates = [start for _ in gradients]
        for _ in range(_REFINEMENTS):
            rights = [
                np.append(-(g + matrix @ v), np.zeros(k)) for g, v in zip(gradients, iterates, strict=True)
            ]
            iterates = [v + solve(right)[n:] for v, right in zip(iterates, rights, strict=True)]
        return iterates

    return factorised(system, refined, budget)


def signed(values: Array, may_fall: BoolArray, may_rise: BoolArray) -> Array:
    """Each multiplier cut to the signs it may have."""
    return np.where(may_fall, np.minimum(values, 0.0), 0.0) + np.where(may_rise, np.maximum(values, 0.0), 0.0)


def _with_signs(
    matrix: sp.csc_matrix, columns: Columns, values: Array, slack: float, budget: Budget | None
) -> Array | None:
    """Multipliers with the signs of S, by leaving out in turn what has the wrong one; columns scaled."""
    kept, gradient = np.ones(values.size, dtype=bool), columns.lin.gradient
    for _ in range(_ROUNDS):
        own = signed(values, columns.may_fall, columns.may_rise_in_s)
        if np.max(np.abs(gradient + matrix @ own)) <= slack:
            return own
        wrong = kept & (own != values)
        if not np.any(wrong):
            return None
        kept &= ~wrong
        values = np.where(kept, values, 0.0)
        values[kept] = _least_squares(matrix[:, kept], [gradient], values[kept], budget)[0]
    return None
