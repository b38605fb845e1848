"""KKT conditions of the inner contact problem as element groups: the constraints of ``mpcc``.

With lambda_i >= 0 on the gaps and, with friction, mu-_i, mu+_i >= 0 on ``s_i - u_t,i >= 0``
and ``s_i + u_t,i >= 0``, the stationarity of the inner Lagrangian reads, node by node,

    dJ/du_i - lambda_i n + (mu-_i - mu+_i) t = 0,      g omega_i - mu-_i - mu+_i = 0,

J being the energy without friction.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.fem.element import local_symbols
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, Index, unknown_field
from rmesh_nlp.problem import ContactProblem, Obstacle


def gradient_group(group: ElementGroup, argument: int, shift: int, unit: float) -> ElementGroup:
    """Constraint rows with the derivative of an energy group with respect to one argument.

    No value at points may depend on the argument. The unknown ``x[k]`` owns the row
    ``k + shift``; the rows are in units of ``unit``.
    """
    function = group.function
    symbols = local_symbols(function)
    f = function(*symbols)[0]
    residual = ca.densify(ca.gradient(f, symbols[argument])) / unit
    index = group.arguments[argument].index
    return replace(
        group,
        function=ca.Function(f"{function.name()}_gradient", symbols, [0, residual]),
        rows=np.where(index == CONSTANT, CONSTANT, index + shift),
    )


def contact_force_groups(
    problem: ContactProblem,
    rows: Index,
    positions: Field,
    normal_force: Field,
    friction: tuple[Field, Field] | None,
) -> list[ElementGroup]:
    """Rows ``-lambda n + (mu- - mu+) t`` of the equilibrium at contact nodes.

    ``rows`` is (components, nodes): the row of each displacement unknown; the multipliers are fields
    (obstacles, nodes).
    """
    groups = []
    for part in problem.contact_sets:
        nodes = part.nodes[None, :]
        used = (normal_force, *(friction or ())) if part.obstacle.frictional else (normal_force,)
        multipliers = tuple(field.component(part.number).at(nodes) for field in used)
        function = _contact_force(part.obstacle)
        groups.append(ElementGroup(function, (positions.at(nodes), *multipliers), rows[:, part.nodes]))
    return groups


def _contact_force(obstacle: Obstacle) -> ca.Function:
    """``(X_i, lambda[, mu-, mu+]) -> (0, force)``."""
    X = ca.SX.sym("X", 2)
    pressure, minus, plus = ca.SX.sym("lambda"), ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
    force = -pressure * obstacle.direction(X[0], X[1])
    if not obstacle.frictional:
        return ca.Function("contact_force", [X, pressure], [0, force])
    force += (minus - plus) * obstacle.tangential(X[0], X[1])
    return ca.Function("contact_force", [X, pressure, minus, plus], [0, force])


def bound_force_groups(
    problem: ContactProblem, first_row: int, friction: tuple[Field, Field]
) -> list[ElementGroup]:
    """Rows ``-mu- - mu+`` of the stationarity with respect to the slip magnitudes."""
    minus, plus = ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
    function = ca.Function("bound_force", [minus, plus], [0, -minus - plus])
    groups = []
    for part in problem.contact_sets:
        if part.obstacle.frictional:
            local = tuple(field.component(part.number).at(part.nodes[None, :]) for field in friction)
            groups.append(ElementGroup(function, local, first_row + np.arange(part.nodes.size)[None, :]))
            first_row += part.nodes.size
    return groups


def identity_group(first: int, rows: Index) -> ElementGroup:
    """Rows that repeat the unknowns numbered from ``first``."""
    value = ca.SX.sym("value")
    field = unknown_field((1, rows.size), first)
    return ElementGroup(ca.Function("identity", [value], [0, value]), (field,), rows[None, :])
