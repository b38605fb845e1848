"""From element Functions to a global objective, constraints and their sparse derivatives.

A mesh problem is partially separable: its objective and constraints are sums over elements
of one small function of a few local values. The small function is differentiated once, as
SX, mapped over all elements, and its results are summed into the nonzeros of the global
derivatives by one constant sparse matrix. Building and evaluating are both linear in the
number of elements; the sparsity never changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.element import Differentiated, PointValues, plain
from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.nlp import Derivatives
from rmesh_nlp.vectorised import WORTHWHILE, Vectorised, is_vectorisable

Index = NDArray[np.int64]
CONSTANT = -1
"""Index of a local value that does not depend on any unknown or parameter."""


@dataclass(frozen=True)
class Field:
    """A nodal field as an affine function of one vector, ``scale * w[index] + offset``.

    The vector ``w`` is the unknowns ``x`` of a program or, if ``parameter``, its ``p``.

    Attributes
    ----------
    index : (components, nodes) int array
        ``CONSTANT`` where the field is fixed at ``offset``.
    scale, offset : (components, nodes) arrays
    parameter : bool
    """

    index: Index
    scale: Array
    offset: Array
    parameter: bool = False

    def at(self, nodes: Index) -> Field:
        """Local values on elements.

        ``nodes`` is (nodes per element, elements); the result has one column per element and
        runs through the components of the first node, then of the second, ...
        """
        shape = (self.index.shape[0] * nodes.shape[0], nodes.shape[1])

        def pick(a: NDArray) -> NDArray:
            return np.moveaxis(a[:, nodes], 0, 1).reshape(shape)

        return Field(pick(self.index), pick(self.scale), pick(self.offset), self.parameter)

    def values(self, w: Array) -> Array:
        """The field itself, (components, nodes), for a numeric vector ``w``."""
        moving = self.index != CONSTANT
        result = self.offset.copy()
        result[moving] += self.scale[moving] * np.asarray(w)[self.index[moving]]
        return result


def unknown_field(shape: tuple[int, int], first: int = 0, *, parameter: bool = False) -> Field:
    """A field all of whose values are unknowns, numbered node by node from ``first``."""
    components, nodes = shape
    index = first + np.arange(components * nodes).reshape(nodes, components).T
    return Field(index, np.ones(shape), np.zeros(shape), parameter)


def constant_field(values: Array) -> Field:
    """A field that is fixed at ``values`` of shape (components, nodes or elements)."""
    offset = np.atleast_2d(np.asarray(values, dtype=float))
    return Field(np.full(offset.shape, CONSTANT), np.ones(offset.shape), offset)


@dataclass(frozen=True)
class ElementGroup:
    """Elements that share one local function.

    Attributes
    ----------
    function : casadi.Function
        ``(*local columns) -> (f, g)``; f a scalar, g a column (possibly empty). An SX Function,
        or an MX one where SX has no expression (splines). With ``at_points`` it has one more
        argument, the column of values at all points.
    arguments : tuple of Field
        For each argument its local values, (length, elements).
    rows : (len(g), elements) int array
        Constraint row that each local ``g`` is added to; ``CONSTANT`` drops it.
    at_points : PointValues, optional
    """

    function: ca.Function
    arguments: tuple[Field, ...]
    rows: Index
    at_points: PointValues | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(self.arguments[0].index.shape[1])


@dataclass(frozen=True)
class Assembled:
    """Global objective and constraints as MX expressions, and their derivatives.

    ``kernels`` must live as long as any Function made of the derivatives: some are Python
    callbacks, which CasADi does not own.
    """

    f: ca.MX
    g: ca.MX
    grad_f: ca.Function
    jac_g: ca.Function
    hess_lag: ca.Function
    kernels: tuple[ca.Function, ...]

    @property
    def derivatives(self) -> Derivatives:
        """The derivative Functions in the form that nlpsol takes."""
        return Derivatives(self.grad_f, self.jac_g, self.hess_lag, self.kernels)


def assemble(groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int) -> Assembled:
    """Sum element groups into one objective and ``n_rows`` constraints of ``x`` and ``p``.

    Parameters
    ----------
    groups : sequence of ElementGroup
        Their fields index ``x`` or ``p``.
    x, p : MX symbols, columns
    n_rows : int
        Number of constraints; rows that no group touches are zero.
    """
    parts = [_Mapped(group, x, p) for group in groups if group.size > 0]
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)
    n_x = int(x.shape[0])

    def summed(local: list[list[ca.MX]]) -> tuple[ca.MX, ca.MX]:
        f = _total([ca.sum2(part[0]) for part in local], ca.MX(0))
        g = _sum_into((n_rows, 1), [(p.g_entries(), part[1]) for p, part in zip(parts, local, strict=True)])
        return f, ca.densify(g)

    f, g = summed([part.values() for part in parts])
    f_again, g_again = summed([part.first() for part in parts])
    gradient = _sum_into((n_x, 1), [(part.gradient_entries(), part.first()[2]) for part in parts])
    jacobian = _sum_into((n_rows, n_x), [(part.jacobian_entries(), part.first()[3]) for part in parts])
    hessian = _sum_into((n_x, n_x), [(part.hessian_entries(), part.second(lam_f, lam_g)) for part in parts])
    return Assembled(
        f=f,
        g=g,
        grad_f=ca.Function("nlp_grad_f", [x, p], [f_again, ca.densify(gradient)]),
        jac_g=ca.Function("nlp_jac_g", [x, p], [g_again, jacobian]),
        hess_lag=ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian]),
        kernels=tuple(kernel for part in parts for kernel in part.kernels),
    )


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    kernels = [_fast(plain(group.function, group.at_points), group.size) for group in groups]
    evaluators = [Evaluator(kernel) for kernel in kernels]

    def values(x: Array) -> list[Array]:
        local = [[field.values(x) for field in group.arguments] for group in groups]
        return [evaluate(*columns)[0] for evaluate, columns in zip(evaluators, local, strict=True)]

    return values


@dataclass(frozen=True)
class _Entries:
    """Where each local result goes: ``matrix[row, column] += scale * result``; -1 drops it."""

    row: Index
    column: Index
    scale: Array


class _Mapped:
    """One element group with its local derivatives mapped over the elements."""

    def __init__(self, group: ElementGroup, x: ca.MX, p: ca.MX) -> None:
        self.group, self._n = group, group.size
        variable = [i for i, field in enumerate(group.arguments) if not field.parameter and _moves(field)]
        self._fields = [group.arguments[i] for i in variable]
        local = Differentiated(group.function, group.at_points, variable)
        columns, weights = local.columns, [local.lam_f, local.lam_g]
        self._jacobian_pattern, self._hessian_pattern = local.jacobian_pattern, local.hessian_pattern
        self._values = _map("values", columns, local.values, self._n)
        self._first = _map_fast("first", columns, local.first, self._n)
        self._second = _map_fast("second", [*columns, *weights], local.second, self._n)
        self.kernels = (self._first, self._second)
        self._arguments = [_gather(field, p if field.parameter else x) for field in group.arguments]
        self.index = (
            np.concatenate([f.index for f in self._fields]) if self._fields else np.zeros((0, self._n), int)
        )
        self.scale = (
            np.concatenate([f.scale for f in self._fields]) if self._fields else np.zeros((0, self._n))
        )

    def values(self) -> list[ca.MX]:
        return self._values(*self._arguments)

    def first(self) -> list[ca.MX]:
        return self._first(*self._arguments)

    def second(self, lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
        rows = self.group.rows
        local = _gather(Field(rows, np.ones(rows.shape), np.zeros(rows.shape)), lam_g)
        return self._second(*self._arguments, ca.repmat(lam_f, 1, self._n), local)

    def g_entries(self) -> _Entries:
        rows = self.group.rows
        return _Entries(rows, np.where(rows < 0, -1, 0), np.ones(rows.shape))

    def gradient_entries(self) -> _Entries:
        return _Entries(self.index, np.where(self.index < 0, -1, 0), self.scale)

    def jacobian_entries(self) -> _Entries:
        row, column = (np.asarray(a, dtype=int) for a in self._jacobian_pattern.get_triplet())
        return _Entries(self.group.rows[row], self.index[column], self.scale[column])

    def hessian_entries(self) -> _Entries:
        a, b = (np.asarray(i, dtype=int) for i in self._hessian_pattern.get_triplet())
        i, j = self.index[a], self.index[b]
        # two local values of one unknown: the lower triangle folds onto the diagonal too
        twice = np.where((i == j) & (a != b)[:, None], 2.0, 1.0)
        return _Entries(np.minimum(i, j), np.maximum(i, j), twice * self.scale[a] * self.scale[b])


def _moves(field: Field) -> bool:
    return bool(np.any(field.index != CONSTANT))


def _map(name: str, inputs: list[Any], outputs: list[Any], n: int) -> ca.Function:
    return ca.Function(name, inputs, ca.cse(outputs)).map(n)


def _map_fast(name: str, inputs: list[Any], outputs: list[Any], n: int) -> ca.Function:
    """The same where no derivatives will be taken."""
    return _fast(ca.Function(name, inputs, ca.cse(outputs)), n)


def _fast(function: ca.Function, n: int) -> ca.Function:
    return Vectorised(function, n) if n >= WORTHWHILE and is_vectorisable(function) else function.map(n)


def _gather(field: Field, w: ca.MX) -> ca.MX:
    """Local values (length, elements) of a field as an expression of its vector."""
    length, n = field.index.shape
    place = np.arange(length * n).reshape(n, length).T
    entries = _Entries(place, field.index, field.scale)
    local = _matrix((length * n, int(w.shape[0])), entries) @ w + ca.DM(field.offset.ravel(order="F"))
    return ca.reshape(local, length, n)


def _matrix(shape: tuple[int, int], entries: _Entries) -> ca.DM:
    keep = (entries.row >= 0) & (entries.column >= 0)
    coo = sp.coo_matrix((entries.scale[keep], (entries.row[keep], entries.column[keep])), shape)
    return to_casadi(coo.tocsc())


def to_casadi(matrix: sp.csc_matrix) -> ca.DM:
    """A scipy sparse matrix as a CasADi DM of the same pattern, explicit zeros kept."""
    return ca.DM(sparsity(matrix), matrix.data)


def sparsity(matrix: sp.csc_matrix) -> ca.Sparsity:
    """The pattern of a scipy sparse matrix."""
    matrix.sort_indices()
    return ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())


def _sum_into(shape: tuple[int, int], parts: list[tuple[_Entries, ca.MX]]) -> ca.MX:
    """The sparse matrix whose nonzeros are sums of local results."""
    kept, keys = [], []
    for entries, _ in parts:
        keep = (entries.row >= 0) & (entries.column >= 0)
        kept.append(keep)
        keys.append(entries.column[keep].astype(np.int64) * shape[0] + entries.row[keep])
    unique, place = np.unique(np.concatenate([*keys, np.zeros(0, np.int64)]), return_inverse=True)
    starts = np.cumsum([0] + [key.size for key in keys])
    nonzeros = ca.MX.zeros(unique.size, 1)
    for number, (entries, local) in enumerate(parts):
        keep = kept[number]
        length, n = entries.row.shape
        if not np.any(keep):
            continue
        source = np.arange(length * n).reshape(n, length).T[keep]
        target = place[starts[number] : starts[number + 1]]
        scatter = _matrix((unique.size, length * n), _Entries(target, source, entries.scale[keep]))
        nonzeros += scatter @ ca.vec(local)
    indptr = np.searchsorted(unique, np.arange(shape[1] + 1) * shape[0])
    pattern = ca.Sparsity(*shape, indptr.tolist(), (unique % max(shape[0], 1)).tolist())
    return ca.MX(pattern, nonzeros)


def _total(terms: list[ca.MX], start: ca.MX) -> ca.MX:
    for term in terms:
        start = start + term
    return start
