"""Coarser meshes by taking nodes out, with edges along those of the given mesh.

The best map of a mesh depends on the directions of its edges: one found with other directions is of little
use (docs/notes/large_moves.md, "Meshes that are not nested"). So the nodes that stay are grown from the lines
inwards as in a uniform refinement: beyond the neighbour of one that stays, as far again, is the next. The
others are merged into them, and edges flipped until the mesh is Delaunay in the metric in which the triangles
of the given one are equilateral. Where that is regular, so is the coarser one, with the same directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask
from rmesh_nlp.meshes.delaunay import MetricNodes, delaunay
from rmesh_nlp.meshes.geometry import pieces_of, sides

LEAST_QUALITY = 0.2
"""Shape in the metric (1 for an equilateral triangle, 0 for a flat one) that a merger must leave."""


@dataclass(frozen=True)
class Lines:
    """What must be kept of a mesh: nodes (a mask), and all edges (2, edges) on lines."""

    kept: Mask
    edges: Index

    def nodes(self, n: int) -> Mask:
        """Nodes (n,) on lines."""
        on_line = np.zeros(n, dtype=bool)
        on_line[self.edges] = True
        return on_line


@dataclass(frozen=True)
class Decimated:
    """Triangles (3, elements) between the old nodes, which old element each was, and where nodes went.

    ``into`` (nodes,) is the node that each node was merged into; itself if it stays.
    """

    triangles: Index
    element: Index
    into: Index


def decimated(nodes: Array, triangles: NDArray, lines: Lines) -> Decimated:
    """Take out about three in four nodes (2, nodes); triangles (3, elements) are counter-clockwise."""
    rng, n = np.random.default_rng(0), nodes.shape[1]  # the same mesh each time
    measured = MetricNodes.by(nodes, triangles)
    t, element, into = np.array(triangles), np.arange(triangles.shape[1]), np.arange(n)
    on_line, removable = lines.nodes(n), ~staying(measured, triangles, lines, rng.permutation(n))
    while np.any(removable):
        merges = _merges(measured, t, into[lines.edges], on_line, rng.permutation(n) * removable)
        if merges.shape[1] == 0:
            break
        step = np.arange(n)
        step[merges[0]] = merges[1]
        into, t, removable[merges[0]] = step[into], step[t], False
        real = (t[0] != t[1]) & (t[1] != t[2]) & (t[2] != t[0])
        t, element, edges = t[:, real], element[real], into[lines.edges]
        # in their places: flips never cross a line, so each triangle stays within its subdomain
        t = delaunay(measured, t, edges[:, edges[0] != edges[1]])
    return Decimated(t, element, into)


def staying(measured: MetricNodes, triangles: NDArray, lines: Lines, draw: Index) -> Mask:
    """Nodes that stay: those kept, then others on lines, then inside; every node is one or is beside one.

    ``draw`` (nodes,), all different, decides between equals: in the order of a mesh generator they leave
    rougher meshes.
    """
    n = draw.size
    on_line = lines.nodes(n)
    on_lines = _grown(measured, _graph(lines.edges, n), lines.kept, on_line, draw)
    return _grown(measured, _graph(sides(triangles), n), on_lines, ~on_line, draw)


def _graph(edges: NDArray, n: int) -> sp.csr_array:
    both = np.hstack([edges, edges[::-1]])
    return sp.csr_array((np.ones(both.shape[1], dtype=bool), both), shape=(n, n))


def _beside(graph: sp.csr_array, nodes: Index) -> tuple[Index, Index]:
    """All pairs of one of the nodes, by its place among them, and a neighbour."""
    rows = graph[nodes]
    return np.repeat(np.arange(nodes.size), np.diff(rows.indptr)), rows.indices


def _grown(measured: MetricNodes, graph: sp.csr_array, seeds: Mask, allowed: Mask, draw: Index) -> Mask:
    """The seeds and allowed nodes, no two of these neighbours, as many as there can be, front by front."""
    chosen, front = np.array(seeds), np.flatnonzero(seeds)
    free = allowed & ~chosen
    free[_beside(graph, front)[1]] = False
    while np.any(free):
        nodes, off = _beyond(measured, graph, front)
        near = free[nodes]
        cost = np.full(free.size, np.inf)
        np.minimum.at(cost, nodes[near], np.round(off[near] / ROUNDING))  # equal ones are equal
        if not np.any(near):
            cost[free] = 0.0
        front = _independent(cost, draw, graph)
        chosen[front], free[front] = True, False
        free[_beside(graph, front)[1]] = False
    return chosen


def _beyond(measured: MetricNodes, graph: sp.csr_array, front: Index) -> tuple[Index, Array]:
    """Nodes two edges from the front, and how far each is, in edges, from where a straight line would end."""
    start, middle = _beside(graph, front)
    way, end = _beside(graph, middle)
    start, middle = front[start[way]], middle[way]
    first = measured.nodes[:, middle] - measured.nodes[:, start]
    second = measured.nodes[:, end] - measured.nodes[:, middle]
    length = np.maximum(measured.squared_lengths(middle, first), 1e-300)
    return end, np.sqrt(measured.squared_lengths(middle, second - first) / length)


def _independent(cost: Array, draw: Index, graph: sp.csr_array) -> Index:
    """Nodes of finite cost, no two of them neighbours, as many as there can be; the cheapest ones first."""
    candidates = np.flatnonzero(np.isfinite(cost))
    candidates = candidates[np.lexsort((draw[candidates], cost[candidates]))]
    last, chosen = cost.size, np.zeros(cost.size, dtype=bool)
    rank = np.full(cost.size, last)
    rank[candidates] = np.arange(candidates.size)
    while candidates.size:
        place, neighbour = _beside(graph, candidates)
        least = np.full(candidates.size, last)
        np.minimum.at(least, place, rank[neighbour])
        first = candidates[rank[candidates] < least]
        chosen[first] = True
        rank[first] = rank[_beside(graph, first)[1]] = last
        candidates = candidates[rank[candidates] < last]
    return np.flatnonzero(chosen)


def _merges(
    measured: MetricNodes, t: NDArray, line_edges: NDArray, on_line: Mask, priority: NDArray
) -> Index:
    """Pairs (2, merges): nodes no two of which share a triangle, and the neighbours they merge into.

    Only nodes of positive ``priority`` (nodes,) are merged.
    """
    n = priority.size
    edges = np.hstack([sides(t), sides(t[::-1])])
    best = np.zeros(n)
    np.maximum.at(best, edges[0], priority[edges[1]])
    chosen = priority > best
    # all pairs of a chosen node and a neighbour it may merge into
    edges = np.unique(edges[:, chosen[edges[0]] & ~on_line[edges[0]]], axis=1)
    along = line_edges[:, line_edges[0] != line_edges[1]]
    along = np.hstack([along, along[::-1]])
    along = along[:, ~_on_short_lines(along, n)[along[0]]]
    pairs = np.hstack([edges, np.unique(along[:, chosen[along[0]]], axis=1)])
    if pairs.shape[1] == 0:
        return pairs
    worst = _worst(measured, t, pairs)
    order = np.lexsort((worst, pairs[0]))
    pairs, worst = pairs[:, order], worst[order]
    _, first = np.unique(pairs[0], return_index=True)
    return pairs[:, first[worst[first] < 1 / LEAST_QUALITY]]


def _on_short_lines(along: NDArray, n: int) -> Mask:
    """Nodes (n,) of lines of up to four nodes by themselves, such as small holes: fewer would close them.

    Two nodes of a line may be taken out at once, so that five leave three at least.
    """
    piece = pieces_of(along, n)
    return np.bincount(piece)[piece] <= 4


def _worst(measured: MetricNodes, t: NDArray, pairs: NDArray) -> Array:
    """Flatness of the flattest triangle that merging the first node of each pair into the second leaves."""
    elements = np.tile(np.arange(t.shape[1]), 3)
    around = sp.csr_array((np.ones(t.size), (t.ravel(), elements)))[pairs[0]]  # a row per pair
    merged, kept = np.repeat(pairs, np.diff(around.indptr), axis=1)
    corner = t[:, around.indices]
    vanishes = np.any(corner == kept, axis=0)
    value = np.where(vanishes, 1.0, measured.flatness(np.where(corner == merged, kept, corner)))
    return np.maximum.reduceat(value, around.indptr[:-1])
