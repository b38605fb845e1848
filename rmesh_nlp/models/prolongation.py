"""Interpolation of a map of the domain from one mesh to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rmesh_nlp.discretisation import Discretisation
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.energy_program import Relocation
from rmesh_nlp.problem import signed_areas

CANDIDATES = 16
"""Elements with the nearest centres that are looked at first."""

OUTSIDE = -1e-9
"""Barycentric coordinate below which a point is outside an element."""

SMALL = 0.02
"""Area, in parts of the initial one, below which an interpolated element is mended, unless elements of the
coarse mesh are as small."""

MENDINGS = 40
"""Rounds of mending."""


def interpolated(nodes: Array, triangles: NDArray, values: Array, points: Array) -> Array:
    """Piecewise linear interpolation of nodal ``values`` (components, nodes) at ``points`` (2, points).

    A point outside the mesh (between a curve and its chord) has the value of the nearest place in the
    element that it is least outside of.
    """
    vertices, weights = located(nodes, triangles, points)
    return np.asarray(np.einsum("cvk,vk->ck", values[:, vertices], weights))


def located(nodes: Array, triangles: NDArray, points: Array) -> tuple[NDArray[np.int64], Array]:
    """Vertices (3, points) of the element around each point and its barycentric coordinates there."""
    corner = nodes[:, triangles]
    tree = cKDTree(corner.mean(axis=1).T)
    k = min(CANDIDATES, triangles.shape[1])
    _, near = tree.query(points.T, k=k)
    near = np.reshape(near, (points.shape[1], k))
    weights = _barycentric(corner[:, :, near], points[:, :, None])
    best = np.argmax(weights.min(axis=0), axis=1)
    rows = np.arange(points.shape[1])
    element, weights = near[rows, best], weights[:, rows, best]
    for number in np.flatnonzero(weights.min(axis=0) < OUTSIDE):
        everywhere = _barycentric(corner, points[:, number, None])
        element[number] = int(np.argmax(everywhere.min(axis=0)))
        weights[:, number] = everywhere[:, element[number]]
    weights = np.maximum(weights, 0.0)
    return triangles[:, element], weights / weights.sum(axis=0)


def _barycentric(corner: Array, point: Array) -> Array:
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]

    def cross(u: Array, v: Array) -> Array:
        return u[0] * v[1] - u[1] * v[0]

    whole = cross(b - a, c - a)
    parts = [cross(b - point, c - point), cross(c - point, a - point), cross(a - point, b - point)]
    return np.stack(parts) / whole


def prolonged(
    coarse_nodes: Array, coarse_triangles: NDArray, move: Array, fine: Relocation | Discretisation
) -> Array:
    """Moves q of a finer mesh that follow the ``move`` (2, coarse nodes) of a coarser one.

    On a uniform refinement every element stays as valid as the one it is a part of. On another mesh
    an element may be inverted, since it lies across several: there the move is smoothed, and if that does
    not help, made smaller as a whole.
    """
    X0, triangles = fine.problem.mesh.p, fine.problem.triangles
    before, after = (signed_areas(x, coarse_triangles) for x in (coarse_nodes, coarse_nodes + move))
    # slivers that the coarse map makes on purpose are kept, and are no reason to make all moves smaller
    least = max(0.5 * float(np.min(after / before)), 1e-9)
    shift = interpolated(coarse_nodes, coarse_triangles, move, X0)
    initial = signed_areas(X0, triangles)
    q = fine.mesh_map.q_of(X0 + shift)
    for _ in range(MENDINGS):
        now = fine.mesh_map.positions.values(q)
        small = signed_areas(now, triangles) < min(SMALL, least) * initial
        if not np.any(small):
            break
        shift = _smoothed(now - X0, triangles, np.unique(triangles[:, small]))
        q = fine.mesh_map.q_of(X0 + shift)
    bound = fine.mesh_map.bound
    q = np.clip(q, -bound, bound)
    while not np.all(signed_areas(fine.mesh_map.positions.values(q), triangles) > min(1e-3, least) * initial):
        q = 0.9 * q
        if np.max(np.abs(q), initial=0.0) < 1e-6:
            return np.zeros_like(q)
    return q


def _smoothed(shift: Array, triangles: NDArray, nodes: NDArray) -> Array:
    """The shift with some nodes set to the mean over their neighbours and themselves."""
    n = shift.shape[1]
    total, count = shift.copy(), np.ones(n)
    for i in range(3):
        for j in ((i + 1) % 3, (i + 2) % 3):
            np.add.at(total.T, triangles[i], shift[:, triangles[j]].T)
            np.add.at(count, triangles[i], 1.0)
    result = shift.copy()
    result[:, nodes] = (total / count)[:, nodes]
    return result
