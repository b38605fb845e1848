"""Penetration between contact nodes: gaps are imposed at nodes, and foundations may pass in between."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import Obstacle, Place
from rmesh_nlp.problem.body import Body

_FRACTIONS = np.arange(33) / 32
ON_EDGE = np.vstack([1 - _FRACTIONS, _FRACTIONS])
"""Barycentric coordinates (2, points) of the points on an edge where penetration is looked for: also its
ends, where a node whose displacement is given may have moved into the foundation."""

ON_TRIANGLE = np.array([(i, j, 8 - i - j) for i in range(9) for j in range(9 - i)]).T / 8
"""The same in a triangle."""


def penetration(space: DisplacementSpace, nodes: Array, displacement: Array) -> float:
    """Largest negative gap on the contact edges or triangles, as a positive length; 0 without.

    ``nodes`` (2, vertices) are positions, ``displacement`` (components, nodes) coefficients.
    """
    body = Body(space.problem, nodes)
    depths = [penetrations(body, space, part, displacement)[0] for part in space.problem.obstacles]
    return max((float(np.max(depth, initial=0.0)) for depth in depths), default=0.0) + 0.0  # not -0


def penetrations(
    body: Body, space: DisplacementSpace, obstacle: Obstacle, displacement: Array
) -> tuple[Array, Array]:
    """(cells,) deepest penetration >= 0 of each contact edge, or triangle of an interior contact set.

    And the length of the edge, or of the first edge of the triangle.
    """
    if obstacle.boundary is Place.INTERIOR:
        cells, points = body.triangles, ON_TRIANGLE
        every = np.arange(cells.shape[1])
        where = body.points(every, np.broadcast_to(points[:, None], (3, every.size, points.shape[1])))[0]
    else:
        edges = body.edges_of(obstacle)
        cells, points = edges.ends, ON_EDGE
        where = edges.at(np.arange(edges.size), np.broadcast_to(points[1], (edges.size, points.shape[1])))[0]
    length = np.linalg.norm(body.nodes[:, cells[1]] - body.nodes[:, cells[0]], axis=0)
    u = np.einsum("cve,vk->cek", displacement[:, space.nodes_of(cells)], functions(space.order, points))
    gap = np.sum(obstacle.normals(where) * u, axis=0) + obstacle.distances(where)
    return np.maximum(0.0, -gap).max(axis=1, initial=0.0), length
