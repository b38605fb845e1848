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
At order 2 the interpolant is a parabola, and the middle of an edge is a node; over an obstacle in the
interior heights are taken inside of triangles.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.bernstein import SIDES, functions, size, to_coefficients
from rmesh_nlp.fem.cells import ArcPoints, kind_of
from rmesh_nlp.fem.fields import ElementTerm
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import OPEN
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.design import at_design

SAMPLES = 16
"""Parts of an edge; heights are taken between them."""

INTERIOR_SAMPLES, INSIDE = 6, 4 / 3
"""Parts of an edge of an interior contact set, and the factor of its heights: inside a triangle a paraboloid
rises above its interpolant by ``k h^2 / 6``, on an edge by ``k h^2 / 8``. What is narrower is left to the
assessment."""

TRIANGLE_SAMPLES = 4
"""Parts of the sides of a triangle of order 2, inside of which heights are taken too."""

POWER = 12
"""The p of the norm."""

TINY = 1e-13
"""A height, in units of the largest distance on the given mesh, that is none: below it the norm is smooth."""

SMOOTH = {1: 0.0, 2: 0.1}
"""Least height by the order, as a part of the largest one on the given mesh. Of order 2 heights follow the
third derivative of the foundation. Minimisers are where that changes its sign, and there the norm has a kink
without a least height: 1,520 iterations of ``joint`` on a membrane over a bump, with it 136."""

STRAIGHT = 1e-9
"""Height of a foundation over its largest distance up to which it is rounding."""


def with_edge_gaps(problem: ContactProblem) -> ContactProblem:
    """The problem with gaps that hold along edges where a foundation rises between nodes; itself if none."""
    first = problem.at_design()  # foundations that depend on a design: as they are at the start
    body = Body(first, problem.mesh.p)
    chosen = tuple(
        replace(obstacle, gap="edge") if obstacle.gap != "edge" and _rises(body, at_start) else obstacle
        for obstacle, at_start in zip(problem.obstacles, first.obstacles, strict=True)
    )
    return problem if chosen == problem.obstacles else replace(problem, obstacle=chosen)


def _rises(body: Body, obstacle: Obstacle) -> bool:
    height, distance = _largest(body, obstacle)
    return height > STRAIGHT * distance


def _largest(body: Body, obstacle: Obstacle) -> tuple[float, float]:
    """The largest height of a foundation above the interpolant on an edge, and its largest distance."""
    edges = body.edges_of(obstacle)
    rows = np.arange(edges.size)
    s, order = np.arange(SAMPLES + 1) / SAMPLES, body.problem.order
    where = edges.at(rows, np.broadcast_to(s, (rows.size, s.size)))[0]
    distance = obstacle.distances(where.reshape(2, -1)).reshape(where.shape[1:])
    at_nodes = distance[:, [0, SAMPLES, SAMPLES // 2][: size(order, 2)]]
    shares = functions(order, np.stack([1 - s, s]))
    height = at_nodes @ to_coefficients(order, 2).T @ shares - distance
    return float(np.max(height, initial=0.0)), float(np.max(np.abs(distance), initial=0.0))


def holds_along_edges(problem: ContactProblem, obstacle: Obstacle) -> bool:
    """Whether gaps of an obstacle hold along edges: where that is asked for, and where the body is curved."""
    if obstacle.gap == "edge" or isinstance(obstacle.boundary, Place):
        return obstacle.gap == "edge"
    return any(number >= 0 for number, _ in problem.edges_by_curve(obstacle.boundary))


def edge_gap_terms(space: DisplacementSpace, part: ContactSet) -> Iterator[ElementTerm]:
    """Gaps of one of the space's contact sets that hold along edges, of positions and displacement."""
    problem = space.problem
    at_start = at_design(part.obstacle, problem.start)
    where = space.points(problem.mesh.p)[:, part.nodes]
    unit = float(np.max(np.abs(at_start.distances(where)), initial=0.0)) or 1.0
    highest, _ = _largest(Body(problem.at_design(), problem.mesh.p), at_start)
    tiny = max(TINY, SMOOTH[space.order] * highest / unit)
    free = np.zeros(space.n_nodes)
    free[part.nodes] = 1.0
    given = _given_along(space, at_start)
    inside = space.order == 2 and part.obstacle.boundary is Place.INTERIOR
    for patch in _fans(space, part) if inside else patches(space, part):
        number = max(patch.sides)
        curve = problem.curves[number] if number >= 0 else None
        function, at_points = _gap_function(part.obstacle, patch, curve, unit, tiny, space)
        along = np.vstack([space.nodes_of(patch.vertices[list(cell)]) for cell in patch.cells])
        yield ElementTerm(
            function,
            (patch.vertices, part.nodes[None, patch.rows]),
            part.rows[patch.rows][None],
            at_points=at_points,
            arc=None if curve is None else (number, patch.vertices),
            constants=np.vstack([free[along], given[along]]),
        )


class Patch(NamedTuple):
    """Contact nodes with edges or triangles alike.

    ``at_edge`` tells whether they are at edges, ``rows`` which of the contact set they are. ``cells`` are the
    edges or triangles, each by the numbers of its vertices in the patch, those that carry the node first, and
    ``sides`` the curve that each is on. ``vertices`` is (vertices of the patch, nodes).
    """

    at_edge: bool
    cells: tuple[tuple[int, ...], ...]
    sides: tuple[int, ...]
    rows: Index
    vertices: Index


def patches(space: DisplacementSpace, part: ContactSet) -> Iterator[Patch]:
    """Contact nodes on a boundary with the edges of it beside them, of nodes at edges their own.

    A node between two curves counts one edge as an arc, the other as a chord.
    """
    problem = space.problem
    edges = Body(problem, problem.mesh.p).edges_of(part.obstacle)
    curve_of = problem.curve_of_facet[edges.facets]
    around: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for a, b, curve in np.vstack([edges.ends, curve_of]).T.tolist():
        around[a].append((curve, b))
        around[b].append((curve, a))
    curves = {(min(a, b), max(a, b)): c for a, b, c in np.vstack([edges.ends, curve_of]).T.tolist()}
    groups: dict[tuple[bool, tuple[int, ...]], list[tuple[int, list[int]]]] = defaultdict(list)
    for which, vertices, _ in space.kinds(part.nodes):
        for row, ends in zip(which.tolist(), vertices.T.tolist(), strict=True):
            if len(ends) == 2:
                groups[True, (curves[min(ends), max(ends)],)].append((row, ends))
            else:
                beside = around[ends[0]]
                patch = [*ends, *(other for _, other in beside)]
                groups[False, tuple(curve for curve, _ in beside)].append((row, patch))
    for (at_edge, sides), members in groups.items():
        rows, patches = zip(*members, strict=True)
        cells = tuple((0, i) for i in range(1, 1 + len(sides)))
        yield Patch(at_edge, cells, sides, np.array(rows), np.array(patches, dtype=np.int64).T)


def _fans(space: DisplacementSpace, part: ContactSet) -> Iterator[Patch]:
    """Contact nodes with the triangles around them, all taken as straight.

    At order 2 a foundation may rise above the interpolant inside of a triangle and on none of its edges.
    """
    others: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for triangle in space.problem.triangles.T.tolist():
        for a, b, c in (triangle, triangle[1:] + triangle[:1], triangle[2:] + triangle[:2]):
            others[a,] += [b, c]
            others[min(a, b), max(a, b)].append(c)
    groups: dict[tuple[bool, int], list[tuple[int, list[int]]]] = defaultdict(list)
    for which, vertices, _ in space.kinds(part.nodes):
        for row, ends in zip(which.tolist(), vertices.T.tolist(), strict=True):
            around = others[tuple(sorted(ends))]
            count = len(around) if len(ends) == 2 else len(around) // 2
            groups[len(ends) == 2, count].append((row, [*ends, *around]))
    for (at_edge, count), members in groups.items():
        rows, patches = zip(*members, strict=True)
        cells = tuple((0, 1, 2 + i) if at_edge else (0, 1 + 2 * i, 2 + 2 * i) for i in range(count))
        yield Patch(at_edge, cells, (-1,) * count, np.array(rows), np.array(patches, dtype=np.int64).T)


def _given_along(space: DisplacementSpace, obstacle: Obstacle) -> Array:
    """(nodes,) the displacement along the normal that is given; zero where none is."""
    held, value = space.given()
    normals = obstacle.normals(space.points(space.problem.mesh.p))
    return np.asarray(np.sum(normals * np.where(held, value, 0.0), axis=0))


def _gap_function(
    obstacle: Obstacle, patch: Patch, curve: Curve | None, unit: float, tiny: float, space: DisplacementSpace
) -> tuple[ca.Function, PointValues | None]:
    """``([parameters,] patch, u_i, (free, given)[, distances]) -> (0, gap)`` of a contact node.

    ``free`` is 1 for a node of a cell that keeps off too, 0 for one that is held, whose displacement is
    ``given``: cell by cell, in each those at its vertices and then those at its edges. ``tiny`` is the least
    height in units of ``unit``. Edges on the last one of the patch's curves are arcs of ``curve``.
    """
    order, cells, interior = space.order, patch.cells, obstacle.boundary is Place.INTERIOR
    kind = ca.SX if curve is None else kind_of(curve)
    n, corners, vertices = len(cells), len(cells[0]), len(patch.vertices)
    nodes, shares = size(order, corners), _samples(corners, interior)
    X, t, u = kind.sym("X", 2, vertices), kind.sym("t", vertices), kind.sym("u", space.problem.components)
    constants = kind.sym("constants", 2 * nodes * n)
    free, given = (ca.reshape(part, nodes, n) for part in ca.vertsplit(constants, nodes * n))
    # distances at vertices, and at the samples of each cell
    firsts = [0, *(vertices + i * shares.shape[1] for i in range(n + 1))]
    distance = kind.sym("distance", firsts[-1])
    at_vertices, *samples = ca.vertsplit(distance, firsts)
    middles = [np.flatnonzero(np.isclose(shares[list(side)], 0.5).all(axis=0))[0] for side in SIDES[corners]]
    shapes, power, own = ca.DM(functions(order, shares)).T, kind(tiny**POWER), at_vertices[0]
    for i, (cell, along) in enumerate(zip(cells, samples, strict=True)):
        at_nodes = ca.vertcat(*(at_vertices[k] for k in cell), *(along[k] for k in middles))[:nodes]
        D = ca.DM(to_coefficients(order, corners)) @ at_nodes
        if patch.at_edge:
            own = D[corners]
        height = shapes @ (free[:, i] * D - (1 - free[:, i]) * given[:, i]) - along
        weight = shapes @ free[:, i]
        if corners == 3:  # where only nodes that are held have a share no other can keep off
            weight = ca.if_else(weight > 0, weight, np.inf)
        power += ca.sum1(ca.fmax(height / (unit * weight), 0) ** POWER)
    off = unit * power ** (1 / POWER) * (INSIDE if interior else 1.0)
    x, y = ca.vertsplit((X[:, 0] + X[:, 1]) / 2 if patch.at_edge else X[:, 0])
    gap = ca.dot(obstacle.direction(x, y), u) + own - off
    places = [np.eye(vertices)[:, list(cell)] @ shares for cell in cells]
    if curve is None:
        at_points = PointValues.of(obstacle.distance, np.hstack([np.eye(vertices), *places]))
        return ca.Function("edge_gap", [ca.vec(X), u, constants, distance], [0, gap], OPEN), at_points
    points = ca.horzsplit(X)  # those on the curve are no mean of vertices
    for cell, side, place in zip(cells, patch.sides, places, strict=True):
        if side == max(patch.sides):
            arc = ArcPoints(curve, ca.vertcat(*(t[i] for i in cell)), kind)
            points += [arc.point(s) for s in shares[1]]
        else:
            points += ca.horzsplit(X @ ca.DM(place))
    values = ca.vertcat(*(obstacle.distance(*ca.vertsplit(point)) for point in points))
    gap = ca.substitute(gap, distance, values)
    return ca.Function("edge_gap", [t, ca.vec(X), u, constants], [0, gap], OPEN), None


def _samples(corners: int, interior: bool) -> Array:
    """(corners, samples) barycentric coordinates on an edge or a triangle, the corners left out."""
    if corners == 2:
        s = np.arange(1, parts := INTERIOR_SAMPLES if interior else SAMPLES) / parts
        return np.stack([1 - s, s])
    whole = np.arange(TRIANGLE_SAMPLES + 1)
    lattice = np.array([(i, j, TRIANGLE_SAMPLES - i - j) for i in whole for j in whole[: whole.size - i]]).T
    return np.asarray(lattice[:, lattice.max(axis=0) < TRIANGLE_SAMPLES] / TRIANGLE_SAMPLES)
