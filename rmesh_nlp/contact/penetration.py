"""Penetration between contact nodes: gaps are imposed at nodes, and foundations may pass in between."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import contact_edges
from rmesh_nlp.problem import ContactProblem, Obstacle, Place

_FRACTIONS = np.arange(1, 8) / 8
BETWEEN_EDGE = np.vstack([1 - _FRACTIONS, _FRACTIONS])
"""Barycentric coordinates (2, points) of the points on an edge where penetration is looked for."""

BETWEEN_TRIANGLE = np.array([[3, 3, 0, 2], [3, 0, 3, 2], [0, 3, 3, 2]]) / 6
"""The same in a triangle: the midpoints of its edges, and its centre."""


def penetration(problem: ContactProblem, nodes: Array, displacement: Array) -> float:
    """Largest negative gap at points between the contact nodes, as a positive length; 0 without."""
    deepest = 0.0
    for obstacle in problem.obstacles:
        depth, _ = penetrations(problem, obstacle, nodes, displacement)
        deepest = max(deepest, float(np.max(depth, initial=0.0)))
    return deepest


def penetrations(
    problem: ContactProblem, obstacle: Obstacle, nodes: Array, displacement: Array
) -> tuple[Array, Array]:
    """Deepest penetration of each contact edge, or triangle of an interior contact set, and its length.

    Returns
    -------
    depth, length : (cells,) arrays
        Depth >= 0 in units of the gap; the length of the edge, or of the first edge of the triangle.
    """
    if obstacle.boundary is Place.INTERIOR:
        cells, points = problem.triangles, BETWEEN_TRIANGLE
    else:
        cells, points = contact_edges(problem, obstacle), BETWEEN_EDGE
    length = np.linalg.norm(nodes[:, cells[1]] - nodes[:, cells[0]], axis=0)
    where = np.einsum("cve,vk->cek", nodes[:, cells], points).reshape(2, -1)
    u = np.einsum("cve,vk->cek", displacement[:, cells], points).reshape(displacement.shape[0], -1)
    gap = np.sum(obstacle.normals(where) * u, axis=0) + obstacle.distances(where)
    return np.maximum(0.0, -gap.reshape(cells.shape[1], -1)).max(axis=1, initial=0.0), length
