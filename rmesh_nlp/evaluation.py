"""Arrays, and CasADi Functions and matrices on them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

ROUNDING = 1e-9
"""Difference of two computed numbers that counts as none: of energies over their size, of lengths over an
edge, of areas over the initial ones, of angles in radians."""

PROVED = 1e-10
"""Relative difference that is none where a bound is guaranteed: of forces in equilibrium, of the measures of
the domain, of a switch at a node, which is zero, of a part that is empty, and of an integral."""

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

Expression = ca.SX | ca.MX
"""What formulas are of: a symbolic expression, or what computes like one, a number or an array of values."""

Kind = type[ca.SX] | type[ca.MX]
"""Whether the expressions of a function are scalar or of matrices."""


def magnitude(values: ArrayLike) -> float:
    """Largest absolute value, 0 of none."""
    return float(np.max(np.abs(values), initial=0.0))


def difference(a: float, b: float) -> float:
    """``a - b``, 0 where that is rounding."""
    return 0.0 if math.isclose(a, b, rel_tol=ROUNDING) else a - b


def is_finite(values: ArrayLike) -> bool:
    """Whether all are finite numbers."""
    try:
        return bool(np.all(np.isfinite(np.asarray(values, dtype=float))))
    except (TypeError, ValueError):  # texts, lists of different lengths
        return False


def is_pair(values: ArrayLike) -> bool:
    """Whether it is two finite numbers."""
    return is_finite(values) and np.shape(values) == (2,)


def largest_side(points: Array) -> float:
    """Largest side of their bounding box."""
    return float(np.max(np.ptp(points, axis=1)))


def cross(a: Any, b: Any) -> Any:
    """Signed area of the parallelogram of two vectors."""
    return a[0] * b[1] - a[1] * b[0]


def numbers_of(parts: Iterable[NDArray]) -> Index:
    """All whole numbers of the parts; of no part none."""
    return np.concatenate([np.zeros(0, np.int64), *parts])


class Evaluator:
    """A CasADi Function called on numpy arrays through its buffer interface.

    ``Function.__call__`` converts every argument to a DM and back; for the large sparse
    results of an assembled mesh that costs more than the evaluation itself.

    Arguments may be of any shape; they are passed column-major, as CasADi stores them. A call returns one
    fresh flat array of the nonzeros of each output, in the same order.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._buffer, self._run = function.buffer()
        self._inputs = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._outputs = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, array.data)

    def __call__(self, *arguments: ArrayLike) -> list[Array]:
        """Evaluate; a scalar argument is broadcast over its whole input."""
        if len(arguments) != len(self._inputs):
            raise ValueError(
                f"{self.function.name()} takes {len(self._inputs)} arguments, got {len(arguments)}"
            )
        for store, value in zip(self._inputs, arguments, strict=True):
            store[:] = np.asarray(value, dtype=float).ravel(order="F")
        try:
            self._run()
        except RuntimeError as error:
            # a Ctrl-C in a Python callback comes out of CasADi as an error of its own
            if "KeyboardInterrupt" in str(error):
                raise KeyboardInterrupt from None
            raise
        return [output.copy() for output in self._outputs]


class Block:
    """Makes a block of a sparse matrix from the nonzeros of the whole; where they are is found once.

    ``whole`` has the pattern of the matrix and numbers its nonzeros, see :func:`numbered`.
    """

    def __init__(self, whole: sp.csc_array, rows: slice = slice(None), columns: slice = slice(None)) -> None:
        self._form(whole[rows, columns])

    def _form(self, numbered: sp.csc_array) -> None:
        numbered.sort_indices()
        self._shape, self._indices, self._starts = numbered.shape, numbered.indices, numbered.indptr
        self._source = (numbered.data - 1).astype(np.int32)

    def __call__(self, values: Array) -> sp.csc_array:
        """The block of the matrix that has these nonzeros."""
        return sp.csc_array((values[self._source], self._indices, self._starts), shape=self._shape)


class Symmetric(Block):
    """The same for the leading block, of ``size``, of the symmetric matrix with a given upper triangle."""

    def __init__(self, upper: sp.csc_array, size: int | None = None) -> None:
        leading = upper[:size, :size]
        self._form(leading + sp.triu(leading, 1).T)


def numbered(sparsity: ca.Sparsity) -> sp.csc_array:
    """A pattern with 1, 2, ... as values, in the order of CasADi's nonzeros."""
    values = np.arange(1, sparsity.nnz() + 1)
    return sp.csc_array((values, sparsity.row(), sparsity.colind()), shape=sparsity.shape)


def flat(matrix: ca.DM) -> Array:
    """All entries of a CasADi matrix in one array, column by column."""
    return matrix.full().ravel(order="F")


def sparsity_of(matrix: sp.csc_array) -> ca.Sparsity:
    """Its pattern, whose rows are sorted."""
    return ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())


def constant_of(matrix: sp.sparray) -> ca.DM:
    """The matrix for CasADi."""
    columns = sp.csc_array(matrix)
    columns.sort_indices()
    return ca.DM(sparsity_of(columns), columns.data.tolist())  # a hundred times faster than from the array


def kind_of(*functions: ca.Function) -> Kind:
    """Symbols that all of them take: scalar ones, if they can."""
    return ca.SX if all(function.is_a("SXFunction") for function in functions) else ca.MX


def slope_of(function: ca.Function) -> ca.Function:
    """Derivative of a function of one number."""
    t = kind_of(function).sym("t")
    return ca.Function("slope", [t], [ca.jacobian(function(t), t)])


def summed(values: Array, row: Index, column: Index, shape: tuple[int, int]) -> sp.csr_array:
    """A sparse matrix of entries, of which those at one place add up; what cancels is none.

    At the end of a crack nodes meet themselves.
    """
    matrix = sp.csr_array((values, (row, column)), shape=shape)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
