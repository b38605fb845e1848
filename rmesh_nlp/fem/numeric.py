"""Sums over elements in numpy: functions of arrays, for all elements at a time."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import Local, differentiated, local_symbols
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field
from rmesh_nlp.fem.space import Index
from rmesh_nlp.fem.sums import Entries, Shape, Sums
from rmesh_nlp.vectorised import columnwise

Inputs = Sequence[Array | None]
"""x, p, lam_f and lam_g, as far as they are needed; None is zero."""


class Numeric:
    """Sums over element groups as functions of arrays; the last results are remembered.

    Each group has a :class:`_Part`, which makes its local results.
    """

    def __init__(self, shapes: Sequence[Shape], parts: Sequence[tuple[_Part, Sequence[Entries]]]) -> None:
        used = [(part, entries) for part, entries in parts if any(entry.row.size for entry in entries)]
        self._parts = [part for part, _ in used]
        self.sums = [Sums(shape, [entries[k] for _, entries in used]) for k, shape in enumerate(shapes)]
        self._last: tuple[list[bytes | None], list[Array]] | None = None

    @property
    def pattern(self) -> sp.csc_array:
        """That of the last result, a matrix, with 1, 2, ... as values."""
        return self.sums[-1].numbered

    def __call__(self, *inputs: Array | None) -> list[Array]:
        """Nonzeros of each result, not to be written to, at as many of x, p, lam_f and lam_g as it takes."""
        key = [None if values is None else values.tobytes() for values in inputs]
        if self._last is None or key != self._last[0]:
            local = [part(inputs) for part in self._parts]
            self._last = key, [total([part[k] for part in local]) for k, total in enumerate(self.sums)]
        return self._last[1]


def first_order(groups: Sequence[ElementGroup], n_x: int, n_rows: int) -> Numeric:
    """``(x, p) -> (f, its gradient, g, nonzeros of its Jacobian)`` of the sum of groups."""
    parts = []
    for group in groups:
        variable, (one, rows, x) = _variable(group), _axes(group)
        local = differentiated(group.function, group.at_points, variable).first
        axes = (one, one), (x, one), (rows, one), (rows, x)
        entries = [_entries(*pair, pattern) for pair, pattern in zip(axes, local.patterns, strict=True)]
        parts.append((_Part(group, local), entries))
    return Numeric(((1, 1), (n_x, 1), (n_rows, 1), (n_rows, n_x)), parts)


def second_order(groups: Sequence[ElementGroup], n_x: int, n_rows: int) -> Numeric:
    """``(x, p, lam_f, lam_g) ->`` nonzeros of the Hessian of ``lam_f f + lam_g . g``, its upper triangle."""
    parts = []
    for group in groups:
        variable, (one, rows, x) = _variable(group), _axes(group)
        local = differentiated(group.function, group.at_points, variable).second
        part = _Part(group, local, ((2, one), (3, rows)))
        parts.append((part, [_upper(_entries(x, x, local.patterns[0]), local.patterns[0])]))
    return Numeric(((n_x, n_x),), parts)


def _variable(group: ElementGroup) -> list[int]:
    """Numbers of the arguments that depend on unknowns."""
    fields = enumerate(group.arguments)
    return [i for i, f in fields if not f.parameter and np.any(f.index != CONSTANT)]


def _axes(group: ElementGroup) -> tuple[Field, Field, Field]:
    """Numbers and scales (length, elements): zeros for the objective, constraint rows, unknowns."""
    none, variable = np.zeros((0, group.size)), [group.arguments[i] for i in _variable(group)]
    unknowns = Field(
        np.concatenate([none.astype(np.int64), *(field.index for field in variable)]),
        np.concatenate([none, *(field.scale for field in variable)]),
        none,
    )
    return _plain(np.zeros((1, group.size), np.int64)), _plain(group.rows), unknowns


def _plain(index: Index) -> Field:
    return Field(index, np.ones(index.shape), np.zeros(index.shape))


def _entries(row: Field, column: Field, pattern: ca.Sparsity) -> Entries:
    """Where the local results with this pattern go."""
    a, b = (np.asarray(numbers, dtype=int) for numbers in pattern.get_triplet())
    return Entries(row.index[a], column.index[b], row.scale[a] * column.scale[b])


def _upper(entries: Entries, pattern: ca.Sparsity) -> Entries:
    """Those of an upper triangle in that of the sum."""
    i, j, scale = entries
    a, b = (np.asarray(numbers, dtype=int) for numbers in pattern.get_triplet())
    # of two local values of one unknown the lower triangle folds onto the diagonal too
    twice = (i == j) & (a != b)[:, None]
    return Entries(np.minimum(i, j), np.maximum(i, j), np.where(twice, 2.0, 1.0) * scale)


class _Part:
    """Local results of one group, each (length, elements)."""

    def __init__(
        self, group: ElementGroup, local: Local, multipliers: tuple[tuple[int, Field], ...] = ()
    ) -> None:
        self._at_points, self._order, self._n = group.at_points, local.order, len(group.arguments)
        self._columns = columnwise(local.function, group.size)
        arguments = [(int(field.parameter), field) for field in group.arguments]
        self._gathers = [_Gather(*argument) for argument in (*arguments, *multipliers)]

    def __call__(self, inputs: Inputs) -> list[Array]:
        columns = [gather(inputs) for gather in self._gathers]
        if self._at_points is not None:
            columns[self._n : self._n] = self._at_points.evaluated(columns[0], self._order)
        return self._columns(columns)


class _Gather:
    """One argument of a part from one input w: ``scale * w[index] + offset``, (length, elements)."""

    def __init__(self, source: int, field: Field) -> None:
        moving = field.index != CONSTANT
        self._source, self._offset = source, field.offset
        self._index, self._scale = np.where(moving, field.index, 0), np.where(moving, field.scale, 0.0)

    def __call__(self, inputs: Inputs) -> Array:
        w = inputs[self._source]
        if w is None or w.size == 0:
            return self._offset
        values = w[self._index]
        values *= self._scale
        values += self._offset
        return values


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
    if other.at_points is not None:  # the first argument is X, the last one has the values
        group, other = other, group
    arguments, places = list(group.arguments), []
    for argument in other.arguments:
        place = next((k for k, own in enumerate(group.arguments) if _equal(own, argument)), len(arguments))
        arguments += [argument] if place == len(arguments) else []
        places.append(place)
    own, n = local_symbols(group.function), len(group.arguments)
    added = [type(own[0]).sym(f"b{i}", argument.shape[0]) for i, argument in enumerate(arguments[n:])]
    columns, values = [*own[:n], *added], own[n:]
    first, second = group.function(*own), other.function(*(columns[k] for k in places))
    results = [first[0] + second[0], ca.vertcat(first[1], second[1])]
    function = ca.Function(group.function.name(), [*columns, *values], results)
    rows = np.concatenate([group.rows, other.rows])
    return ElementGroup(function, tuple(arguments), rows, group.at_points)


def _equal(first: Field, second: Field) -> bool:
    return (
        first.parameter == second.parameter
        and np.array_equal(first.index, second.index)
        and np.array_equal(first.scale, second.scale)
        and np.array_equal(first.offset, second.offset)
    )
