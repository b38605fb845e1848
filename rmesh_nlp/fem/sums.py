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
    """Where local results (length, elements) go: ``matrix[row, column] += scale * result``; -1 drops one."""

    row: Index
    column: Index
    scale: Array


class Sums:
    """The nonzeros of a sparse matrix, each the sum of some local results; a column is dense."""

    def __init__(self, shape: Shape, parts: list[Entries]) -> None:
        self._shape = shape
        row, column, scale = (
            np.concatenate([np.zeros(0, kind), *(part[k].ravel() for part in parts)])
            for k, kind in enumerate((np.int64, np.int64, np.float64))
        )
        place = np.flatnonzero((row >= 0) & (column >= 0))
        names, number = column[place] * shape[0] + row[place], row[place]
        if shape[1] == 1:
            names = np.arange(shape[0])
        else:
            names, number = np.unique(names, return_inverse=True)
        self._rows = names % max(shape[0], 1)
        self._starts = np.searchsorted(names, np.arange(shape[1] + 1) * shape[0])
        self._sum = sp.csr_array((scale[place], (number, place)), shape=(names.size, row.size))

    def __call__(self, results: list[Array]) -> Array:
        """The nonzeros by the local results of all parts."""
        return np.asarray(self._sum @ np.concatenate([np.zeros(0), *(part.ravel() for part in results)]))

    @cached_property
    def numbered(self) -> sp.csc_array:
        """The pattern with 1, 2, ... as values."""
        return sp.csc_array((1 + np.arange(self._rows.size), self._rows, self._starts), shape=self._shape)

    @property
    def pattern(self) -> ca.Sparsity:
        """The pattern as CasADi has it."""
        return ca.Sparsity(*self._shape, self._starts.tolist(), self._rows.tolist())
