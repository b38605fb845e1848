"""Contact as element functions: gaps, slips, friction, and the contact forces of the KKT conditions.

Fields of slips and contact forces have one component per obstacle, for a node may meet two of them. With
lambda_i >= 0 on the gaps and, with friction, mu-_i, mu+_i >= 0 on ``s_i - u_t,i >= 0`` and
``s_i + u_t,i >= 0``, the stationarity of the inner Lagrangian reads, node by node,

    dJ/du_i - lambda_i n + (mu-_i - mu+_i) t = 0,      g omega_i - mu-_i - mu+_i = 0,

J being the energy without friction: the constraints of ``mpcc``. With Coulomb's coefficient F the second one
has ``F_i lambda_i`` in addition.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.cells import Cell, Straight
from rmesh_nlp.fem.edge_gaps import directions, displaced, edge_gaps, holds_along_edges
from rmesh_nlp.fem.element import local_symbols
from rmesh_nlp.fem.fields import NONE, ElementGroup, Field, Fields, plain_field, unknown_field
from rmesh_nlp.fem.functional import Groups
from rmesh_nlp.fem.pieces import piecewise
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import Obstacle, at
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, once
from rmesh_nlp.problem.data import ContactSet

OWN = (1.0,)
"""Share of the one vertex that carries a node, and factor of its displacement."""

FRICTION_DEGREE = 31
"""Degree of the rule for the integral of the friction bound: exact to 1e-6 for four waves within an edge."""


@once
def friction_energy(bound: Coefficient, edge: Cell) -> ca.Function:
    """``(*place, s_e) -> (energy, empty)`` on one contact edge.

    The integral of g times the sum of s_i and shape functions, with the slip magnitudes s_i = |u_t,i|: by
    convexity at least that of g |u_t|. With a constant bound and order 1 it is |e| g (s_1 + s_2) / 2, the
    trapezoidal rule of (5.9).
    Where a bound jumps or kinks the rule is that of the pieces: a solver would never end at a sum that jumps.
    """
    degree = FRICTION_DEGREE if callable(bound) else edge.order
    rule = piecewise(edge, [bound], degree) if isinstance(edge, Straight) else edge.rule(FRICTION_DEGREE)
    return edge.function("friction_energy", edge.integral(lambda x, y, s, _: at(bound, x, y) * s, rule))


def _forces(shares: Array) -> tuple[ca.SX, ...]:
    """Positions of the vertices of a contact node, and its forces: pressure, minus and plus."""
    return ca.SX.sym("X", 2, shares.size), *map(ca.SX.sym, ("lambda", "mu_minus", "mu_plus"))


@once
def gap_function(
    obstacle: Obstacle, shares: tuple[float, ...], factors: tuple[float, ...] = OWN
) -> ca.Function:
    """``(X_i, u) -> (0, gap)`` of one contact node: normal(X) . (u @ factors) + distance(X).

    At an edge it is the coefficient of the parabola through the gaps at ends and middle.
    """
    X, (obstacle, moved), place = ca.SX.sym("X", 2, len(shares)), obstacle.unmoved, np.array(shares)
    normals, distance = directions(obstacle, X, place), obstacle.distance(*ca.vertsplit(X @ place))
    u, met = displaced(normals, np.array(factors))
    if place.size == 2:
        ends = [obstacle.distance(*ca.vertsplit(end)) for end in ca.horzsplit(X)]
        distance = 2 * distance - (ends[0] + ends[1]) / 2
    gap = ca.dot(normals, met - ca.repmat(moved, 1, met.shape[1])) + distance
    return ca.Function("gap", [ca.vec(X), ca.vec(u)], [0, gap], OPEN)


def slip_function(obstacle: Obstacle, shares: Array, factors: Array) -> ca.Function:
    """``(X_i, u, s_i) -> (0, (s - u_t, s + u_t))`` of one contact node."""
    X, s = ca.SX.sym("X", 2, shares.size), ca.SX.sym("s")
    tangents = directions(obstacle, X, shares, along=True)
    u, met = displaced(tangents, factors)
    slip = ca.dot(tangents, met)
    return ca.Function("slip", [ca.vec(X), ca.vec(u), s], [0, ca.vertcat(s - slip, s + slip)], OPEN)


def force_function(obstacle: Obstacle, shares: Array, factors: Array) -> ca.Function:
    """``(X_i, lambda[, mu-, mu+]) -> (0, (-lambda n + (mu- - mu+) t) @ factors^T)`` of one contact node."""
    X, pressure, minus, plus = _forces(shares)
    force, used = -pressure * directions(obstacle, X, shares), [ca.vec(X), pressure]
    if obstacle.friction_law:
        force += (minus - plus) * directions(obstacle, X, shares, along=True)
        used += [minus, plus]
    rows = ca.vec(ca.horzcat(*(factor * force for factor in factors)))
    return ca.Function("contact_force", used, [0, rows], OPEN)


def gaps(on: Fields, first_row: int = 0) -> Groups:
    """One constraint row per contact node and obstacle: its gap."""
    groups: Groups = []
    for part in on.space.contact_sets:
        rows = first_row + part.rows
        if holds_along_edges(on.problem, part.obstacle):
            groups += edge_gaps(on, part, rows)
            continue
        for which, vertices, shares in on.space.kinds(part.nodes):
            function = gap_function(part.obstacle, tuple(shares), tuple(part.factors))
            local = on.positions.at(vertices), on.displacement.at(on.space.carriers(part, which, vertices))
            groups.append(on.group(function, local, rows[None, which]))
    return groups


def given_gaps(on: Fields, first_row: int) -> Groups:
    """The gaps of contact nodes whose displacement is given.

    On a mesh as given they are a matter of the problem; designs change them.
    """
    groups = []
    for part in on.problem.contact_sets:
        nodes = on.problem.given_gaps(part)[0][None]
        if nodes.size:
            function = gap_function(part.obstacle, OWN)
            rows = first_row + np.arange(nodes.size)[None]
            groups.append(on.group(function, [on.positions.at(nodes), on.displacement.at(nodes)], rows))
            first_row += nodes.size
    return groups


def friction(on: Fields) -> Groups:
    """Friction energy."""
    rough = [part for part, _ in _frictional(on.space) if part.obstacle.friction_law.has_given]
    return [group for part in rough for group in bounds(on, part, part.obstacle.friction_law.given, on.slip)]


def bounds(on: Fields, part: ContactSet, bound: Coefficient, values: Field) -> Groups:
    """The integral over a contact set of ``bound`` times ``values`` (obstacles, nodes)."""
    own, edges = values.component(part.number), on.edges(str(part.obstacle.boundary), 1)
    return [on.group(friction_energy(bound, edge), [place, own.at(nodes)]) for edge, place, nodes in edges]


def slips(on: Fields, first_row: int = 0) -> Groups:
    """Rows ``s - u_t >= 0`` of all contact nodes with friction, then ``s + u_t >= 0``."""
    groups, n_s = [], np.count_nonzero(on.space.frictional)
    for part, numbers in _frictional(on.space):
        slip = on.slip.component(part.number)
        for which, vertices, shares in on.space.kinds(part.nodes):
            rows, u = first_row + numbers[which] + np.array([[0], [n_s]]), on.displacement
            carriers = on.space.carriers(part, which, vertices)
            local = on.positions.at(vertices), u.at(carriers), slip.at(part.nodes[None, which])
            groups.append(on.group(slip_function(part.obstacle, shares, part.factors), local, rows))
    return groups


def gap_field(space: DisplacementSpace) -> Field:
    """One unknown per gap, numbered from zero, as a field (obstacles, nodes); zero elsewhere."""
    return _numbered(space, [(part, part.rows) for part in space.contact_sets])


def slip_field(space: DisplacementSpace) -> Field:
    """One unknown per gap with friction, numbered from zero, as a field (obstacles, nodes)."""
    return _numbered(space, _frictional(space))


def _numbered(space: DisplacementSpace, parts: list[tuple[ContactSet, Index]]) -> Field:
    index = np.full((max(len(space.contact_sets), 1), space.n_nodes), NONE)
    for part, numbers in parts:
        index[part.number, part.nodes] = numbers
    return plain_field(index)


def _frictional(space: DisplacementSpace) -> list[tuple[ContactSet, Index]]:
    """Contact sets with friction, and the numbers of their slip magnitudes."""
    parts = [part for part in space.contact_sets if part.obstacle.friction_law]
    first = np.cumsum([0, *(part.nodes.size for part in parts)])
    return [(part, start + np.arange(part.nodes.size)) for part, start in zip(parts, first[:-1], strict=True)]


def gradient_group(group: ElementGroup, shift: int, unit: float) -> ElementGroup:
    """Constraint rows with the derivative of an energy group with respect to its last argument.

    No value at points may depend on the argument. The unknown ``x[k]`` owns the row
    ``k + shift``; the rows are in units of ``unit``.
    """
    function = group.function
    symbols, argument = local_symbols(function), len(group.arguments) - 1
    residual = ca.densify(ca.gradient(function(*symbols)[0], symbols[argument])) / unit
    index = group.arguments[argument].index
    return replace(
        group,
        function=ca.Function(f"{function.name()}_gradient", symbols, [0, residual]),
        rows=np.where(index == NONE, NONE, index + shift),
    )


def contact_force_groups(on: Fields, rows: Index) -> Groups:
    """Rows ``-lambda n + (mu- - mu+) t`` of the equilibrium at contact nodes.

    ``rows`` is (components, nodes): the row of each displacement unknown.
    """
    assert on.forces is not None
    groups = []
    for part in on.space.contact_sets:
        used = on.forces if part.obstacle.friction_law else on.forces[:1]
        for which, vertices, shares in on.space.kinds(part.nodes):
            forces = (field.component(part.number).at(part.nodes[None, which]) for field in used)
            function = force_function(part.obstacle, shares, part.factors)
            own = np.vstack([rows[:, nodes] for nodes in on.space.carriers(part, which, vertices)])
            groups.append(on.group(function, [on.positions.at(vertices), *forces], own))
    return groups


def bound_function(obstacle: Obstacle, shares: Array) -> ca.Function:
    """``(X_i, lambda, mu-, mu+) -> (0, F(X) lambda - mu- - mu+)`` of one contact node."""
    X, pressure, minus, plus = _forces(shares)
    value = at(obstacle.friction_law.slope, *ca.vertsplit(X @ shares)) * pressure - minus - plus
    return ca.Function("bound_force", [ca.vec(X), pressure, minus, plus], [0, value], OPEN)


def bound_force_groups(on: Fields, first_row: int) -> Groups:
    """Rows ``F lambda - mu- - mu+`` of the stationarity with respect to the slip magnitudes."""
    assert on.forces is not None
    groups = []
    for part, numbers in _frictional(on.space):
        for which, vertices, shares in on.space.kinds(part.nodes):
            nodes = part.nodes[None, which]
            forces = (field.component(part.number).at(nodes) for field in on.forces)
            function, rows = bound_function(part.obstacle, shares), first_row + numbers[None, which]
            groups.append(on.group(function, [on.positions.at(vertices), *forces], rows))
    return groups


def identity_group(first: int, rows: Index) -> ElementGroup:
    """Rows that repeat the unknowns numbered from ``first``."""
    value = ca.SX.sym("value")
    field = unknown_field((1, rows.size), first)
    return ElementGroup(ca.Function("identity", [value], [0, value]), (field,), rows[None, :])
