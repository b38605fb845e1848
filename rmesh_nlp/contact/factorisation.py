"""Sparse factors of a stiffness: by CHOLMOD where scikit-sparse is installed, else by SuperLU.

Cholesky's factorisation takes half the work of LU. On Example 6.1 with 64 and 224 squares a side, one core,
factors take a third to six tenths of the time, solves a third to eight tenths. Solutions differ by rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse.linalg import SuperLU, splu

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.optimize.budget import checkpoint

try:
    from sksparse.cholmod import CholmodError, cholesky
except ImportError:  # scikit-sparse is not there, or one of which these names are not
    cholesky, CholmodError = None, RuntimeError

HAS_CHOLMOD = cholesky is not None


Solve = Callable[[Array], Array]
"""Solutions with a factorised matrix for a right side (m,), or for the columns of (m, k)."""


def factorised(K: sp.csc_array) -> Solve:
    """Sparse factorisation of a symmetric positive definite matrix."""
    checkpoint()
    if 4 * K.nnz >= K.shape[0] ** 2 > 0:  # as where all but few unknowns are eliminated
        try:
            # numbers that are none pass, as they do through sparse factors
            return partial(cho_solve, cho_factor(K.toarray(), check_finite=False), check_finite=False)
        except LinAlgError:
            pass
    elif HAS_CHOLMOD and K.shape[0] > 0:
        try:
            return cholesky(sp.csc_matrix(K))
        except CholmodError:  # not positive definite: an element is inverted
            pass
    return _by_superlu(K, "MMD_AT_PLUS_A").solve


def factorised_lu(K: sp.csc_array) -> tuple[Solve, Solve]:
    """Sparse factorisation of a matrix that is not symmetric; the second one solves with its transpose."""
    checkpoint()
    solve = _by_superlu(K, "MMD_AT_PLUS_A", 0.1).solve
    return solve, partial(solve, trans="T")


class Condensed:
    """A stiffness in which all unknowns but ``last`` (k,) are eliminated: ``S`` (k, k), ``load`` (k,).

    The Schur complement is the product of the trailing blocks of factors in which these unknowns come last.
    They are held by springs meanwhile, so that a body that only contact holds has factors too.
    """

    def __init__(self, K: sp.csc_array, load: Array, last: Index) -> None:
        is_last, spring = np.isin(np.arange(load.size), last), K.diagonal().max()
        held = sp.csc_array(K + sp.diags_array(spring * is_last))
        order = np.argsort(_by_superlu(held, "MMD_AT_PLUS_A").perm_c)
        self._order = order = np.concatenate([order[~is_last[order]], last])
        held, first = held[:, order][order], order.size - last.size
        self._factor = factor = _by_superlu(held, "NATURAL")
        self._held = (factor.L[first:, first:] @ factor.U[first:, first:]).toarray()
        self._free, self._last = factor.solve(load[order]), slice(first, None)
        self.S = (self._held + self._held.T) / 2 - spring * np.eye(last.size)
        self.load = self._held @ self._free[self._last]

    def whole(self, x: Array) -> Array:
        """All unknowns (m,), in equilibrium where the last ones are ``x`` (k,)."""
        push, u = np.zeros(self._order.size), np.empty(self._order.size)
        push[self._last] = self._held @ x - self.load
        u[self._order] = self._free + self._factor.solve(push)
        u[self._order[self._last]] = x
        return u


def _by_superlu(K: sp.csc_array, order: str, least: float = 0.0) -> SuperLU:
    # pivots on the diagonal, if at least that part of their column: anything else would give up the ordering,
    # and with it the sparsity; by single columns factors of up to 30,000 unknowns take 10 to 35 % less time
    # than by panels of them
    return splu(K, order, diag_pivot_thresh=least, relax=2, panel_size=1, options={"SymmetricMode": True})
