"""The functions of one element that are evaluated over a mesh, and where their results go."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import differentiated
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, Index


@dataclass(frozen=True)
class Entries:
    """Where each local result goes: ``matrix[row, column] += scale * result``; -1 drops it."""

    row: Index
    column: Index
    scale: Array


@dataclass(frozen=True)
class Kernel:
    """A function of one element, the inputs that its arguments come from, and where its results go.

    Result number k is summed into output number k.
    """

    function: ca.Function
    arguments: tuple[tuple[int, Field], ...]
    results: tuple[Entries, ...]
    size: int


class LocalKernels:
    """The kernels of one element group."""

    def __init__(self, group: ElementGroup) -> None:
        self._group = group
        variable = [i for i, field in enumerate(group.arguments) if not field.parameter and _moves(field)]
        self._local = differentiated(group.function, group.at_points, variable)
        none = np.zeros((0, group.size))
        fields = [group.arguments[i] for i in variable]
        self._index = np.concatenate([none.astype(int), *[field.index for field in fields]])
        self._scale = np.concatenate([none, *[field.scale for field in fields]])
        self._arguments = tuple((int(field.parameter), field) for field in group.arguments)

    def values(self) -> Kernel:
        """Objective and constraints."""
        return self._kernel(self._local.value_function, self._f(), self._g())

    def gradient(self) -> Kernel:
        """The objective and its gradient."""
        (row,) = self._places(self._local.gradient_pattern, 1)
        entries = Entries(self._index[row], np.zeros_like(self._index[row]), self._scale[row])
        return self._kernel(self._local.gradient_function, self._f(), entries)

    def jacobian(self) -> Kernel:
        """The constraints and their Jacobian."""
        row, column = self._places(self._local.jacobian_pattern, 2)
        entries = Entries(self._group.rows[row], self._index[column], self._scale[column])
        return self._kernel(self._local.jacobian_function, self._g(), entries)

    def hessian(self) -> Kernel:
        """Upper triangle of the Hessian of the Lagrangian, a function of its multipliers as well."""
        a, b = self._places(self._local.hessian_pattern, 2)
        i, j = self._index[a], self._index[b]
        # two local values of one unknown: the lower triangle folds onto the diagonal too
        twice = np.where((i == j) & (a != b)[:, None], 2.0, 1.0)
        entries = Entries(np.minimum(i, j), np.maximum(i, j), twice * self._scale[a] * self._scale[b])
        lam_f = _plain(np.zeros((1, self._group.size), int))
        more = (2, lam_f), (3, _plain(self._group.rows))
        return Kernel(self._local.hessian_function, (*self._arguments, *more), (entries,), self._group.size)

    def _kernel(self, function: ca.Function, *results: Entries) -> Kernel:
        return Kernel(function, self._arguments, results, self._group.size)

    def _f(self) -> Entries:
        zero = np.zeros((self._local.values[0].nnz(), self._group.size), dtype=int)
        return Entries(zero, zero, np.ones(zero.shape))

    def _g(self) -> Entries:
        rows = self._group.rows
        return Entries(rows, np.zeros_like(rows), np.ones(rows.shape))

    @staticmethod
    def _places(pattern: ca.Sparsity, dimensions: int) -> list[Index]:
        return [np.asarray(places, dtype=int) for places in pattern.get_triplet()[:dimensions]]


def _moves(field: Field) -> bool:
    return bool(np.any(field.index != CONSTANT))


def _plain(index: Index) -> Field:
    return Field(index, np.ones(index.shape), np.zeros(index.shape))
