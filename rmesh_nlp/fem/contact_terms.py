"""Contact as element functions: gaps, friction, slips, and where they are on a mesh.

Fields of slips and contact forces have one component per obstacle, for a node may meet two of them.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.edge_gaps import edge_gap_function, edges_of
from rmesh_nlp.fem.fields import ElementTerm, Field, Index, constant_field
from rmesh_nlp.problem import ContactProblem, Obstacle, Place, at, signed_areas
from rmesh_nlp.problem.statement import ContactSet


def friction_energy(obstacle: Obstacle) -> ca.Function:
    """``(X_e, s_e) -> (energy, empty)`` on one contact edge.

    |e| / 2 (g_1 s_1 + g_2 s_2), where s_i stands for |u_t,i|: the trapezoidal rule of (5.9),
    whose weights omega_i move with the nodes.
    """
    X, s = ca.SX.sym("X", 2, 2), ca.SX.sym("s", 2)
    length = ca.norm_2(X[:, 1] - X[:, 0])
    slip = sum(at(obstacle.friction, X[0, i], X[1, i]) * s[i] for i in range(2))
    return ca.Function("friction_energy", [ca.vec(X), s], [length * slip / 2, ca.SX(0, 1)])


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
    terms = []
    for part in problem.contact_sets:
        beside = _neighbours(problem, part) if part.obstacle.gap == "edge" else [()] * part.nodes.size
        for sides in sorted({len(nodes) for nodes in beside}):
            chosen = np.array([i for i, nodes in enumerate(beside) if len(nodes) == sides])
            function = gap_function(part.obstacle, problem.components)
            at = part.nodes[None, chosen]
            patch = at
            if sides:
                function = edge_gap_function(part.obstacle, problem.components, sides)
                patch = np.vstack([at, np.array([beside[i] for i in chosen]).T])
            terms.append(ElementTerm(function, (patch, at), part.rows[None, chosen]))
    return terms


def _neighbours(problem: ContactProblem, part: ContactSet) -> list[tuple[int, ...]]:
    """For each node of a contact set its neighbours along the contact boundary, or in the interior all."""
    beside: dict[int, list[int]] = {int(node): [] for node in part.nodes}
    for a, b in edges_of(problem, part.obstacle).T.tolist():
        for one, other in ((a, b), (b, a)):
            if one in beside:
                beside[one].append(other)
    return [tuple(beside[int(node)]) for node in part.nodes]


def friction_terms(problem: ContactProblem) -> list[ElementTerm]:
    """Friction energy of positions and slip magnitudes (obstacles, nodes)."""
    return [
        ElementTerm(
            friction_energy(part.obstacle),
            (contact_edges(problem, part.obstacle),) * 2,
            component=part.number,
        )
        for part in problem.contact_sets
        if part.obstacle.frictional
    ]


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
