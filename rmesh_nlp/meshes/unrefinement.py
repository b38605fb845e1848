"""The mesh of which a mesh is the uniform refinement, if it is one.

Where every triangle was cut into four by the midpoints of its edges, each node is a coarse one or a midpoint,
and every edge has a midpoint at one end at least. Corners of the outer boundary are coarse nodes; from
a coarse node every neighbour is a midpoint, and beyond it, at twice the way, is the next coarse node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.reading import from_arrays

CLOSE = 1e-7
"""Distance, in parts of the shortest edge, at which a node is where it is looked for."""

STRAIGHT = 1e-6
"""Sine of the angle at a node of the outer boundary above which it is a corner."""


@dataclass(frozen=True)
class Coarse:
    """A coarse mesh and the numbers (coarse nodes,) that its nodes have in the fine one."""

    mesh: MeshTri
    nodes: NDArray[np.int64]


def unrefined(mesh: MeshTri) -> Coarse | None:
    """The mesh whose uniform refinement is ``mesh``, in whatever order of nodes; None if there is none.

    Named boundaries and subdomains are kept; None also if a name covers a part of a coarse edge or
    triangle only.
    """
    t = counter_clockwise(mesh.p, mesh.t)
    if t.shape[1] % 4:
        return None
    coarse = _coarse_nodes(mesh)
    if coarse is None:
        return None
    central = np.asarray(~coarse[t].any(axis=0))
    corners = coarse[t].sum(axis=0)
    if 4 * central.sum() != t.shape[1] or np.any(corners[~central] != 1):
        return None
    tree, tolerance = cKDTree(mesh.p.T), _tolerance(mesh)
    middle = t[:, central]
    P = mesh.p[:, middle]
    vertices = np.empty_like(middle)
    for i in range(3):
        at = P[:, (i + 1) % 3] + P[:, (i + 2) % 3] - P[:, i]
        distance, vertices[i] = tree.query(at.T)
        if np.any(distance > tolerance):
            return None
    number = np.cumsum(coarse) - 1
    names = _names(mesh, coarse, number, central)
    if names is None:
        return None
    nodes = np.flatnonzero(coarse)
    result = from_arrays(mesh.p[:, nodes].T, number[vertices].T, *names)
    return Coarse(result, nodes) if result.p.shape[1] == nodes.size else None


def _tolerance(mesh: MeshTri) -> float:
    a, b = mesh.facets
    return CLOSE * float(np.min(np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0)))


def _coarse_nodes(mesh: MeshTri) -> NDArray[np.bool_] | None:
    """Coarse nodes, found from the corners of the outer boundary onwards; None if they contradict."""
    n, tolerance = mesh.p.shape[1], _tolerance(mesh)
    tree = cKDTree(mesh.p.T)
    ends = np.hstack([mesh.facets, mesh.facets[::-1]])
    ends = ends[:, np.argsort(ends[0], kind="stable")]
    first = np.searchsorted(ends[0], np.arange(n + 1))
    coarse, middle = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    frontier = _corners(mesh)
    coarse[frontier] = True
    while frontier.size:
        count = first[frontier + 1] - first[frontier]
        owner = np.repeat(frontier, count)
        where = np.repeat(first[frontier] - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
        neighbour = ends[1, where + np.arange(owner.size)]
        middle[neighbour] = True
        distance, beyond = tree.query((2 * mesh.p[:, neighbour] - mesh.p[:, owner]).T)
        if np.any(distance > tolerance):
            return None
        new = np.unique(beyond[~coarse[beyond]])
        coarse[new] = True
        frontier = new
    used = np.unique(mesh.t)
    if np.any(coarse & middle) or not np.all((coarse | middle)[used]) or used.size < n:
        return None
    return coarse


def _corners(mesh: MeshTri) -> NDArray[np.int64]:
    """Nodes of the outer boundary that are not in the middle of a straight piece."""
    ends = mesh.facets[:, mesh.boundary_facets()]
    direction = mesh.p[:, ends[1]] - mesh.p[:, ends[0]]
    direction = direction / np.linalg.norm(direction, axis=0)
    n = mesh.p.shape[1]
    # with the two directions at a node d and e the determinant of d d^T + e e^T is the squared sine
    moments = [
        np.bincount(ends.ravel(), np.tile(direction[i] * direction[j], 2), n)
        for i, j in ((0, 0), (0, 1), (1, 1))
    ]
    sine = np.sqrt(np.maximum(moments[0] * moments[2] - moments[1] ** 2, 0))
    degree = np.bincount(ends.ravel(), minlength=n)
    return np.flatnonzero((degree > 0) & ((sine > STRAIGHT) | (degree != 2)))


def _names(
    mesh: MeshTri, coarse: NDArray[np.bool_], number: NDArray, central: NDArray[np.bool_]
) -> tuple[dict[str, NDArray], dict[str, NDArray]] | None:
    """Named edges (as pairs of coarse nodes) and subdomains of the coarse mesh."""
    boundaries: dict[str, NDArray] = {}
    for name, facets in (mesh.boundaries or {}).items():
        ends = mesh.facets[:, np.asarray(facets)]
        from_coarse = coarse[ends]
        if np.any(from_coarse.sum(axis=0) != 1):
            return None
        c = np.where(from_coarse[0], ends[0], ends[1])
        m = np.where(from_coarse[0], ends[1], ends[0])
        order = np.argsort(m, kind="stable")
        c, m = c[order], m[order]
        if m.size % 2 or np.any(m[::2] != m[1::2]):
            return None
        boundaries[name] = number[np.column_stack([c[::2], c[1::2]])]
    place = np.cumsum(central) - 1
    t = mesh.t
    # the triangles at the corners of a coarse one share an edge with its central one
    left, right = mesh.f2t
    subdomains: dict[str, NDArray] = {}
    for name, elements in (mesh.subdomains or {}).items():
        member = np.zeros(t.shape[1], dtype=bool)
        member[np.asarray(elements)] = True
        inside = right >= 0
        one, two = left[inside], right[inside]
        family = central[one] | central[two]
        if np.any(member[one[family]] != member[two[family]]):
            return None
        subdomains[name] = place[np.flatnonzero(member & central)]
    return boundaries, subdomains
