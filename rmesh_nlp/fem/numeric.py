"""Sums over elements in numpy: functions of arrays, for all elements at a time.

Energies of triangles are in closed form (:mod:`rmesh_nlp.fem.closed_forms`), and those of the same triangles
are added up before they are summed; all other element functions are CasADi's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.closed_forms import Layout, evaluated
from rmesh_nlp.fem.element import FEW, RESULTS, differentiated
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, LocalField, Values
from rmesh_nlp.fem.space import Index
from rmesh_nlp.fem.sums import Entries, Shape, Sums
from rmesh_nlp.vectorised import AssemblySettings, columnwise


class Kernel(NamedTuple):
    """A function of one element, the inputs that its arguments come from, and where its results go.

    Inputs are x, p, lam_f and lam_g. Result number k is summed into output number k.
    """

    function: ca.Function
    arguments: tuple[tuple[int, Values], ...]
    results: tuple[Entries, ...]
    size: int


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

    def kernel(self, which: str, leading: int | None = None) -> Kernel:
        """The kernel with the results ``RESULTS[which]``; see :meth:`Assembled.numeric` for ``leading``."""
        results = tuple(self._entries(name, leading) for name in RESULTS[which])
        function = self._local.function(which, for_few=self.group.size <= FEW)
        return Kernel(function, self.arguments(which), results, self.group.size)

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


class _Mapped:
    """Local results of one kernel, by its function over all elements."""

    def __init__(self, kernel: Kernel, settings: AssemblySettings) -> None:
        self.entries, self._size = kernel.results, kernel.size
        self._columns = columnwise(kernel.function, kernel.size, settings)
        self._gathers = [_Gather(*a) for a in kernel.arguments]

    def __call__(self, inputs: Inputs, outputs: list[Array]) -> None:
        """Write the results into arrays (length, elements)."""
        results = self._columns([gather(inputs) for gather in self._gathers])
        for output, result in zip(outputs, results, strict=True):
            output[:] = result


class _Triangles:
    """Local results of energies of the same triangles in closed form, added up."""

    def __init__(self, groups: list[ElementGroup], which: str, leading: int | None) -> None:
        largest = max(groups, key=lambda group: group.used)
        variable = [i for i in _variable(largest) if i < largest.used]
        self._forms, self._which = [group.closed for group in groups if group.closed is not None], which
        self._gathers = [_Gather(int(f.parameter), f) for f in largest.arguments[: largest.used]]
        axes = _axes(largest, variable)
        moves = 0 in variable
        displacements = axes["x"].index[6 if moves else 0 :]
        corner = leading is None or np.any((displacements != CONSTANT) & (displacements < leading))
        self._layout = layout = Layout(moves, len(displacements), bool(corner))
        zero = np.zeros(1, int)
        entries = {
            "f": (zero, zero),
            "g": (zero[:0], zero[:0]),
            "gradient": (np.arange(layout.size), np.zeros(layout.size, int)),
            "jacobian": (zero[:0], zero[:0]),
            "hessian": layout.entries,
        }
        self.entries = tuple(_entries(axes, name, *entries[name], leading) for name in RESULTS[which])

    def __call__(self, inputs: Inputs, outputs: list[Array]) -> None:
        """Write the results into arrays (length, elements)."""
        if all(output.size == 0 for output in outputs):
            return
        X, *u = [gather(inputs) for gather in self._gathers]
        evaluated(self._forms, self._which, self._layout, X, u[0] if u else None, outputs)
        if self._which == "hessian":
            factor = 0.0 if inputs[2] is None else float(inputs[2][0])
            if factor != 1.0:
                outputs[0] *= factor


class Numeric:
    """The sums over element groups as a function of arrays."""

    def __init__(self, shapes: list[Shape], parts: Sequence[_Mapped | _Triangles]) -> None:
        self._parts = [part for part in parts if any(map(_any_kept, part.entries))]
        self.sums = [
            Sums(shape, [part.entries[number] for part in self._parts]) for number, shape in enumerate(shapes)
        ]
        self._results = [np.zeros(one.n_local) for one in self.sums]
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

    def __call__(self, *inputs: Array | None) -> list[Array]:
        """Nonzeros of each result at x, p, lam_f and lam_g, as many of them as it takes."""
        for part, views in zip(self._parts, self._views, strict=True):
            part(inputs, views)
        return [one(results) for one, results in zip(self.sums, self._results, strict=True)]


def _any_kept(entries: Entries) -> bool:
    return bool(np.any((entries.row >= 0) & (entries.column >= 0)))


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


def _alike(one: ElementGroup, other: ElementGroup) -> bool:
    """Whether two groups of energies in closed form have the same triangles, as far as both say."""
    pairs = zip(one.arguments[: one.used], other.arguments[: other.used], strict=False)
    return one.size == other.size and all(_equal(a, b) for a, b in pairs)


def _equal(one: Values, other: Values) -> bool:
    if isinstance(one, LocalField) and isinstance(other, LocalField) and one.nodal is other.nodal:
        return np.array_equal(one.nodes, other.nodes)
    return (
        one.parameter == other.parameter
        and np.array_equal(one.index, other.index)
        and np.array_equal(one.scale, other.scale)
        and np.array_equal(one.offset, other.offset)
    )


def numeric_parts(
    groups: Sequence[ElementGroup], which: str, leading: int | None, settings: AssemblySettings
) -> list[_Mapped | _Triangles]:
    """What gives the local results of element groups; those of the same triangles together."""
    closed: list[list[ElementGroup]] = []
    parts: list[_Mapped | _Triangles] = []
    for group in groups:
        if group.closed is None:
            parts.append(_Mapped(LocalKernels(group).kernel(which, leading), settings))
            continue
        same = next((those for those in closed if _alike(those[0], group)), None)
        if same is None:
            closed.append([group])
        else:
            same.append(group)
    return parts + [_Triangles(those, which, leading) for those in closed]
