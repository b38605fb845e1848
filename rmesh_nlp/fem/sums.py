"""Sums of the results of elements into the nonzeros of a sparse matrix."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import Index

Shape = tuple[int, int]


class Entries(NamedTuple):
    """Where each local result goes: ``matrix[row, column] += scale * result``; -1 drops it."""

    row: Index
    column: Index
    scale: Array | None = None

    def some(self, results: Index) -> Entries:
        """Those of some of the local results."""
        if results.size == len(self.row):
            return self
        scale = None if self.scale is None else self.scale[results]
        return Entries(self.row[results], self.column[results], scale)


class Sums:
    """The nonzeros of a sparse matrix, each the sum of some local results; a column is dense.

    Local results are those of all parts one after the other, each part row by row, an element per column.
    """

    def __init__(self, shape: Shape, parts: list[Entries]) -> None:
        self.shape, self._sizes = shape, [part.row.size for part in parts]
        row, column = _joined([part.row for part in parts]), _joined([part.column for part in parts])
        n_local = row.size
        place: Index = np.arange(n_local, dtype=_kind(n_local))
        kept = (row >= 0) & (column >= 0)
        if not np.all(kept):
            row, column, place = row[kept], column[kept], place[kept]
        if shape[1] == 1:
            sums = _compressed(place, column, row, (1, shape[0]))
            self._rows, self.starts = np.arange(shape[0]), np.array([0, shape[0]])
            place, starts = sums.data, sums.indptr
        else:
            columns = _compressed(place, row, column, shape)
            columns.sort_indices()
            place, rows, first = columns.data, columns.indices, columns.indptr
            fresh = np.ones(rows.size, dtype=bool)
            np.not_equal(rows[1:], rows[:-1], out=fresh[1:])
            fresh[first[:-1][np.diff(first) > 0]] = True
            starts = np.append(np.flatnonzero(fresh), rows.size).astype(_kind(rows.size))
            self._rows, self.starts = rows[starts[:-1]], np.searchsorted(starts[:-1], first)
        self._sum = sp.csr_array(
            (self._scales(parts, place), place, starts), shape=(starts.size - 1, n_local)
        )

    def _scales(self, parts: list[Entries], place: Index) -> Array:
        if all(part.scale is None for part in parts):
            return np.ones(place.size)
        scales = [np.ones(part.row.size) if part.scale is None else part.scale.ravel() for part in parts]
        return np.asarray(np.concatenate(scales)[place])

    @property
    def n(self) -> int:
        """Number of nonzeros."""
        return int(self._sum.shape[0])

    @property
    def n_local(self) -> int:
        """Number of local results."""
        return int(self._sum.shape[1])

    def __call__(self, results: Array) -> Array:
        """The nonzeros."""
        return np.asarray(self._sum @ results)

    @property
    def numbered(self) -> sp.csc_array:
        """The pattern with 1, 2, ... as values."""
        return sp.csc_array((np.arange(1, self.n + 1), self._rows, self.starts), shape=self.shape)

    @cached_property
    def pattern(self) -> ca.Sparsity:
        """The pattern as CasADi has it."""
        if self.shape[1] == 1:
            return ca.Sparsity.dense(*self.shape)
        return ca.Sparsity(*self.shape, self.starts.tolist(), self._rows.tolist())

    def by_element(self, part: int, shape: Shape) -> ca.DM:
        """The matrix from the (length, elements) results of one part, element by element, to the nonzeros."""
        first = int(np.sum(self._sizes[:part]))
        chosen = sp.coo_array(self._sum[:, first : first + self._sizes[part]])
        turned = np.arange(shape[0] * shape[1]).reshape(shape, order="F").ravel()
        return sparse((self.n, self._sizes[part]), chosen.row, turned[chosen.col], chosen.data)


def _joined(parts: list[Index]) -> Index:
    return np.concatenate([np.zeros(0, np.int32), *(part.ravel() for part in parts)], dtype=np.int32)


def _kind(largest: int) -> type:
    return np.int32 if largest < np.iinfo(np.int32).max else np.int64


def _compressed(values: Index, row: Index, column: Index, shape: Shape) -> sp.csc_array:
    """All entries by columns, without a sort and without adding up those in one place."""
    entries = sp.coo_array((values, (row, column)), shape=shape)
    entries.has_canonical_format = True
    return entries.tocsc()


def sparse(shape: Shape, row: Index, column: Index, value: Array) -> ca.DM:
    """A sparse matrix by its entries, each given once; zeros among them are kept.

    ``scipy.sparse`` would check and convert its indices four times on the way: a fifth of the time to build
    the model of a small problem.
    """
    order = np.lexsort((row, column))
    starts = np.searchsorted(column[order], np.arange(shape[1] + 1))
    return ca.DM(ca.Sparsity(*shape, starts.tolist(), row[order].tolist()), value[order])
