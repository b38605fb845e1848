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
from rmesh_nlp.evaluation import Array
from rmesh_nlp.nlp import Derivatives
from rmesh_nlp.summed import Gather, Part, Summed
from rmesh_nlp.vectorised import WORTHWHILE, columnwise

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
    local = [_Local(group) for group in groups if group.size > 0]
    large = any(group.size >= WORTHWHILE for group in groups)
    inputs = [x, p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)]
    n_x = int(x.shape[0])
    in_casadi = _InCasadi(inputs)
    kept: list[ca.Function] = []

    def function(name: str, n_in: int, shapes: list[tuple[int, int]], kernels: list[_Kernel]) -> ca.Function:
        if not large:
            return ca.Function(name, inputs[:n_in], in_casadi(shapes, kernels))
        kept.append(_in_numpy(name, inputs[:n_in], shapes, kernels))
        return ca.Function(name, inputs[:n_in], kept[-1].call(inputs[:n_in]))

    f, g = in_casadi([(1, 1), (n_rows, 1)], [part.values() for part in local])
    return Assembled(
        f=f,
        g=g,
        grad_f=function("nlp_grad_f", 2, [(1, 1), (n_x, 1)], [part.gradient() for part in local]),
        jac_g=function("nlp_jac_g", 2, [(n_rows, 1), (n_rows, n_x)], [part.jacobian() for part in local]),
        hess_lag=function("nlp_hess_l", 4, [(n_x, n_x)], [part.hessian() for part in local]),
        kernels=tuple(kept),
    )


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        return [
            columns([field.values(x) for field in group.arguments])[0].ravel()
            for columns, group in zip(evaluate, groups, strict=True)
        ]

    return values


@dataclass(frozen=True)
class _Entries:
    """Where each local result goes: ``matrix[row, column] += scale * result``; -1 drops it."""

    row: Index
    column: Index
    scale: Array


@dataclass(frozen=True)
class _Kernel:
    """A function of one element, the inputs that its arguments come from, and where its results go.

    Result number k is summed into output number k.
    """

    function: ca.Function
    arguments: tuple[tuple[int, Field], ...]
    results: tuple[_Entries, ...]
    size: int


class _Local:
    """The kernels of one element group."""

    def __init__(self, group: ElementGroup) -> None:
        self._group = group
        variable = [i for i, field in enumerate(group.arguments) if not field.parameter and _moves(field)]
        self._local = Differentiated(group.function, group.at_points, variable)
        none = np.zeros((0, group.size))
        fields = [group.arguments[i] for i in variable]
        self._index = np.concatenate([none.astype(int), *[field.index for field in fields]])
        self._scale = np.concatenate([none, *[field.scale for field in fields]])
        self._arguments = tuple((int(field.parameter), field) for field in group.arguments)

    def values(self) -> _Kernel:
        """Objective and constraints."""
        return self._kernel("values", self._local.values, self._f(), self._g())

    def gradient(self) -> _Kernel:
        """The objective and its gradient."""
        (row,) = self._places(self._local.gradient_pattern, 1)
        entries = _Entries(self._index[row], np.zeros_like(self._index[row]), self._scale[row])
        return self._kernel("gradient", self._local.gradient, self._f(), entries)

    def jacobian(self) -> _Kernel:
        """The constraints and their Jacobian."""
        row, column = self._places(self._local.jacobian_pattern, 2)
        entries = _Entries(self._group.rows[row], self._index[column], self._scale[column])
        return self._kernel("jacobian", self._local.jacobian, self._g(), entries)

    def hessian(self) -> _Kernel:
        """Upper triangle of the Hessian of the Lagrangian, a function of its multipliers as well."""
        a, b = self._places(self._local.hessian_pattern, 2)
        i, j = self._index[a], self._index[b]
        # two local values of one unknown: the lower triangle folds onto the diagonal too
        twice = np.where((i == j) & (a != b)[:, None], 2.0, 1.0)
        entries = _Entries(np.minimum(i, j), np.maximum(i, j), twice * self._scale[a] * self._scale[b])
        lam_f = _plain_field(np.zeros((1, self._group.size), int))
        more = (2, lam_f), (3, _plain_field(self._group.rows))
        symbols = [*self._local.columns, self._local.lam_f, self._local.lam_g]
        function = ca.Function("hessian", symbols, ca.cse(self._local.hessian))
        return _Kernel(function, (*self._arguments, *more), (entries,), self._group.size)

    def _kernel(self, name: str, expressions: list[Any], *results: _Entries) -> _Kernel:
        function = ca.Function(name, self._local.columns, ca.cse(expressions))
        return _Kernel(function, self._arguments, results, self._group.size)

    def _f(self) -> _Entries:
        zero = np.zeros((self._local.values[0].nnz(), self._group.size), dtype=int)
        return _Entries(zero, zero, np.ones(zero.shape))

    def _g(self) -> _Entries:
        rows = self._group.rows
        return _Entries(rows, np.zeros_like(rows), np.ones(rows.shape))

    @staticmethod
    def _places(pattern: ca.Sparsity, dimensions: int) -> list[Index]:
        return [np.asarray(places, dtype=int) for places in pattern.get_triplet()[:dimensions]]


def _moves(field: Field) -> bool:
    return bool(np.any(field.index != CONSTANT))


def _plain_field(index: Index) -> Field:
    return Field(index, np.ones(index.shape), np.zeros(index.shape))


class _Sums:
    """The nonzeros of a sparse matrix, each the sum of some local results; a column is dense."""

    def __init__(self, shape: tuple[int, int], parts: list[_Entries]) -> None:
        self._parts = parts
        self._kept = [(part.row >= 0) & (part.column >= 0) for part in parts]
        keys = [
            part.column[keep].astype(np.int64) * shape[0] + part.row[keep]
            for part, keep in zip(parts, self._kept, strict=True)
        ]
        if shape[1] == 1:
            self.pattern, self._targets = ca.Sparsity.dense(*shape), keys
            return
        unique, place = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]), return_inverse=True)
        self._targets = np.split(place, np.cumsum([key.size for key in keys])[:-1]) if keys else []
        starts = np.searchsorted(unique, np.arange(shape[1] + 1) * shape[0])
        self.pattern = ca.Sparsity(*shape, starts.tolist(), (unique % max(shape[0], 1)).tolist())

    def matrix(self, part: int, *, by_element: bool) -> sp.coo_array:
        """Takes the local results of one part to the nonzeros.

        They come element by element as CasADi stores them, or row by row as numpy does.
        """
        keep = self._kept[part]
        length, n = keep.shape
        order = np.arange(length * n)
        order = order.reshape(n, length).T if by_element else order.reshape(length, n)
        where = (self._targets[part], order[keep])
        return sp.coo_array((self._parts[part].scale[keep], where), (self.pattern.nnz(), length * n))


class _InCasadi:
    """Sums as expressions of the inputs, each argument gathered once."""

    def __init__(self, inputs: list[ca.MX]) -> None:
        self._inputs = inputs
        self._gathered: dict[int, tuple[Field, ca.MX]] = {}

    def __call__(self, shapes: list[tuple[int, int]], kernels: list[_Kernel]) -> list[ca.MX]:
        """One expression for each output."""
        local = [
            kernel.function.map(kernel.size).call([self._gather(*argument) for argument in kernel.arguments])
            for kernel in kernels
        ]
        outputs = []
        for number, shape in enumerate(shapes):
            sums = _Sums(shape, [kernel.results[number] for kernel in kernels])
            nonzeros = ca.MX.zeros(sums.pattern.nnz(), 1)
            for part, results in enumerate(local):
                matrix = sums.matrix(part, by_element=True)
                if matrix.nnz:
                    nonzeros += to_casadi(matrix.tocsc()) @ ca.vec(results[number])
            outputs.append(ca.MX(sums.pattern, nonzeros))
        return outputs

    def _gather(self, source: int, field: Field) -> ca.MX:
        """Local values (length, elements) of a field of one input."""
        if id(field) not in self._gathered:
            w, (length, n) = self._inputs[source], field.index.shape
            moving = field.index != CONSTANT
            place = np.arange(length * n).reshape(n, length).T
            where = (place[moving], field.index[moving])
            pick = sp.coo_array((field.scale[moving], where), (length * n, int(w.shape[0])))
            local = to_casadi(pick.tocsc()) @ w + ca.DM(field.offset.ravel(order="F"))
            # the field is kept too, for its id to stay its own
            self._gathered[id(field)] = field, ca.reshape(local, length, n)
        return self._gathered[id(field)][1]


def _in_numpy(
    name: str, inputs: list[ca.MX], shapes: list[tuple[int, int]], kernels: list[_Kernel]
) -> Summed:
    """The same sums as a Function that runs in numpy."""
    sums = [
        _Sums(shape, [kernel.results[number] for kernel in kernels]) for number, shape in enumerate(shapes)
    ]
    parts = []
    for part, kernel in enumerate(kernels):
        matrices = [s.matrix(part, by_element=False).tocsr() for s in sums]
        if any(matrix.nnz for matrix in matrices):
            gathers = tuple(_in_numbers(source, field) for source, field in kernel.arguments)
            parts.append(Part(columnwise(kernel.function, kernel.size), gathers, tuple(matrices)))
    sparsities = [symbol.sparsity() for symbol in inputs]
    return Summed(name, sparsities, [s.pattern for s in sums], parts)


def _in_numbers(source: int, field: Field) -> Gather:
    moving = field.index != CONSTANT
    return Gather(source, np.where(moving, field.index, 0), np.where(moving, field.scale, 0.0), field.offset)


def to_casadi(matrix: sp.csc_array) -> ca.DM:
    """A scipy sparse matrix as a CasADi DM of the same pattern, explicit zeros kept."""
    matrix.sort_indices()
    return ca.DM(ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist()), matrix.data)
