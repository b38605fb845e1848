"""Sparse factors of a stiffness: by CHOLMOD where scikit-sparse is installed, else by SuperLU.

Cholesky's factorisation takes half the work of LU. On Example 6.1 with 64 and 224 squares a side, one core,
factors take a third to six tenths of the time, solves a third to eight tenths. Solutions differ by rounding.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rmesh_nlp.evaluation import Array, Index

try:
    from sksparse.cholmod import CholmodError, cholesky
except ImportError:  # scikit-sparse is not there, or one of which these names are not
    cholesky, CholmodError = None, RuntimeError

HAS_CHOLMOD = cholesky is not None


Solve = Callable[[Array], Array]
"""Solutions with a factorised matrix for a right side (m,), or for the columns of (m, k)."""


def factorised(K: sp.csc_array) -> Solve:
    """Sparse factorisation of a symmetric positive definite matrix."""
    if HAS_CHOLMOD and K.shape[0] > 0:
        try:
            return cholesky(sp.csc_matrix(K))
        except CholmodError:  # not positive definite: an element is inverted
            pass
    return _by_superlu(K, "MMD_AT_PLUS_A").solve


def factorised_lu(K: sp.csc_array) -> Solve:
    """Sparse factorisation of a matrix that is not symmetric."""
    return splu(K, permc_spec="COLAMD").solve


def condensed(K: sp.csc_array, load: Array, last: Index) -> tuple[Array, Array]:
    """Stiffness (k, k) and load (k,) of the unknowns ``last`` (k,) alone, all others eliminated.

    The Schur complement is the product of the trailing blocks of factors in which these unknowns come last.
    """
    order = np.argsort(_by_superlu(K, "MMD_AT_PLUS_A").perm_c)
    order = np.concatenate([order[np.isin(order, last, invert=True)], last])
    factor, first = _by_superlu(K[:, order][order], "NATURAL"), order.size - last.size
    stiffness = (factor.L[first:, first:] @ factor.U[first:, first:]).toarray()
    return stiffness, stiffness @ factor.solve(load[order])[first:]


def _by_superlu(K: sp.csc_array, order: str) -> SuperLU:
    # pivots on the diagonal: anything else would give up the ordering, and with it the sparsity
    return splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
