"""Contact as element functions: gaps, friction, slips, and where they are on a mesh.

Fields of slips and contact forces have one component per obstacle, for a node may meet two of them.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem import arcs
from rmesh_nlp.fem.edge_gaps import edge_gap_terms, holds_along_edges
from rmesh_nlp.fem.element import PointValues
from rmesh_nlp.fem.fields import ElementTerm, Field, Index, constant_field
from rmesh_nlp.problem import ContactProblem, Obstacle, Place, at, signed_areas

FRICTION_DEGREE = 31
"""Degree of the rule for the integral of the friction bound: exact to 1e-6 for four waves within an edge."""


def friction_energy(obstacle: Obstacle) -> tuple[ca.Function, PointValues | None]:
    """``(X_e, s_e[, g at the points]) -> (energy, empty)`` on one contact edge.

    The integral of g times the interpolant of the slip magnitudes s_i, which stand for |u_t,i|: by convexity
    it is at least the integral of g |u_t|. With a constant bound it is |e| g (s_1 + s_2) / 2, the
    trapezoidal rule of (5.9). The bound of slip at a node is so the integral of g times its hat function, and
    moves with the nodes.
    """
    X, s = ca.SX.sym("X", 2, 2), ca.SX.sym("s", 2)
    columns, length = [ca.vec(X), s], ca.norm_2(X[:, 1] - X[:, 0])
    if not callable(obstacle.friction):
        energy = length * obstacle.friction * (s[0] + s[1]) / 2
        return ca.Function("friction_energy", columns, [energy, ca.SX(0, 1)]), None
    points, weights = get_quadrature_line(FRICTION_DEGREE)
    shares = np.vstack([1 - points.ravel(), points.ravel()])
    bound = ca.SX.sym("g", weights.size)
    energy = length * ca.dot(bound, ca.vec(s.T @ ca.DM(shares * weights)))
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    value = ca.densify(ca.SX(at(obstacle.friction, x, y)))
    return (
        ca.Function("friction_energy", [*columns, bound], [energy, ca.SX(0, 1)]),
        PointValues(
            ca.Function("points", columns, [X @ ca.DM(shares)]), ca.Function("bound", [x, y], [value])
        ),
    )


def gap_function(obstacle: Obstacle, components: int) -> ca.Function:
    """``(X_i, u_i) -> (0, gap)`` of one contact node: normal(X) . u + distance(X)."""
    X, u = ca.SX.sym("X", 2), ca.SX.sym("u", components)
    gap = ca.dot(obstacle.direction(X[0], X[1]), u) + obstacle.distance(X[0], X[1])
    return ca.Function("gap", [X, u], [0, gap])


def contact_edges(problem: ContactProblem, obstacle: Obstacle | None = None) -> Index:
    """(2, edges) node numbers of one contact boundary, or of all; none for an obstacle in the interior."""
    chosen = problem.obstacles if obstacle is None else (obstacle,)
    names = [part.boundary for part in chosen if not isinstance(part.boundary, Place)]
    facets = [np.zeros(0, np.int64), *(np.asarray(problem.mesh.boundaries[name]) for name in names)]
    return np.asarray(problem.mesh.facets[:, np.concatenate(facets)], dtype=np.int64)


def nodal_weights(problem: ContactProblem, nodes: Array) -> Array:
    """omega_i of (5.9): half the length of the contact edges at each contact node.

    For an obstacle in the interior: a third of the area of the elements at the node.
    """
    weights: list[Array] = [np.zeros(0)]
    for part in problem.contact_sets:
        if part.obstacle.boundary is Place.INTERIOR:
            areas = np.tile(signed_areas(nodes, problem.triangles) / 3, 3)
            weight = np.bincount(problem.triangles.ravel(), areas, nodes.shape[1])
        else:
            edges = contact_edges(problem, part.obstacle)
            length = np.linalg.norm(nodes[:, edges[1]] - nodes[:, edges[0]], axis=0)
            weight = np.bincount(edges.ravel(), np.tile(length / 2, 2), nodes.shape[1])
        weights.append(np.asarray(weight[part.nodes], dtype=float))
    return np.concatenate(weights)


def slip_function(obstacle: Obstacle) -> ca.Function:
    """``(X_i, u_i, s_i) -> (0, (s - u_t, s + u_t))`` of one contact node."""
    X, u, s = ca.SX.sym("X", 2), ca.SX.sym("u", 2), ca.SX.sym("s")
    slip = ca.dot(obstacle.tangential(X[0], X[1]), u)
    return ca.Function("slip", [X, u, s], [0, ca.vertcat(s - slip, s + slip)])


def gap_terms(problem: ContactProblem) -> list[ElementTerm]:
    """One constraint row per contact node and obstacle: its gap, of positions and displacement."""
    terms: list[ElementTerm] = []
    for part in problem.contact_sets:
        if holds_along_edges(problem, part.obstacle):
            terms += edge_gap_terms(problem, part)
        else:
            at = part.nodes[None]
            terms.append(
                ElementTerm(gap_function(part.obstacle, problem.components), (at, at), part.rows[None])
            )
    return terms


def friction_terms(problem: ContactProblem) -> list[ElementTerm]:
    """Friction energy of positions and slip magnitudes (obstacles, nodes)."""
    terms = []
    for part in problem.contact_sets:
        if not part.obstacle.frictional:
            continue
        nodes: tuple[Index | None, ...]
        for number, edges in problem.edges_by_curve(str(part.obstacle.boundary)):
            if number < 0:
                function, at_points = friction_energy(part.obstacle)
                nodes, arc = (edges, edges), None
            else:
                bound = part.obstacle.friction
                function = arcs.friction_energy(bound, problem.curves[number], FRICTION_DEGREE)
                nodes, arc, at_points = (None, edges), (number, edges), None
            terms.append(ElementTerm(function, nodes, component=part.number, at_points=at_points, arc=arc))
    return terms


def slip_terms(problem: ContactProblem) -> list[ElementTerm]:
    """Rows ``s - u_t >= 0`` of all contact nodes with friction, then ``s + u_t >= 0``.

    Of positions, displacement and slip magnitudes (obstacles, nodes).
    """
    terms, first, n_s = [], 0, problem.friction_rows.size
    for part in problem.contact_sets:
        if part.obstacle.frictional:
            nodes = part.nodes[None, :]
            rows = first + np.arange(nodes.size) + np.array([[0], [n_s]])
            terms.append(ElementTerm(slip_function(part.obstacle), (nodes,) * 3, rows, part.number))
            first += nodes.size
    return terms


def gap_field(problem: ContactProblem) -> Field:
    """One unknown per gap, numbered from zero, as a field (obstacles, nodes); zero elsewhere."""
    field = _nothing(problem)
    for part in problem.contact_sets:
        field.index[part.number, part.nodes] = part.rows
    return field


def slip_field(problem: ContactProblem) -> Field:
    """One unknown per gap with friction, numbered from zero, as a field (obstacles, nodes)."""
    field, first = _nothing(problem), 0
    for part in problem.contact_sets:
        if part.obstacle.frictional:
            field.index[part.number, part.nodes] = first + np.arange(part.nodes.size)
            first += part.nodes.size
    return field


def _nothing(problem: ContactProblem) -> Field:
    return constant_field(np.zeros((max(len(problem.obstacles), 1), problem.mesh.p.shape[1])))
