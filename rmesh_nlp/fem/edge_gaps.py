"""Gaps that hold along contact edges, and not at their nodes only.

Between nodes a convex foundation passes into an edge of length h by ``k h^2 / 8`` at a curvature k of
foundation and body, and relocation could gain by longer edges. Here every node keeps off by as much as its
edges need; then the admissible displacements of the mesh are admissible for the continuous problem, if the
normal of the foundation is the same along an edge. Where it turns by ``n_2 - n_1`` the middle of an edge of
order 1 may enter by ``(n_2 - n_1) . (u_1 - u_2) / 4``, which the assessment counts. At order 2 a gap
is exact in the middle of its edge (:func:`directions`); what is left is of the fourth power of that angle.

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
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Expression, Index, kind_of, largest_side, magnitude
from rmesh_nlp.fem.bernstein import SIDES, functions, size, to_coefficients
from rmesh_nlp.fem.cells import ArcPoints
from rmesh_nlp.fem.fields import NONE, ElementGroup, Fields, constant_field
from rmesh_nlp.fem.space import DisplacementSpace
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
"""A height, in units of the largest distance on the given mesh, that is none: below it the norm is smooth.
Second derivatives of the norm overflow for a much smaller one."""

SMOOTH = {1: 0.0, 2: 0.1}
"""Least height by the order, as a part of the largest one on the given mesh. Of order 2 heights follow the
third derivative of the foundation. Minimisers are where that changes its sign, and there the norm has a kink
without a least height: 1,520 iterations of ``joint`` on a membrane over a bump, with it 136."""


def with_edge_gaps(problem: ContactProblem) -> ContactProblem:
    """The problem with gaps that hold along edges where a foundation rises between nodes; itself if none."""
    first = problem.at_design()  # foundations that depend on a design: as they are at the start
    body = Body(first, problem.mesh.p)
    chosen = tuple(
        replace(obstacle, gap="edge") if obstacle.gap != "edge" and _rises(body, at_start) else obstacle
        for obstacle, at_start in zip(problem.obstacles, first.obstacles, strict=True)
    )
    return problem if chosen == problem.obstacles else replace(problem, obstacle=chosen)


def with_held_arcs(problem: ContactProblem) -> ContactProblem:
    """The problem with contact nodes held on arcs that :func:`conform`; itself if they are or none does.

    How far sides pass into each other between these nodes depends on how slips differ along the arc.
    """
    first, motion = problem.at_design(), problem.motion
    arcs = [str(part.boundary) for part in first.obstacles if first.components == 2 and conform(first, part)]
    more = tuple(name for name in arcs if name not in motion.pinned)
    return replace(problem, motion=replace(motion, pinned=motion.pinned + more)) if more else problem


def conform(problem: ContactProblem, obstacle: Obstacle) -> bool:
    """Whether arcs of the body bend at least four times as much as the gap along them."""
    edges = Body(problem, problem.mesh.p).edges_of(obstacle)
    points = edges.at(np.arange(edges.size), np.tile([0, 0.5, 1], (edges.size, 1)))[0]
    arc, gap = (magnitude(np.diff(part, 2)) for part in (points, obstacle.distances(points)))
    return arc > 4 * gap + ROUNDING * magnitude(points)


def _rises(body: Body, obstacle: Obstacle) -> bool:
    height, distance = _largest(body, obstacle)
    return height > ROUNDING * max(distance, largest_side(body.nodes))


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
    return float(np.max(height, initial=0.0)), magnitude(distance)


def holds_along_edges(problem: ContactProblem, obstacle: Obstacle) -> bool:
    """Whether gaps of an obstacle hold along edges: where that is asked for, and where the body is curved."""
    if obstacle.gap == "edge" or obstacle.other or isinstance(obstacle.boundary, Place):
        return obstacle.gap == "edge"
    return any(number >= 0 for number, _ in problem.edges_by_curve(obstacle.boundary))


def edge_gaps(on: Fields, part: ContactSet, rows: Index) -> Iterator[ElementGroup]:
    """Gaps of one of the space's contact sets that hold along edges; ``rows`` are those of its nodes."""
    space, problem = on.space, on.problem
    at_start, moved = at_design(part.obstacle, problem.start).unmoved
    where = space.points(problem.mesh.p)[:, part.nodes]
    unit = magnitude(at_start.distances(where)) or 1.0
    highest, _ = _largest(Body(problem.at_design(), problem.mesh.p), at_start)
    least = max(TINY, SMOOTH[space.order] * highest / unit)
    free = np.zeros(space.n_nodes)
    free[part.nodes] = 1.0
    given = _given_along(space, part, at_start, np.array(moved))
    for patch in patches(space, part):
        along = np.vstack([space.nodes_of(patch.vertices[list(cell)]) for cell in patch.cells])
        local = [
            on.positions.at(patch.vertices),
            on.displacement.at(space.carriers(part, patch.rows, patch.vertices[: 1 + patch.at_edge])),
            constant_field(np.vstack([free[along], given[along]])),
        ]
        number, curve = max(patch.sides), None
        if number >= 0:
            curve = problem.curves[number]
            local.append(on.parameters(number, patch.vertices))
        function = _gap_function(part, patch, curve, unit, least, space)
        yield on.group(function, local, rows[None, patch.rows])


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
    """Contact nodes with the cells beside them: edges, or at order 2 in the interior triangles.

    At order 2 a foundation may rise above the interpolant inside of a triangle and on none of its edges. A
    node between two curves counts one edge as an arc, the other as a chord; triangles are taken as straight.
    """
    problem = space.problem
    if space.order == 2 and part.obstacle.boundary is Place.INTERIOR:
        cells, curves = problem.triangles, np.full(problem.mesh.nelements, NONE)
    else:
        edges = Body(problem, problem.mesh.p).edges_of(part.obstacle)
        cells, curves = edges.ends, problem.curve_of_facet[edges.facets]
    around: dict[tuple[int, ...], list[tuple[int, list[int]]]] = defaultdict(list)
    for *vertices, curve in np.vstack([cells, curves]).T.tolist():
        for size_of_own in range(1, 1 + space.order):
            for own in combinations(sorted(vertices), size_of_own):
                around[own].append((curve, [vertex for vertex in vertices if vertex not in own]))
    groups: dict[tuple[int, tuple[int, ...]], list[tuple[int, list[int]]]] = defaultdict(list)
    for which, carriers, _ in space.kinds(part.nodes):
        for row, own in zip(which.tolist(), carriers.T.tolist(), strict=True):
            beside = around[tuple(sorted(own))]
            patch = [*own, *(vertex for _, rest in beside for vertex in rest)]
            groups[len(own), tuple(curve for curve, _ in beside)].append((row, patch))
    for (n, sides), members in groups.items():
        rows, vertices = zip(*members, strict=True)
        rest = np.arange(n, len(vertices[0])).reshape(len(sides), len(cells) - n).tolist()
        of_patch = tuple((*range(n), *numbers) for numbers in rest)
        yield Patch(n == 2, of_patch, sides, np.array(rows), np.array(vertices, dtype=np.int64).T)


def _given_along(space: DisplacementSpace, part: ContactSet, obstacle: Obstacle, moved: Array) -> Array:
    """(nodes,) the displacement along the normal that is given, or zero, less that of what is met."""
    held, value = space.given()
    normals = obstacle.normals(space.points(space.problem.mesh.p))
    return np.sum(normals * (part.relative(np.where(held, value, 0.0))[:, : space.n_nodes] - moved), axis=0)


def _gap_function(
    part: ContactSet, patch: Patch, curve: Curve | None, unit: float, least: float, space: DisplacementSpace
) -> ca.Function:
    """``(patch, u, (free, given)[, parameters]) -> (0, gap)`` of a contact node.

    ``free`` is 1 for a node of a cell that keeps off too, 0 for one that is held, whose displacement is
    ``given``: cell by cell, in each those at its vertices and then those at its edges. ``least`` is the least
    height in units of ``unit``. Edges on the last one of the patch's curves are arcs of ``curve``.
    """
    (obstacle, moved), order, cells = part.obstacle.unmoved, space.order, patch.cells
    interior = obstacle.boundary is Place.INTERIOR
    kind = ca.SX if curve is None else kind_of(*curve.functions)
    n, corners, vertices = len(cells), len(cells[0]), len(patch.vertices)
    nodes, shares = size(order, corners), _samples(corners, interior)
    X, t = kind.sym("X", 2, vertices), kind.sym("t", vertices)
    own_shares = np.full(1 + patch.at_edge, 1 / (1 + patch.at_edge))
    normals = directions(obstacle, X[:, : own_shares.size], own_shares)
    u, met = displaced(normals, part.factors, kind)
    constants = kind.sym("constants", 2 * nodes * n)
    free, given = (ca.reshape(part, nodes, n) for part in ca.vertsplit(constants, nodes * n))

    def distances(points: Sequence[Expression]) -> list[Expression]:
        return [obstacle.distance(*ca.vertsplit(point)) for point in points]

    at_vertices = distances(ca.horzsplit(X))
    sides = SIDES[corners] if order == 2 else ()
    middles = [np.flatnonzero(np.isclose(shares[list(side)], 0.5).all(axis=0))[0] for side in sides]
    shapes, power, own = ca.DM(functions(order, shares)).T, kind(least**POWER), at_vertices[0]
    for i, (cell, side) in enumerate(zip(cells, patch.sides, strict=True)):
        if curve is not None and side == max(patch.sides):  # points of an arc are no mean of vertices
            arc = ArcPoints(curve, ca.vertcat(*(t[k] for k in cell)), kind)
            along = distances([arc.point(s) for s in shares[1]])
        else:
            along = distances(ca.horzsplit(X[:, list(cell)] @ ca.DM(shares)))
        at_nodes = ca.vertcat(*(at_vertices[k] for k in cell), *(along[k] for k in middles))
        D = ca.DM(to_coefficients(order, corners)) @ at_nodes
        if patch.at_edge:
            own = D[corners]
        height = shapes @ (free[:, i] * D - (1 - free[:, i]) * given[:, i]) - ca.vertcat(*along)
        weight = shapes @ free[:, i]
        if corners == 3:  # where only nodes that are held have a share no other can keep off
            weight = ca.if_else(weight > 0, weight, np.inf)
        power += ca.sum1(ca.fmax(height / (unit * weight), 0) ** POWER)
    off = unit * power ** (1 / POWER) * (INSIDE if interior else 1.0)
    gap = ca.dot(normals, met - ca.repmat(moved, 1, met.shape[1])) + own - off
    columns = [ca.vec(X), ca.vec(u), constants] + ([] if curve is None else [t])
    return ca.Function("edge_gap", columns, [0, gap], OPEN)


def directions(obstacle: Obstacle, X: Expression, shares: Array, *, along: bool = False) -> Expression:
    """(components, places) what the displacement at each place of a gap is multiplied with.

    ``X`` (2, n) are the vertices of its node, ``shares`` (n,) say where that is. At an edge the coefficient
    of the parabola through ``n . u`` at the ends a, b and the middle m is ``n_m . c + (n_m - n_a) . u_a / 2 +
    (n_m - n_b) . u_b / 2``, c that of the displacement. ``along``: with tangents, of the slip.
    """
    direction = obstacle.tangential if along else obstacle.direction
    own = direction(*ca.vertsplit(X @ ca.DM(shares)))
    if obstacle.level is None or shares.size == 1:
        return own
    return ca.horzcat(own, *((own - direction(*ca.vertsplit(end))) / 2 for end in ca.horzsplit(X)))


def displaced(directions: Expression, factors: Array, kind: Any = ca.SX) -> tuple[Expression, Expression]:
    """Displacements (components, nodes) of a gap's carriers, and (components, places) their sums."""
    components, places = directions.shape
    u = kind.sym("u", components, factors.size * places)
    return u, sum(factor * part for factor, part in zip(factors, ca.horzsplit(u, places), strict=True))


def _samples(corners: int, interior: bool) -> Array:
    """(corners, samples) barycentric coordinates on an edge or a triangle, the corners left out."""
    n = TRIANGLE_SAMPLES if corners == 3 else INTERIOR_SAMPLES if interior else SAMPLES
    lattice = [each for each in product(range(n), repeat=corners) if sum(each) == n]
    return np.array(lattice).T / n
