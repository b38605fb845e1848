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
from rmesh_nlp.meshes.flips import flipped, sum_of_cotangents
from rmesh_nlp.meshes.geometry import counter_clockwise, shape_quality
from rmesh_nlp.meshes.reading import from_arrays

LEAST_QUALITY = 0.2
"""Shape (1 for an equilateral triangle, 0 for a flat one) that a merger must leave."""

LEAST_PROGRESS = 0.03
"""Part of the nodes that a round must take out for another one to follow."""

PASSES = 3
"""Draws of independent nodes per round."""


@dataclass(frozen=True)
class Lines:
    """What must be kept of a mesh.

    Attributes
    ----------
    kept : (nodes,) bool array
        Nodes that stay: corners, ends of parts.
    edges : (2, edges) array
        All edges on lines.
    """

    kept: NDArray[np.bool_]
    edges: NDArray[np.int64]


@dataclass(frozen=True)
class Decimated:
    """Triangles (3, elements) between the old nodes, which old element each was, and where nodes went.

    ``into`` (nodes,) is the node that each node was merged into; itself if it stays.
    """

    triangles: NDArray[np.int64]
    element: NDArray[np.int64]
    into: NDArray[np.int64]


def decimated(nodes: Array, triangles: NDArray, lines: Lines, target: int) -> Decimated:
    """Take out nodes until ``target`` are left, or no more can go.

    ``triangles`` (3, elements) are counter-clockwise.
    """
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
    nodes: Array,
    t: NDArray,
    line_edges: NDArray,
    on_line: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Pairs (2, merges): nodes no two of which share a triangle, and the neighbours they merge into."""
    n = nodes.shape[1]
    # where the mesh is finest first, so that what is left is even; the draw decides between equals
    priority = rng.uniform(1, 2, n) / _mean_edges(nodes, t)
    priority[kept] = -1.0
    best = np.zeros(n)
    for i in range(3):
        for j in ((i + 1) % 3, (i + 2) % 3):
            np.maximum.at(best, t[i], priority[t[j]])
    chosen = (priority > best) & ~kept
    # all pairs of a chosen node and a neighbour it may merge into
    edges = np.hstack([t[[i, j]] for i in range(3) for j in range(3) if i != j])
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
    good = first[quality[first] > LEAST_QUALITY]
    return pairs[:, good]


def _in_short_loops(along: NDArray, n: int) -> NDArray[np.bool_]:
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
    total, count = np.zeros(nodes.shape[1]), np.zeros(nodes.shape[1])
    for i in range(3):
        a, b = t[i], t[(i + 1) % 3]
        length = np.linalg.norm(nodes[:, a] - nodes[:, b], axis=0)
        for end in (a, b):
            np.add.at(total, end, length)
            np.add.at(count, end, 1.0)
    return np.asarray(np.where(count > 0, total, 1.0) / np.maximum(count, 1.0))


def _least_quality(nodes: Array, t: NDArray, pairs: NDArray) -> Array:
    """Quality of the worst triangle that merging the first node of each pair into the second leaves."""
    owner = t.ravel()
    order = np.argsort(owner, kind="stable")
    element = np.tile(np.arange(t.shape[1]), 3)[order]
    first = np.searchsorted(owner[order], np.arange(nodes.shape[1] + 1))
    count = first[pairs[0] + 1] - first[pairs[0]]
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    pair = np.repeat(np.arange(pairs.shape[1]), count)
    around = element[np.repeat(first[pairs[0]] - start, count) + np.arange(pair.size)]
    corner = t[:, around]
    vanishes = np.any(corner == pairs[1, pair], axis=0)
    corner = np.where(corner == pairs[0, pair], pairs[1, pair], corner)
    value = np.where(vanishes, 1.0, shape_quality(nodes, corner))
    return np.asarray(np.minimum.reduceat(value, start))


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
