"""A coarser mesh of the same domain: nodes are taken out until few enough are left.

In each round nodes no two of which are neighbours are taken out at once. A node is merged into a
neighbour, the one that leaves the best triangles; a node on a line (outer boundary, interface, named
part) into a neighbour on the same line, and only where the line is straight. So geometry and names stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.flips import flipped, sum_of_cotangents
from rmesh_nlp.meshes.geometry import signed_areas

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


def decimated(nodes: Array, triangles: NDArray, lines: Lines, target: int, seed: int = 0) -> Decimated:
    """Take out nodes until ``target`` are left, or no more can go.

    ``triangles`` (3, elements) are counter-clockwise; the same seed gives the same mesh.
    """
    rng = np.random.default_rng(seed)
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
        t = flipped(nodes, t, edges[:, edges[0] != edges[1]], partial(_cotangents, nodes)).triangles
        if before - left < LEAST_PROGRESS * before:
            break
    return Decimated(t, element, into)


def _cotangents(nodes: Array, triangles: NDArray, _: NDArray) -> Array:
    return sum_of_cotangents(nodes, triangles)


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


def shape_quality(nodes: Array, triangles: NDArray) -> Array:
    """``4 sqrt(3) area / (sum of squared edges)``: 1 if equilateral, negative if inverted."""
    corner = nodes[:, triangles]
    edges = np.sum((corner - np.roll(corner, 1, axis=1)) ** 2, axis=(0, 1))
    return np.asarray(4 * np.sqrt(3) * signed_areas(nodes, triangles) / np.maximum(edges, 1e-300))
