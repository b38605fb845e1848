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
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field, Index
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


def contact_force_group(
    problem: ContactProblem, rows: Index, normal_force: Field, friction: tuple[Field, Field] | None
) -> ElementGroup:
    """Rows ``-lambda n + (mu- - mu+) t`` of the equilibrium at contact nodes.

    ``rows`` is (components, nodes): the row of each displacement unknown.
    """
    nodes = problem.contact_nodes[None, :]
    fields = (normal_force, *(friction or ()))
    return ElementGroup(
        _contact_force(problem.obstacle, friction is not None),
        tuple(field.at(nodes) for field in fields),
        rows[:, nodes[0]],
    )


def _contact_force(obstacle: Obstacle, frictional: bool) -> ca.Function:
    pressure, minus, plus = ca.SX.sym("lambda"), ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
    force = -pressure * ca.DM(obstacle.normal)
    if not frictional:
        return ca.Function("contact_force", [pressure], [0, force])
    force += (minus - plus) * ca.DM(obstacle.tangent)
    return ca.Function("contact_force", [pressure, minus, plus], [0, force])


def bound_force_group(problem: ContactProblem, rows: Index, friction: tuple[Field, Field]) -> ElementGroup:
    """Rows ``-mu- - mu+`` of the stationarity with respect to the slip magnitudes."""
    nodes = problem.contact_nodes[None, :]
    minus, plus = ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
    function = ca.Function("bound_force", [minus, plus], [0, -minus - plus])
    return ElementGroup(function, tuple(field.at(nodes) for field in friction), rows[None, :])


def identity_group(field: Field, nodes: Index, rows: Index) -> ElementGroup:
    """Rows that repeat the unknowns of a scalar field at ``nodes``."""
    value = ca.SX.sym("value")
    return ElementGroup(
        ca.Function("identity", [value], [0, value]), (field.at(nodes[None, :]),), rows[None, :]
    )
