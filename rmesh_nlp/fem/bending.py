"""Element groups some of whose nodes move along curves, as groups that are functions of affine values.

The curve is put into the function of the element: what is differentiated is then the composition, so that
gradients and Hessians of all programs are exact. Elements are sorted by which of their nodes are on which
curve, and each sort has a function of its own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.fem.element import PointValues
from rmesh_nlp.fem.fields import STRAIGHT, ElementGroup, Field, Index, some_elements


def straightened(group: ElementGroup) -> list[ElementGroup]:
    """The same elements in groups whose arguments are affine functions of the unknowns."""
    if all(field.bends is None for field in group.arguments) or group.size == 0:
        return [group]
    which = np.vstack([_which(field) for field in group.arguments])
    sorts, member = np.unique(which, axis=1, return_inverse=True)
    lengths = np.cumsum([field.index.shape[0] for field in group.arguments])[:-1]
    result = []
    for number, sort in enumerate(sorts.T):
        part = some_elements(group, np.flatnonzero(member.ravel() == number))
        if np.any(sort != STRAIGHT):
            part = _composed(part, np.split(sort, lengths))
        result.append(replace(part, arguments=tuple(replace(f, bends=None) for f in part.arguments)))
    return result


def _which(field: Field) -> Index:
    return np.full(field.index.shape, STRAIGHT) if field.bends is None else field.bends.which


def _composed(group: ElementGroup, sort: list[Index]) -> ElementGroup:
    function, at_points = group.function, group.at_points
    bends = [field.bends.functions if field.bends else () for field in group.arguments]
    used = [functions[k] for functions, row in zip(bends, sort, strict=True) for k in row if k != STRAIGHT]
    symbolic = all(f.is_a("SXFunction") for f in (function, *used))
    kind: Any = ca.SX if symbolic else ca.MX
    columns = [kind.sym(f"a{i}", field.index.shape[0]) for i, field in enumerate(group.arguments)]
    bent = [
        column if np.all(row == STRAIGHT) else _bent(column, row, functions)
        for column, row, functions in zip(columns, sort, bends, strict=True)
    ]
    values = [] if at_points is None else [kind.sym("values", function.size1_in(len(columns)))]
    composed = ca.Function(function.name(), [*columns, *values], function(*bent, *values))
    if at_points is not None:
        at_points = PointValues(ca.Function("points", columns, [at_points.points(*bent)]), at_points.function)
    return replace(group, function=composed, at_points=at_points)


def _bent(column: Any, row: Index, functions: tuple[ca.Function, ...]) -> Any:
    parts = [
        part if k == STRAIGHT else functions[k](part)
        for part, k in zip(ca.vertsplit(column), row, strict=True)
    ]
    return ca.vertcat(*parts)
