"""Element groups whose arguments are on curves, as functions of the affine values behind them."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Expression, Kind
from rmesh_nlp.fem.element import local_symbols
from rmesh_nlp.fem.fields import NONE, ElementGroup, constant_field
from rmesh_nlp.fem.space import Index


def straightened(group: ElementGroup) -> list[ElementGroup]:
    """The same elements in groups whose arguments are affine functions of the unknowns.

    What is differentiated is the composition with the curve. Elements are sorted by which of their values are
    on which curve, and each sort has a function of its own.
    """
    group = _with_modes(group)
    bends = [field.bends for field in group.arguments]
    if all(bend is None for bend in bends) or group.size == 0:
        return [group]
    which = np.vstack(
        [
            np.full(field.shape, NONE) if bend is None else bend.which
            for field, bend in zip(group.arguments, bends, strict=True)
        ]
    )
    sorts, member = np.unique(which, axis=1, return_inverse=True)
    lengths = np.cumsum([field.shape[0] for field in group.arguments])[:-1]
    result = []
    for number, sort in enumerate(sorts.T):
        part = group.some(np.flatnonzero(member.ravel() == number))
        if np.any(sort != NONE):
            part = _composed(part, np.split(sort, lengths))
        result.append(replace(part, arguments=tuple(field.straight() for field in part.arguments)))
    return result


def _with_modes(group: ElementGroup) -> ElementGroup:
    """The group as a function of amplitudes, too, where motions of shapes are added to an argument."""
    arguments = list(group.arguments)
    moved = [i for i, field in enumerate(arguments) if field.modes is not None]
    if not moved:
        return group
    group = _alone(group)
    columns = local_symbols(group.function)
    kind, inputs, inner = type(columns[0]), list(columns), list(columns)
    for i in moved:
        field, modes = arguments[i], arguments[i].modes
        assert modes is not None
        n, length, size = modes.motions.shape
        a, V = kind.sym("amplitudes", n), kind.sym("motions", n * length)
        inner[i] = columns[i] + ca.reshape(V, length, n) @ a
        amplitudes = modes.amplitudes.at(np.tile(np.arange(n)[:, None], size))
        motions = constant_field(modes.motions.reshape(n * length, size))
        inputs, arguments = [*inputs, a, V], [*arguments, amplitudes, motions]
        arguments[i] = replace(field, modes=None)
    function = ca.Function(group.function.name(), inputs, group.function(*inner))
    return replace(group, function=function, arguments=tuple(arguments))


def _composed(group: ElementGroup, sort: list[Index]) -> ElementGroup:
    """The group as a function of the affine values behind its arguments."""
    group = _alone(group)
    function = group.function
    bends = [bend.functions if bend else () for bend in (field.bends for field in group.arguments)]
    used = [functions[k] for functions, row in zip(bends, sort, strict=True) for k in row if k != NONE]
    kind: Kind = ca.SX if all(f.is_a("SXFunction") for f in (function, *used)) else ca.MX
    columns = [kind.sym(f"a{i}", field.shape[0]) for i, field in enumerate(group.arguments)]
    bent = [
        column if np.all(row == NONE) else _bent(column, row, functions)
        for column, row, functions in zip(columns, sort, bends, strict=True)
    ]
    return replace(group, function=ca.Function(function.name(), columns, function(*bent)))


def _alone(group: ElementGroup) -> ElementGroup:
    """The group with its values at points put in."""
    return replace(group, function=group.plain, at_points=None)


def _bent(column: Expression, row: Index, functions: tuple[ca.Function, ...]) -> Expression:
    parts = zip(ca.vertsplit(column), row, strict=True)
    return ca.vertcat(*[part if k == NONE else functions[k](part) for part, k in parts])
