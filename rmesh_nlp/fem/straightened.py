"""Element groups whose arguments are on curves or moved by shapes, as functions of affine values."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Expression, Index, kind_of
from rmesh_nlp.fem.fields import NONE, Bends, ElementGroup, constant_field


def straightened(group: ElementGroup) -> list[ElementGroup]:
    """The same elements in groups whose arguments are affine functions of the unknowns.

    What is differentiated is the composition with curves and motions of shapes. Elements are sorted by which
    of their values are on which curve, and each sort has a function of its own.
    """
    moved = any(field.modes is not None for field in group.arguments)
    if group.size == 0 or not (moved or any(field.bends is not None for field in group.arguments)):
        return [group]
    which = [np.full(f.shape, NONE) if f.bends is None else f.bends.which for f in group.arguments]
    sorts, member = np.unique(np.vstack(which), axis=1, return_inverse=True)
    lengths = np.cumsum([field.shape[0] for field in group.arguments])[:-1]
    result = []
    for number, sort in enumerate(sorts.T):
        part = group.some(np.flatnonzero(member.ravel() == number))
        if moved or np.any(sort != NONE):
            part = _composed(part, np.split(sort, lengths))
        arguments = (replace(field, bends=None, modes=None) for field in part.arguments)
        result.append(replace(part, arguments=tuple(arguments)))
    return result


def _composed(group: ElementGroup, sort: list[Index]) -> ElementGroup:
    """The group as a function of the affine values behind its arguments, and of amplitudes of motions."""
    curves = [function for f in group.arguments if f.bends is not None for function in f.bends.functions]
    kind = kind_of(group.plain, *curves)
    columns = [kind.sym(f"a{i}", field.shape[0]) for i, field in enumerate(group.arguments)]
    arguments, inputs, values = list(group.arguments), list(columns), []
    for field, column, row in zip(group.arguments, columns, sort, strict=True):
        value = column if field.bends is None else _bent(column, row, field.bends)
        if field.modes is not None:
            n, length, size = field.modes.motions.shape
            a, V = kind.sym("amplitudes", n), kind.sym("motions", n * length)
            value += ca.reshape(V, length, n) @ a
            arguments.append(field.modes.amplitudes.at(np.tile(np.arange(n)[:, None], size)))
            arguments.append(constant_field(field.modes.motions.reshape(n * length, size)))
            inputs += [a, V]
        values.append(value)
    function = ca.Function(group.function.name(), inputs, group.plain(*values))
    return ElementGroup(function, tuple(arguments), group.rows)


def _bent(column: Expression, row: Index, bends: Bends) -> Expression:
    parts = zip(ca.vertsplit(column), row, strict=True)
    return ca.vertcat(*[part if k == NONE else bends.functions[k](part) for part, k in parts])
