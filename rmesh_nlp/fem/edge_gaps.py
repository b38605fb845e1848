"""Gaps that hold along contact edges, and not at their nodes only.

Between nodes a convex foundation passes into an edge of length h by ``k h^2 / 8`` at a curvature k of
foundation and body, and relocation could gain by longer edges. Here every node keeps off by as much as its
edges need; then the admissible displacements of the mesh are admissible for the continuous problem.

On an edge the foundation rises above the interpolant of its distances at the nodes by
``a = I d - d``, on the true curve of the body where it has one. A node keeps off by

    r = ( sum_k max(a_k, 0)^p )^(1/p)

over sample points on the edges beside it: at least the largest of these heights, and smooth in the positions.
For a parabola it is 1.12 times the height, with an edge like it on the other side 1.19 times. Beside a node
that is held with a gap G the height that counts is ``(a - (1 - s) G) / s``, s the share of the free node.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.arcs import Arc, kind_of
from rmesh_nlp.fem.element import PointValues, point_values
from rmesh_nlp.fem.fields import ElementTerm
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet

SAMPLES = 16
"""Parts of an edge; heights are taken between them."""

INTERIOR_SAMPLES, INSIDE = 6, 4 / 3
"""Parts of an edge of an interior contact set, and the factor of its heights: inside a triangle a paraboloid
rises above its interpolant by ``k h^2 / 6``, on an edge by ``k h^2 / 8``. What is narrower is left to the
assessment."""

POWER = 12
"""The p of the norm."""

TINY = 1e-13
"""A height, in units of the largest distance on the given mesh, that is none: below it the norm is smooth."""

STRAIGHT = 1e-9
"""Height of a foundation over its largest distance up to which it is rounding."""


def with_edge_gaps(problem: ContactProblem) -> ContactProblem:
    """The problem with gaps that hold along edges where a foundation rises between nodes; itself if none."""
    body = Body(problem, problem.mesh.p)
    chosen = tuple(
        replace(obstacle, gap="edge") if obstacle.gap != "edge" and _rises(body, obstacle) else obstacle
        for obstacle in problem.obstacles
    )
    return problem if chosen == problem.obstacles else replace(problem, obstacle=chosen)


def _rises(body: Body, obstacle: Obstacle) -> bool:
    edges = body.edges_of(obstacle)
    rows = np.arange(edges.size)
    s = np.broadcast_to(np.arange(SAMPLES + 1) / SAMPLES, (rows.size, SAMPLES + 1))
    distance = obstacle.distances(edges.at(rows, s)[0].reshape(2, -1)).reshape(s.shape)
    height = distance[:, :1] * (1 - s) + distance[:, -1:] * s - distance
    size = float(np.max(np.abs(distance), initial=0.0))
    return bool(np.max(height, initial=0.0) > STRAIGHT * size)


def holds_along_edges(problem: ContactProblem, obstacle: Obstacle) -> bool:
    """Whether gaps of an obstacle hold along edges: where that is asked for, and where the body is curved."""
    if obstacle.gap == "edge" or isinstance(obstacle.boundary, Place):
        return obstacle.gap == "edge"
    return any(number >= 0 for number, _ in problem.edges_by_curve(obstacle.boundary))


def edge_gap_terms(space: DisplacementSpace, part: ContactSet) -> Iterator[ElementTerm]:
    """Gaps of one of the problem's contact sets that hold along edges, of positions and displacement."""
    problem = space.problem
    unit = float(np.max(np.abs(part.obstacle.distances(problem.mesh.p[:, part.nodes])), initial=0.0)) or 1.0
    free = np.zeros(problem.mesh.p.shape[1])
    free[part.nodes] = 1.0
    given = _given_along(problem, part.obstacle)
    for sides, rows, patch in _patches(problem, part):
        number = max(sides)
        curve = problem.curves[number] if number >= 0 else None
        on_curve = tuple(curve is not None and side == number for side in sides)
        function, at_points = _gap_function(part.obstacle, problem.components, on_curve, curve, unit)
        yield ElementTerm(
            function,
            (patch, space.nodes_of(patch[:1])),
            part.rows[rows][None],
            at_points=at_points,
            arc=None if curve is None else (number, patch),
            constants=np.vstack([free[patch[1:]], given[patch[1:]]]),
        )


def _patches(problem: ContactProblem, part: ContactSet) -> Iterator[tuple[tuple[int, ...], Index, Index]]:
    """Contact nodes with edges alike: the curve of each edge, rows of the nodes, nodes (1 + neighbours, n).

    A node between two curves counts one edge as an arc, the other as a chord.
    """
    body = Body(problem, problem.mesh.p)
    edges = body.edges_of(part.obstacle)
    around: dict[int, list[tuple[int, int]]] = {int(node): [] for node in part.nodes}
    for a, b, curve in np.vstack([edges.ends, problem.curve_of_facet[edges.facets]]).T.tolist():
        for node, other in ((a, b), (b, a)):
            if node in around:
                around[node].append((curve, other))
    groups: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for row, node in enumerate(part.nodes):
        groups[tuple(curve for curve, _ in around[int(node)])].append(row)
    for sides, rows in groups.items():
        patch = [[int(part.nodes[r]), *(other for _, other in around[int(part.nodes[r])])] for r in rows]
        yield sides, np.array(rows), np.array(patch, dtype=np.int64).T


def _given_along(problem: ContactProblem, obstacle: Obstacle) -> Array:
    """(nodes,) the displacement along the normal that is given; zero where none is."""
    held, value = problem.held()
    return np.asarray(np.sum(obstacle.normals(problem.mesh.p) * np.where(held, value, 0.0), axis=0))


def _gap_function(
    obstacle: Obstacle, components: int, on_curve: tuple[bool, ...], curve: Curve | None, unit: float
) -> tuple[ca.Function, PointValues]:
    """``([parameters,] patch, u_i, (free, given), distances) -> (0, gap)`` of a node and its neighbours.

    ``free`` is 1 for a neighbour that keeps off too, 0 for one that is held, whose displacement is ``given``.
    """
    kind, beside = ca.SX if curve is None else kind_of(curve), len(on_curve)
    X, t = kind.sym("X", 2, 1 + beside), kind.sym("t", 1 + beside)
    u, constants = kind.sym("u", components), kind.sym("constants", 2 * beside)
    free, given = constants[:beside], constants[beside:]
    points = ca.horzsplit(X)
    interior = obstacle.boundary is Place.INTERIOR
    samples = INTERIOR_SAMPLES if interior else SAMPLES
    heights = list(product(range(1, 1 + beside), np.arange(1, samples) / samples))  # neighbours and shares
    for i, s in heights:
        arc = Arc(curve, ca.vertcat(t[0], t[i]), kind) if curve is not None and on_curve[i - 1] else None
        points.append((1 - s) * X[:, 0] + s * X[:, i] if arc is None else arc.point(s))
    distance = kind.sym("distance", len(points))
    power = kind(TINY**POWER)
    for number, (i, s) in enumerate(heights, 1 + beside):
        height = (1 - s) * distance[0] - distance[number]
        height += s * (free[i - 1] * distance[i] - (1 - free[i - 1]) * given[i - 1])
        power += ca.fmax(height / (unit * (1 - s + s * free[i - 1])), 0) ** POWER
    off = unit * power ** (1 / POWER) * (INSIDE if interior else 1.0)
    gap = ca.dot(obstacle.direction(X[0, 0], X[1, 0]), u) + distance[0] - off
    columns = [*([] if curve is None else [t]), ca.vec(X), u, constants]
    at_points = point_values(columns, ca.horzcat(*points), obstacle.distance)
    return ca.Function("edge_gap", [*columns, distance], [0, gap]), at_points
