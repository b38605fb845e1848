"""The mesh that was refined uniformly, found from its refinement in whatever order of nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

CLOSE = 1e-7
"""Distance, in parts of the shortest edge, at which a node is where it is looked for."""

STRAIGHT = 1e-6
"""Sine of the angle at a node of the outer boundary above which it is a corner."""


@dataclass(frozen=True)
class Coarse:
    """A coarse mesh and the numbers (coarse nodes,) that its nodes have in the fine one."""

    mesh: MeshTri
    nodes: Index


def unrefined(mesh: MeshTri) -> Coarse | None:
    """The mesh whose uniform refinement is ``mesh``, in whatever order of nodes; None if there is none.

    Named boundaries and subdomains are kept; None also if a name covers a part of a coarse edge or
    triangle only.
    """
    a, b = mesh.facets
    tree = cKDTree(mesh.p.T)
    tolerance = CLOSE * float(np.min(np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0)))
    coarse = _coarse_nodes(mesh, tree, tolerance)
    if coarse is None:
        return None
    t = counter_clockwise(mesh.p, mesh.t)
    corners = coarse[t].sum(axis=0)
    central = corners == 0
    if 4 * central.sum() != t.shape[1] or np.any(corners > 1):
        return None
    P = mesh.p[:, t[:, central]]  # the vertices of a coarse triangle are opposite to those of its central one
    distance, vertices = tree.query(np.moveaxis(P.sum(axis=1, keepdims=True) - 2 * P, 0, -1))
    names = _names(mesh, coarse, central)
    if names is None or np.any(distance > tolerance):
        return None
    nodes, number = np.flatnonzero(coarse), np.cumsum(coarse) - 1
    result = from_arrays(mesh.p[:, nodes].T, number[vertices].T, *names)
    return Coarse(result, nodes) if result.p.shape[1] == nodes.size else None


def _coarse_nodes(mesh: MeshTri, tree: cKDTree, tolerance: float) -> Mask | None:
    """Coarse nodes, found from the corners of the outer boundary onwards; None if they contradict."""
    n = mesh.p.shape[1]
    neighbours = sp.csr_array(
        (np.ones(2 * mesh.facets.shape[1]), np.hstack([mesh.facets, mesh.facets[::-1]])), shape=(n, n)
    )
    coarse, middle = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    frontier = _corners(mesh)
    coarse[frontier] = True
    while frontier.size:
        beside = neighbours[frontier]
        owner, neighbour = np.repeat(frontier, np.diff(beside.indptr)), beside.indices
        middle[neighbour] = True
        distance, beyond = tree.query((2 * mesh.p[:, neighbour] - mesh.p[:, owner]).T)
        if np.any(distance > tolerance):
            return None
        frontier = np.unique(beyond[~coarse[beyond]])
        coarse[frontier] = True
    return coarse if np.all(coarse != middle) else None


def _corners(mesh: MeshTri) -> Index:
    """Nodes of the outer boundary that are not in the middle of a straight piece."""
    ends = mesh.facets[:, mesh.boundary_facets()]
    direction = mesh.p[:, ends[1]] - mesh.p[:, ends[0]]
    x, y = np.tile(direction / np.linalg.norm(direction, axis=0), 2)
    n, ends = mesh.p.shape[1], ends.ravel()
    # with the two directions at a node d and e the determinant of d d^T + e e^T is the squared sine
    xx, xy, yy = (np.bincount(ends, moment, n) for moment in (x * x, x * y, y * y))
    sine = np.sqrt(np.maximum(xx * yy - xy**2, 0))
    degree = np.bincount(ends, minlength=n)
    return np.flatnonzero((degree > 0) & ((sine > STRAIGHT) | (degree != 2)))


def _names(mesh: MeshTri, coarse: Mask, central: Mask) -> tuple[dict[str, Index], dict[str, Index]] | None:
    """Named edges (as pairs of coarse nodes) and subdomains of the coarse mesh."""
    number, place = np.cumsum(coarse) - 1, np.cumsum(central) - 1
    boundaries: dict[str, Index] = {}
    for name, facets in (mesh.boundaries or {}).items():
        ends = mesh.facets[:, np.asarray(facets)]
        ends = np.take_along_axis(ends, np.argsort(coarse[ends], axis=0), axis=0)  # the coarse end second
        middle, outer = ends[:, np.argsort(ends[0], kind="stable")]
        if np.any(coarse[middle] | ~coarse[outer]) or middle.size % 2 or np.any(middle[::2] != middle[1::2]):
            return None
        boundaries[name] = number[outer].reshape(-1, 2)
    # the triangles at the corners of a coarse one share an edge with its central one
    first, second = mesh.f2t[:, mesh.f2t[1] >= 0]
    family = central[first] | central[second]
    subdomains: dict[str, Index] = {}
    for name, elements in (mesh.subdomains or {}).items():
        member = np.zeros(mesh.t.shape[1], dtype=bool)
        member[np.asarray(elements)] = True
        if np.any(member[first[family]] != member[second[family]]):
            return None
        subdomains[name] = place[member & central]
    return boundaries, subdomains
