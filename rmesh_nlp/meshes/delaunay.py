"""Delaunay meshes in a metric, by edge flips: two triangles give way to those along the other diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import ROUNDING, Array, Index
from rmesh_nlp.meshes.geometry import edge_keys, signed_areas


@dataclass(frozen=True)
class MetricNodes:
    """Nodes (2, nodes) and at each a metric (3, nodes), with the entries xx, xy and yy."""

    nodes: Array
    metric: Array

    @classmethod
    def by(cls, nodes: Array, triangles: NDArray) -> MetricNodes:
        """With the metric in which the triangles (3, elements) are equilateral with edges of length one.

        At a node it is the mean of those of the triangles around, weighted with their areas.
        """
        edges = nodes[:, triangles] - nodes[:, np.roll(triangles, 1, axis=0)]
        area, n = signed_areas(nodes, triangles), nodes.shape[1]
        # the sum of e e^T over the edges of an equilateral triangle is 3/2 the identity
        xx, xy, yy = ((edges[i] * edges[j]).sum(axis=0) for i, j in ((0, 0), (0, 1), (1, 1)))
        weighted = 1.5 * area / (xx * yy - xy**2) * np.stack([yy, -xy, xx])
        around = np.bincount(triangles.ravel(), np.tile(area, 3), n)
        total = [np.bincount(triangles.ravel(), np.tile(entry, 3), n) for entry in weighted]
        return cls(nodes, np.stack(total) / np.where(around > 0, around, 1.0))

    def flatness(self, triangles: NDArray) -> Array:
        """The inverse of the shape in the metric: 1 for equilateral triangles, huge for inverted ones.

        Up to a factor it is the sum of the cotangents of the angles, whose total the Delaunay mesh has least
        (O. R. Musin, Properties of the Delaunay triangulation, SoCG 1997).
        """
        corner, metric = self.nodes[:, triangles], self.metric[:, triangles].mean(axis=1)
        edges = _squared(metric[:, None], corner - np.roll(corner, 1, axis=1)).sum(axis=0)
        area = signed_areas(self.nodes, triangles) * np.sqrt(metric[0] * metric[2] - metric[1] ** 2)
        return edges / (4 * np.sqrt(3) * np.maximum(area, 1e-300))

    def squared_lengths(self, at: NDArray, vectors: Array) -> Array:
        """Of vectors (2, n) in the metric at nodes (n,)."""
        return _squared(self.metric[:, at], vectors)


def _squared(metric: Array, vectors: Array) -> Array:
    x, y = vectors
    return metric[0] * x**2 + 2 * metric[1] * x * y + metric[2] * y**2


def delaunay(measured: MetricNodes, triangles: NDArray, fixed: NDArray) -> Index:
    """Flip edges until the mesh is Delaunay in the metric; new triangles take the places of old ones.

    ``triangles`` (3, elements) are counter-clockwise. The edges ``fixed`` (2, edges) and those of the outer
    boundary stay.
    """
    t = np.array(triangles, dtype=np.int64)
    n = measured.nodes.shape[1]
    fixed_keys = edge_keys(fixed, n)
    value = measured.flatness(t)
    while True:  # each flip lowers the sum of the values
        i, j, (a, b, c, d) = _interior_edges(t, n, fixed_keys)
        first, second = np.stack([c, d, b]), np.stack([d, c, a])
        new = measured.flatness(np.hstack([first, second])).reshape(2, -1)
        gain = value[i] + value[j] - new.sum(axis=0)
        chosen = _independent(gain, i, j, t.shape[1])
        if chosen.size == 0:
            return t
        t[:, i[chosen]], t[:, j[chosen]] = first[:, chosen], second[:, chosen]
        value[i[chosen]], value[j[chosen]] = new[:, chosen]


def _interior_edges(t: Index, n: int, fixed_keys: Index) -> tuple[Index, Index, Index]:
    """Elements left and right of the edges that may be flipped, and their vertices (4, edges).

    These are the ends a and b, then the vertex left and the vertex right of the way from a to b.
    """
    a, b, opposite = t.ravel(), t[[1, 2, 0]].ravel(), t[[2, 0, 1]].ravel()
    key = edge_keys(np.stack([a, b]), n)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    pair = pair[~np.isin(key[order[pair]], fixed_keys)]
    i, j = order[pair], order[pair + 1]
    return i % t.shape[1], j % t.shape[1], np.stack([a[i], b[i], opposite[i], opposite[j]])


def _independent(gain: Array, left: Index, right: Index, n: int) -> Index:
    """Flips that gain, each more than any other that shares a triangle with it; the first of equals."""
    best, rank = np.full(n, -np.inf), np.full(n, gain.size)
    for side in (left, right):
        np.maximum.at(best, side, gain)
    number = np.flatnonzero((gain >= best[left]) & (gain >= best[right]) & (gain > ROUNDING))
    for side in (left, right):
        np.minimum.at(rank, side[number], number)
    return number[(rank[left[number]] == number) & (rank[right[number]] == number)]
