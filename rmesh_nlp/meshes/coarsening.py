"""Coarser meshes of the same domain: the one that was refined uniformly, or one with nodes taken out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.flips import flipped, sum_of_cotangents
from rmesh_nlp.meshes.geometry import counter_clockwise, shape_quality

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

LEAST_QUALITY = 0.2
"""Shape (1 for an equilateral triangle, 0 for a flat one) that a merger must leave."""

LEAST_PROGRESS = 0.03
"""Part of the nodes that a round must take out for another one to follow."""

PASSES = 3
"""Draws of independent nodes per round."""


@dataclass(frozen=True)
class Lines:
    """What must be kept of a mesh: nodes (a mask), and all edges (2, edges) on lines."""

    kept: Mask
    edges: Index


@dataclass(frozen=True)
class Decimated:
    """Triangles (3, elements) between the old nodes, which old element each was, and where nodes went.

    ``into`` (nodes,) is the node that each node was merged into; itself if it stays.
    """

    triangles: Index
    element: Index
    into: Index


def decimated(nodes: Array, triangles: NDArray, lines: Lines, target: int) -> Decimated:
    """Take out nodes until ``target`` are left, or no more can go; triangles are counter-clockwise."""
    rng = np.random.default_rng(0)  # the same mesh each time
    t, element = np.array(triangles), np.arange(triangles.shape[1])
    into = np.arange(nodes.shape[1])
    on_line = np.zeros(nodes.shape[1], dtype=bool)
    on_line[lines.edges] = True
    left = np.unique(t).size
    while left > target:
        before = left
        for _ in range(PASSES):
            merges = _merges(nodes, t, into[lines.edges], on_line, lines.kept, rng)[:, : left - target]
            if merges.shape[1] == 0:
                break
            step = np.arange(nodes.shape[1])
            step[merges[0]] = merges[1]
            into, t = step[into], step[t]
            real = (t[0] != t[1]) & (t[1] != t[2]) & (t[2] != t[0])
            t, element = t[:, real], element[real]
            left -= merges.shape[1]
        edges = into[lines.edges]
        # in their places: flips never cross a line, so each triangle stays within its subdomain
        t = flipped(nodes, t, edges[:, edges[0] != edges[1]], partial(sum_of_cotangents, nodes)).triangles
        if before - left < LEAST_PROGRESS * before:
            break
    return Decimated(t, element, into)


def _merges(
    nodes: Array, t: NDArray, line_edges: NDArray, on_line: Mask, kept: Mask, rng: np.random.Generator
) -> Index:
    """Pairs (2, merges): nodes no two of which share a triangle, and the neighbours they merge into."""
    n = nodes.shape[1]
    # where the mesh is finest first, so that what is left is even; the draw decides between equals
    priority = rng.uniform(1, 2, n) / _mean_edges(nodes, t)
    priority[kept] = -1.0
    edges = np.hstack([t[[i, j]] for i in range(3) for j in range(3) if i != j])
    best = np.zeros(n)
    np.maximum.at(best, edges[0], priority[edges[1]])
    chosen = (priority > best) & ~kept
    # all pairs of a chosen node and a neighbour it may merge into
    edges = np.unique(edges[:, chosen[edges[0]] & ~on_line[edges[0]]], axis=1)
    along = line_edges[:, line_edges[0] != line_edges[1]]
    along = np.hstack([along, along[::-1]])
    along = along[:, ~_in_short_loops(along, n)[along[0]]]
    pairs = np.hstack([edges, np.unique(along[:, chosen[along[0]]], axis=1)])
    if pairs.shape[1] == 0:
        return pairs
    quality = _least_quality(nodes, t, pairs)
    order = np.lexsort((-quality, pairs[0]))
    pairs, quality = pairs[:, order], quality[order]
    _, first = np.unique(pairs[0], return_index=True)
    return pairs[:, first[quality[first] > LEAST_QUALITY]]


def _in_short_loops(along: NDArray, n: int) -> Mask:
    """Nodes (n,) of closed lines of three or four edges, such as small holes: fewer would close them.

    Two nodes of a line may be taken out at once, so that five leave three at least.
    """
    line = sp.csr_array((np.ones(along.shape[1]), along), shape=(n, n))
    line.data[:] = 1.0  # an edge of two parts counts once
    twice = sp.csr_array(line @ line)
    found = np.zeros(n, dtype=bool)
    regular = np.flatnonzero(np.diff(line.indptr) == 2)
    first, second = line.indices[line.indptr[regular]], line.indices[line.indptr[regular] + 1]
    found[regular] = (line[first, second] > 0) | (twice[first, second] > 1)
    return found


def _mean_edges(nodes: Array, t: NDArray) -> Array:
    """Mean length of the edges at each node (of those of its triangles), 1 where there is none."""
    ends = t[[0, 1, 1, 2, 2, 0]]
    length = np.linalg.norm(nodes[:, ends[::2]] - nodes[:, ends[1::2]], axis=0)
    n, ends = nodes.shape[1], ends.ravel()
    total, count = np.bincount(ends, np.repeat(length, 2, axis=0).ravel(), n), np.bincount(ends, minlength=n)
    return np.asarray(np.where(count > 0, total, 1.0) / np.maximum(count, 1))


def _least_quality(nodes: Array, t: NDArray, pairs: NDArray) -> Array:
    """Quality of the worst triangle that merging the first node of each pair into the second leaves."""
    elements = np.tile(np.arange(t.shape[1]), 3)
    around = sp.csr_array((np.ones(t.size), (t.ravel(), elements)))[pairs[0]]  # a row per pair
    one, other = np.repeat(pairs, np.diff(around.indptr), axis=1)
    corner = t[:, around.indices]
    vanishes = np.any(corner == other, axis=0)
    value = np.where(vanishes, 1.0, shape_quality(nodes, np.where(corner == one, other, corner)))
    return np.asarray(np.minimum.reduceat(value, around.indptr[:-1]))


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
    one, two = mesh.f2t[:, mesh.f2t[1] >= 0]
    family = central[one] | central[two]
    subdomains: dict[str, Index] = {}
    for name, elements in (mesh.subdomains or {}).items():
        member = np.zeros(mesh.t.shape[1], dtype=bool)
        member[np.asarray(elements)] = True
        if np.any(member[one[family]] != member[two[family]]):
            return None
        subdomains[name] = place[member & central]
    return boundaries, subdomains
