"""Conditions of a Pyomo model as rows of a ``.nl`` file, those with both bounds on one side included.

A condition has two members with two bounds in all. One becomes a variable with its bounds, the other a row,
see :mod:`rmesh_nlp.mpcc.nl`. A variable of the model serves itself only where its own bounds are not tighter:
a bound of its own holds, but complements nothing. Pyomo 6.10's ``mpec.nl`` takes the tighter one for both.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from pyomo.core.base import Block, Constraint, Var, value
from pyomo.core.expr.numvalue import is_fixed, is_potentially_variable
from pyomo.mpec import Complementarity

_ADDED = ("body", "row", "equation", "member", "same")  # to each condition
Member = tuple[Any, float, float]
"""An expression and its bounds."""
Changed = dict[int, tuple[Any, Any, Any]]
"""Variables of the model that serve in a condition, with their own bounds, by id."""


@contextmanager
def conditions_as_rows(model: Any) -> Iterator[dict[str, Any]]:
    """Make the conditions blocks of rows and variables within the context; it gives options of the writer.

    Raises
    ------
    ValueError
        If a condition is no pair, or does not have two constant bounds in all.
    """
    conditions = list(model.component_objects(Complementarity, active=True, descend_into=True))
    changed: Changed = {}
    try:
        for condition in conditions:
            for data in condition.values():
                if data.active:
                    _write(data, changed)
            condition.parent_block().reclassify_component_type(condition, Block)
        # the writer leaves out a variable that no row and no objective depends on
        yield {"export_nonlinear_variables": [variable for variable, *_ in changed.values()]}
    finally:
        for condition in conditions:
            condition.parent_block().reclassify_component_type(condition, Complementarity)
        for variable, lower, upper in changed.values():
            variable.lower, variable.upper = lower, upper


def _write(data: Any, changed: Changed) -> None:
    """Add the variable and the row of one condition."""
    for name in _ADDED:  # of a solve before
        if data.component(name) is not None:
            data.del_component(name)
    if len(data._args) != 2:
        raise ValueError(f"the condition {data.name} is not a pair")
    members = [_member(data, expression) for expression in data._args]
    if sum(map(_n_bounds, members)) != 2:
        raise ValueError(f"the condition {data.name} must have two bounds in all")
    # the variable is a two-sided member, else one that serves itself
    members.sort(key=lambda member: (-_n_bounds(member), not _serves(member, changed)))
    (inner, lower, upper), (outer, *bounds) = members
    if lower == upper:
        data.row = Constraint(expr=(lower, inner, upper))
        return
    bits = int(np.isfinite(lower)) + 2 * int(np.isfinite(upper))
    distance = outer if bits == 3 else outer - bounds[0] if np.isfinite(bounds[0]) else bounds[1] - outer
    if bits == 2:  # at an upper bound the row is not positive
        distance = -distance
    data.body = Var(initialize=value(distance, exception=False))
    data.equation = Constraint(expr=data.body == distance)
    # the writer leaves out rows without bounds, and constants of rows that complement; it ignores -1, 1
    data.row = Constraint(expr=(-1, data.body, 1))
    if _serves(members[0], changed):
        changed[id(inner)] = inner, inner.lower, inner.upper
        inner.lower, inner.upper = lower if bits & 1 else inner.lb, upper if bits & 2 else inner.ub
    else:
        data.member = Var(bounds=(lower, upper), initialize=value(inner, exception=False))
        data.same = Constraint(expr=data.member == inner)
        inner = data.member
    data.row._complementarity, data.row._vid = bits, id(inner)


def _member(data: Any, expression: Any) -> Member:
    """One member of a condition; the bounds of an equation are equal."""
    form = data._canonical_expression(expression)
    lower, body, upper = form if len(form) == 3 else (form[0], form[1], form[0])
    if not (is_fixed(lower) and is_fixed(upper)):
        raise ValueError(f"a bound in the condition {data.name} is not constant: {expression}")
    return body, *_numbers(lower, upper)


def _numbers(lower: Any, upper: Any) -> tuple[float, float]:
    """Bounds as numbers; what is not there is infinite."""
    return -np.inf if lower is None else float(value(lower)), np.inf if upper is None else float(value(upper))


def _n_bounds(member: Member) -> int:
    return int(np.sum(np.isfinite(member[1:])))


def _serves(member: Member, changed: Changed) -> bool:
    """Whether a member is a variable that may take the bounds of the condition for its own."""
    body, *bounds = member
    if not (is_potentially_variable(body) and body.is_variable_type()) or body.fixed or id(body) in changed:
        return False
    low, high = _numbers(body.lb, body.ub)
    return all(low <= bound <= high for bound in bounds if np.isfinite(bound))
