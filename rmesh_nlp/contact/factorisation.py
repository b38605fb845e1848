"""Sparse factors of a stiffness: by CHOLMOD where scikit-sparse is installed, else by SuperLU.

Cholesky's factorisation takes half the work of LU. On Example 6.1 with 64 and 224 squares a side, one core,
factors take a third to six tenths of the time, solves a third to eight tenths. Solutions differ by rounding.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rmesh_nlp.evaluation import Array

try:
    from sksparse.cholmod import CholmodError, analyze
except ImportError:  # scikit-sparse is not there, or one of which these names are not
    analyze, CholmodError = None, RuntimeError

HAS_CHOLMOD = analyze is not None


class Factor(Protocol):
    """A factorised matrix."""

    def solve(self, right: Array) -> Array:
        """Solutions for a right side (m,), or for the columns of (m, k)."""

    def trailing(self, k: int) -> Array | None:
        """Schur complement (k, k) of the last unknowns, if the matrix was factorised in its own order."""


class _LU:
    """Factors by SuperLU."""

    def __init__(self, factor: SuperLU) -> None:
        self._factor = factor

    def solve(self, right: Array) -> Array:
        """See :class:`Factor`."""
        return np.asarray(self._factor.solve(right))

    def trailing(self, k: int) -> Array | None:
        """See :class:`Factor`."""
        own, first = np.arange(self._factor.shape[0]), self._factor.shape[0] - k
        if not (np.array_equal(self._factor.perm_r, own) and np.array_equal(self._factor.perm_c, own)):
            return None
        lower, upper = (part[first:, first:].toarray() for part in (self._factor.L, self._factor.U))
        return np.asarray(lower @ upper)


class _Cholesky:
    """Factors by CHOLMOD."""

    def __init__(self, factor: Any) -> None:
        self._factor = factor

    def solve(self, right: Array) -> Array:
        """See :class:`Factor`."""
        return np.asarray(self._factor(right))

    def trailing(self, k: int) -> Array | None:
        """See :class:`Factor`."""
        order = self._factor.P()
        if not np.array_equal(order, np.arange(order.size)):
            return None
        lower = self._factor.L()[order.size - k :, order.size - k :].toarray()
        return np.asarray(lower @ lower.T)


def factorised(K: sp.csc_array, *, ordered: bool = False) -> Factor:
    """Sparse factorisation of a symmetric positive definite matrix, in its own order if ``ordered``."""
    # both take 32-bit indices; SciPy before 1.13 makes 64-bit ones when a matrix is sliced
    indices, starts = (a.astype(np.int32, copy=False) for a in (K.indices, K.indptr))
    if HAS_CHOLMOD and K.shape[0] > 0:
        lower = sp.csc_matrix((K.data, indices, starts), shape=K.shape)
        try:
            # dense blocks pay for large matrices only
            mode, method = ("auto", "natural") if ordered else ("simplicial", "amd")
            return _Cholesky(analyze(lower, mode=mode, ordering_method=method).cholesky(lower))
        except CholmodError:  # not positive definite: an element is inverted
            pass
    K = sp.csc_array((K.data, indices, starts), shape=K.shape)
    # pivots on the diagonal: anything else would give up the ordering, and with it the sparsity
    order = "NATURAL" if ordered else "MMD_AT_PLUS_A"
    return _LU(splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True}))


def factorised_lu(K: sp.csc_array) -> Factor:
    """Sparse factorisation of a matrix that is not symmetric."""
    return _LU(splu(sp.csc_array(K), permc_spec="COLAMD"))
