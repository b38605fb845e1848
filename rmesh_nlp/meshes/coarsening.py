"""Coarser meshes by taking nodes out, with edges along those of the given mesh.

The best map of a mesh depends on the directions of its edges: one found with other directions is of little use
(docs/notes/large_moves.md, "Meshes that are not nested"). So the nodes that stay are grown from the lines
inwards as in a mesh refined uniformly: beyond the neighbour of one that stays, as far again, is the next. The
others are merged into them, and edges flipped until the mesh is Delaunay in the metric of the given one, in
which its triangles are equilateral. Where that is regular, so is the coarser one, with the same directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.flips import flipped
from rmesh_nlp.meshes.geometry import signed_areas

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

FAR = 0.7
"""Distance, in edges, from where the next node that stays is looked for, beyond which it is not taken for it."""

LEAST_QUALITY = 0.2
"""Shape (1 for an equilateral triangle, 0 for a flat one) in the metric that a merger must leave."""

PASSES = 3
"""Draws of independent nodes between flips."""


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


def decimated(nodes: Array, triangles: NDArray, lines: Lines) -> Decimated:
    """Take out about three quarters of the nodes (2, nodes); triangles (3, elements) are counter-clockwise."""
    rng, n = np.random.default_rng(0), nodes.shape[1]  # the same mesh each time
    metric = mean_metric(nodes, triangles)
    worth = partial(_flatness, nodes, metric)
    t, element, into = np.array(triangles), np.arange(triangles.shape[1]), np.arange(n)
    on_line = np.zeros(n, dtype=bool)
    on_line[lines.edges] = True
    left = ~staying(nodes, triangles, lines, rng)
    merged = True
    while merged and np.any(left):
        merged = False
        for _ in range(PASSES):
            merges = _merges(worth, t, into[lines.edges], on_line, rng.permutation(n) * left)
            if merges.shape[1] == 0:
                break
            step, merged = np.arange(n), True
            step[merges[0]] = merges[1]
            into, t, left[merges[0]] = step[into], step[t], False
            real = (t[0] != t[1]) & (t[1] != t[2]) & (t[2] != t[0])
            t, element = t[:, real], element[real]
        edges = into[lines.edges]
        # in their places: flips never cross a line, so each triangle stays within its subdomain
        t = flipped(nodes, t, edges[:, edges[0] != edges[1]], worth).triangles
    return Decimated(t, element, into)


def mean_metric(nodes: Array, triangles: NDArray) -> Array:
    """(3, nodes) components xx, xy, yy at each node of the metric in which triangles are equilateral.

    The mean of those of the triangles around, weighted with their areas; edges have the length 1.
    """
    edges = nodes[:, triangles] - nodes[:, np.roll(triangles, 1, axis=0)]
    area, n = signed_areas(nodes, triangles), nodes.shape[1]
    # the edges e of an equilateral triangle with sides 1 have a sum of e e^T of 3/2 the identity
    xx, xy, yy = ((edges[i] * edges[j]).sum(axis=0) for i, j in ((0, 0), (0, 1), (1, 1)))
    weighted = 1.5 * area / (xx * yy - xy**2) * np.stack([yy, -xy, xx])
    around = np.bincount(triangles.ravel(), np.tile(area, 3), n)
    total = [np.bincount(triangles.ravel(), np.tile(one, 3), n) for one in weighted]
    return np.asarray(np.stack(total) / np.where(around > 0, around, 1.0))


def _squared(metric: Array, vector: Array) -> Array:
    """Squared length of vectors (2, ...) in a metric (3, ...)."""
    x, y = vector
    return np.asarray(metric[0] * x**2 + 2 * metric[1] * x * y + metric[2] * y**2)


def _flatness(nodes: Array, metric: Array, triangles: NDArray, _: NDArray | None = None) -> Array:
    """The inverse of the shape in the metric: 1 for equilateral triangles, huge for flat and inverted ones.

    Up to a factor the sum of the cotangents, which the Delaunay mesh has least
    (O. R. Musin, Properties of the Delaunay triangulation, SoCG 1997).
    """
    here, corner = metric[:, triangles].mean(axis=1), nodes[:, triangles]
    edges = _squared(here[:, None], corner - np.roll(corner, 1, axis=1)).sum(axis=0)
    area = signed_areas(nodes, triangles) * np.sqrt(here[0] * here[2] - here[1] ** 2)
    return np.asarray(edges / (4 * np.sqrt(3) * np.maximum(area, 1e-300)))


def staying(nodes: Array, triangles: NDArray, lines: Lines, rng: np.random.Generator) -> Mask:
    """Nodes that stay: those kept, first others on lines, then inside; each node is one or has one beside it."""
    n = nodes.shape[1]
    metric, draw = mean_metric(nodes, triangles), rng.permutation(n) / n
    beside = _graph(np.hstack([triangles[[0, 1]], triangles[[1, 2]], triangles[[2, 0]]]), n)
    on_line = np.zeros(n, dtype=bool)
    on_line[lines.edges] = True
    on_lines = _grown(nodes, metric, _graph(lines.edges, n), lines.kept, on_line, draw)
    return _grown(nodes, metric, beside, on_lines, ~on_line, draw)


def _graph(edges: NDArray, n: int) -> sp.csr_array:
    both = np.hstack([edges, edges[::-1]])
    return sp.csr_array((np.ones(both.shape[1], dtype=bool), both), shape=(n, n))


def _grown(nodes: Array, metric: Array, beside: sp.csr_array, seeds: Mask, allowed: Mask, draw: Array) -> Mask:
    """The seeds and allowed nodes no two of which are neighbours, as many as there can be.

    They are found front by front; the one nearest to where it is looked for comes first, ``draw`` (nodes,), in
    [0, 1), decides between equals.
    """
    chosen, front = np.array(seeds), np.flatnonzero(seeds)
    free = allowed & ~chosen
    free[beside[front].indices] = False
    while np.any(free):
        found, off = _beyond(nodes, metric, beside, front)
        near = free[found] & (off < FAR)
        rank = np.full(free.size, np.inf)
        np.minimum.at(rank, found[near], off[near] + 1e-6 * draw[found[near]])
        if not np.any(near):
            rank[free] = draw[free]
        front = _independent(rank, beside)
        chosen[front], free[front] = True, False
        free[beside[front].indices] = False
    return chosen


def _beyond(nodes: Array, metric: Array, beside: sp.csr_array, front: Index) -> tuple[Index, Array]:
    """Nodes two edges from the front, and how far each is, in edges, from where a straight line would end."""

    def neighbours(of: Index) -> tuple[Index, Index]:
        rows = beside[of]
        return np.repeat(np.arange(of.size), np.diff(rows.indptr)), rows.indices

    start, middle = neighbours(front)
    way, end = neighbours(middle)
    start, middle = front[start[way]], middle[way]
    edge, off = nodes[:, middle] - nodes[:, start], nodes[:, end] - nodes[:, middle]
    length = np.maximum(_squared(metric[:, middle], edge), 1e-300)
    return end, np.sqrt(_squared(metric[:, middle], off - edge) / length)


def _independent(rank: Array, beside: sp.csr_array) -> Index:
    """Nodes of finite rank, no two of them neighbours, the lowest ranks first, as many as there can be."""
    rank, found = np.array(rank), np.zeros(rank.size, dtype=bool)
    while (left := np.flatnonzero(np.isfinite(rank))).size:
        rows = beside[left]
        least = np.full(left.size, np.inf)
        np.minimum.at(least, np.repeat(np.arange(left.size), np.diff(rows.indptr)), rank[rows.indices])
        first = left[rank[left] < least]
        found[first] = True
        rank[first] = rank[beside[first].indices] = np.inf
    return np.flatnonzero(found)


def _merges(
    worth: partial[Array], t: NDArray, line_edges: NDArray, on_line: Mask, priority: NDArray
) -> Index:
    """Pairs (2, merges): nodes no two of which share a triangle, and the neighbours they merge into.

    Only nodes of positive ``priority`` (nodes,) are merged.
    """
    n = priority.size
    edges = np.hstack([t[[i, j]] for i in range(3) for j in range(3) if i != j])
    best = np.zeros(n)
    np.maximum.at(best, edges[0], priority[edges[1]])
    chosen = priority > best
    # all pairs of a chosen node and a neighbour it may merge into
    edges = np.unique(edges[:, chosen[edges[0]] & ~on_line[edges[0]]], axis=1)
    along = line_edges[:, line_edges[0] != line_edges[1]]
    along = np.hstack([along, along[::-1]])
    along = along[:, ~_in_short_loops(along, n)[along[0]]]
    pairs = np.hstack([edges, np.unique(along[:, chosen[along[0]]], axis=1)])
    if pairs.shape[1] == 0:
        return pairs
    flatness = _worst(worth, t, pairs)
    order = np.lexsort((flatness, pairs[0]))
    pairs, flatness = pairs[:, order], flatness[order]
    _, first = np.unique(pairs[0], return_index=True)
    return pairs[:, first[flatness[first] < 1 / LEAST_QUALITY]]


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


def _worst(worth: partial[Array], t: NDArray, pairs: NDArray) -> Array:
    """Flatness of the flattest triangle that merging the first node of each pair into the second leaves."""
    elements = np.tile(np.arange(t.shape[1]), 3)
    around = sp.csr_array((np.ones(t.size), (t.ravel(), elements)))[pairs[0]]  # a row per pair
    one, other = np.repeat(pairs, np.diff(around.indptr), axis=1)
    corner = t[:, around.indices]
    vanishes = np.any(corner == other, axis=0)
    value = np.where(vanishes, 1.0, worth(np.where(corner == one, other, corner)))
    return np.asarray(np.maximum.reduceat(value, around.indptr[:-1]))
