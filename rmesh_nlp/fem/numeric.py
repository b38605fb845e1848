"""Sums over elements in numpy: functions of arrays, for all elements at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Expression
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.element import FEW, RESULTS, differentiated
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, LocalField, Values
from rmesh_nlp.fem.space import Index
from rmesh_nlp.fem.sums import Entries, Shape, Sums
from rmesh_nlp.vectorised import AssemblySettings, columnwise


class Kernel(NamedTuple):
    """A function of one element, the inputs that its arguments come from, and where its results go.

    Inputs are x, p, lam_f and lam_g. Result number k is summed into output number k. With ``at_points`` the
    function takes the derivatives of values there up to an ``order`` as well, after the first ``columns``
    arguments.
    """

    function: ca.Function
    arguments: tuple[tuple[int, Values], ...]
    results: tuple[Entries, ...]
    size: int
    columns: int
    at_points: PointValues | None
    order: int


AXES = {
    "f": ("one", "one"),
    "g": ("rows", "one"),
    "gradient": ("x", "one"),
    "jacobian": ("rows", "x"),
    "hessian": ("x", "x"),
}
"""What numbers the rows and columns of each result."""


class LocalKernels:
    """The kernels of one element group whose fields are affine."""

    def __init__(self, group: ElementGroup) -> None:
        self.group = group
        self.variable = _variable(group)
        self._local = differentiated(group.function, group.at_points, self.variable)
        self._axes = _axes(group, self.variable)

    def kernel(self, which: str, leading: int | None = None, *, whole: bool = True) -> Kernel:
        """The kernel with the results ``RESULTS[which]``; see :meth:`Assembled.hessian` for ``leading``.

        A ``whole`` one puts in the values at points; else they are arguments.
        """
        results = [self._entries(name, leading) for name in RESULTS[which]]
        kept = None
        if leading is not None:  # many results go nowhere
            used = [
                np.flatnonzero(np.any((result.row >= 0) & (result.column >= 0), axis=1)) for result in results
            ]
            results = [result.some(rows) for result, rows in zip(results, used, strict=True)]
            kept = tuple(tuple(rows.tolist()) for rows in used)
        local, size = self._local, self.group.size
        function = local.function(which, kept, whole=whole, for_few=size <= FEW)
        at_points, columns = None if whole else self.group.at_points, len(self.group.arguments)
        arguments, order = self.arguments(which), local.order(which)
        return Kernel(function, arguments, tuple(results), size, columns, at_points, order)

    def arguments(self, which: str) -> tuple[tuple[int, Values], ...]:
        """The inputs and fields that a kernel takes."""
        fields = self.group.arguments
        arguments: tuple[tuple[int, Values], ...] = tuple((int(field.parameter), field) for field in fields)
        if which == "hessian":
            arguments += (2, self._axes["one"]), (3, self._axes["rows"])
        return arguments

    def _entries(self, name: str, leading: int | None) -> Entries:
        a, b = (np.asarray(k, dtype=int) for k in self._local.patterns[name].get_triplet()[:2])
        return _entries(self._axes, name, a, b, leading)


def _variable(group: ElementGroup) -> list[int]:
    """Numbers of the arguments that depend on unknowns."""
    fields = enumerate(group.arguments)
    return [i for i, f in fields if not f.parameter and np.any(f.index != CONSTANT)]


def _axes(group: ElementGroup, variable: list[int]) -> dict[str, Field]:
    """Numbers and scales of what each axis in :data:`AXES` stands for, (length, elements)."""
    none, fields = np.zeros((0, group.size)), group.arguments
    unknowns = Field(
        np.concatenate([none, *(fields[i].index for i in variable)], dtype=np.int32, casting="unsafe"),
        np.concatenate([none, *(fields[i].scale for i in variable)]),
        none,
    )
    return {"one": _plain(np.zeros((1, group.size), int)), "rows": _plain(group.rows), "x": unknowns}


def _entries(axes: dict[str, Field], name: str, a: Index, b: Index, leading: int | None) -> Entries:
    """Where the local results go that a pattern has in the rows ``a`` and columns ``b``."""
    row, column = (axes[axis] for axis in AXES[name])
    i, j = row.index[a], column.index[b]
    scale = row.scale[a] * column.scale[b] if np.any(row.scale != 1) or np.any(column.scale != 1) else None
    if name == "hessian":
        twice = (i == j) & (a != b)[:, None]
        if np.any(twice):  # two local values of one unknown: the lower triangle folds onto the diagonal too
            scale = np.where(twice, 2.0, 1.0) * (1.0 if scale is None else scale)
        i, j = np.minimum(i, j), np.maximum(i, j)
        if leading is not None:
            i[i >= leading] = CONSTANT
    return Entries(i, j, scale)


def _plain(index: Index) -> Field:
    return Field(index, np.ones(index.shape), np.zeros(index.shape))


Inputs = Sequence[Array | None]
"""x, p, lam_f and lam_g, as far as they are needed; None is zero."""


class Mapped:
    """Local results of one kernel, by its function over all elements."""

    def __init__(self, kernel: Kernel, settings: AssemblySettings) -> None:
        self.entries, self._n, self._order = kernel.results, kernel.columns, kernel.order
        self._columns = columnwise(kernel.function, kernel.size, settings)
        self._gathers = [_Gather(*a) for a in kernel.arguments]
        self._at_points = kernel.at_points

    def __call__(self, inputs: Inputs, outputs: list[Array]) -> None:
        """Write the results into arrays (length, elements)."""
        columns = [gather(inputs) for gather in self._gathers]
        if self._at_points is not None:
            X = columns[self._at_points.place]
            columns[self._n : self._n] = self._at_points.evaluated(X, self._order)
        for output, result in zip(outputs, self._columns(columns), strict=True):
            output[:] = result


class Numeric:
    """The sums over element groups as a function of arrays."""

    def __init__(self, shapes: list[Shape], parts: Sequence[Mapped]) -> None:
        self._parts = [part for part in parts if any(entries.row.size for entries in part.entries)]
        self.sums = [
            Sums(shape, [part.entries[number] for part in self._parts]) for number, shape in enumerate(shapes)
        ]
        self._results = [np.zeros(total.n_local) for total in self.sums]
        self._views: list[list[Array]] = [[] for _ in self._parts]
        for number, whole in enumerate(self._results):
            first = 0
            for views, part in zip(self._views, self._parts, strict=True):
                shape = part.entries[number].row.shape
                size = shape[0] * shape[1]
                views.append(whole[first : first + size].reshape(shape))
                first += size
        for part in self._parts:
            part.entries = ()

    @property
    def pattern(self) -> sp.csc_array:
        """That of the last result, a matrix, with 1, 2, ... as values."""
        return self.sums[-1].numbered

    def __call__(self, *inputs: Array | None) -> list[Array]:
        """Nonzeros of each result at x, p, lam_f and lam_g, as many of them as it takes."""
        for part, views in zip(self._parts, self._views, strict=True):
            part(inputs, views)
        return [total(results) for total, results in zip(self.sums, self._results, strict=True)]


class _Gather:
    """One argument of a kernel from one input w: ``scale * w[index] + offset``, (length, elements)."""

    def __init__(self, source: int, field: Values) -> None:
        self._source, self._local = source, field if isinstance(field, LocalField) else None
        nodal = field.nodal if isinstance(field, LocalField) else field
        moving = nodal.index != CONSTANT
        self._offset = nodal.offset
        self._index, self._scale = np.where(moving, nodal.index, 0), np.where(moving, nodal.scale, 0.0)

    def __call__(self, inputs: Sequence[Array | None]) -> Array:
        w, values = inputs[self._source], self._offset
        if w is not None and w.size > 0:
            values = w[self._index]
            values *= self._scale
            values += self._offset
        return values if self._local is None else self._local.gathered(values)


def merged(groups: Sequence[ElementGroup]) -> list[ElementGroup]:
    """The groups, those of the same elements as one: what their functions have in common is done once."""
    distinct: list[ElementGroup] = []
    for group in groups:
        place = next((k for k, other in enumerate(distinct) if _alike(other, group)), None)
        if place is None:
            distinct.append(group)
        else:
            distinct[place] = _joined(distinct[place], group)
    return distinct


def _alike(first: ElementGroup, second: ElementGroup) -> bool:
    """Whether two groups have the same elements, as far as a shared argument says, and can be joined."""
    shared = first.size == second.size and any(
        _equal(a, b) for a in first.arguments for b in second.arguments
    )
    kinds = {group.function.class_name() for group in (first, second)}
    return shared and len(kinds) == 1 and (first.at_points is None or second.at_points is None)


def _joined(group: ElementGroup, other: ElementGroup) -> ElementGroup:
    """The group of the sum of two objectives, with the rows of both."""
    arguments, places = list(group.arguments), []
    for argument in other.arguments:
        place = next((k for k, own in enumerate(group.arguments) if _equal(own, argument)), len(arguments))
        arguments += [argument] if place == len(arguments) else []
        places.append(place)
    kind = ca.SX if group.function.is_a("SXFunction") else ca.MX
    columns = [kind.sym(f"a{i}", argument.shape[0]) for i, argument in enumerate(arguments)]
    at_points = group.at_points or other.at_points
    values: list[Expression] = [] if at_points is None else [kind.sym("values", at_points.size)]
    first = group.function(*columns[: len(group.arguments)], *(values if group.at_points else ()))
    second = other.function(*(columns[k] for k in places), *(values if other.at_points else ()))
    results = [first[0] + second[0], ca.vertcat(first[1], second[1])]
    function = ca.Function(group.function.name(), [*columns, *values], results)
    if at_points is not None and at_points is other.at_points:
        at_points = replace(at_points, place=places[at_points.place])
    return ElementGroup(function, tuple(arguments), np.concatenate([group.rows, other.rows]), at_points)


def _equal(first: Values, second: Values) -> bool:
    if isinstance(first, LocalField) and isinstance(second, LocalField) and first.nodal is second.nodal:
        return np.array_equal(first.nodes, second.nodes)
    return (
        first.parameter == second.parameter
        and np.array_equal(first.index, second.index)
        and np.array_equal(first.scale, second.scale)
        and np.array_equal(first.offset, second.offset)
    )
