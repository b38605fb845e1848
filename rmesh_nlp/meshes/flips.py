"""Edge flips: two triangles that share an edge are replaced by the two that share the other diagonal.

Which flips are worth making is the caller's criterion; edges on lines are never flipped. In each round
flips that share no triangle are made at once, the most worthwhile ones first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.geometry import signed_areas

Index = NDArray[np.int64]
Worth = Callable[[Index, Index], Array]
"""``(triangles (3, n), elements (n,)) -> values (n,)``: a sum over triangles that flips are to lower. The
second argument are the elements that the triangles are, or take the place of."""

MAX_ROUNDS = 50

LEAST_AREA = 1e-3
"""Area of a new triangle, in parts of the two, below which an edge is not flipped."""


@dataclass(frozen=True)
class Flipped:
    """Triangles (3, elements) after flips, in the places of those before; number of flips and their worth."""

    triangles: Index
    flips: int
    gain: float


def flipped(
    nodes: Array,
    triangles: NDArray,
    fixed: NDArray,
    worth: Worth,
    least_gain: float = 0.0,
    allowed: Callable[[Index], NDArray[np.bool_]] | None = None,
) -> Flipped:
    """Flip edges as long as it lowers the sum of ``worth``, by more than ``least_gain`` a flip.

    Parameters
    ----------
    nodes : (2, nodes) array
    triangles : (3, elements) array
        Counter-clockwise.
    fixed : (2, edges) array
        Edges that stay; those of the outer boundary stay in any case.
    worth : callable
    allowed : callable, optional
        Which of some triangles (3, n) may be made.
    """
    t = np.array(triangles, dtype=np.int64)
    n = nodes.shape[1]
    fixed_keys = np.min(fixed, axis=0) * n + np.max(fixed, axis=0)
    value = worth(t, np.arange(t.shape[1]))
    count, total = 0, 0.0
    for _ in range(MAX_ROUNDS):
        left, right, (a, b, c, d) = _interior_edges(t, n, fixed_keys)
        one, two = np.stack([c, d, b]), np.stack([d, c, a])
        area = signed_areas(nodes, np.hstack([one, two])).reshape(2, -1)
        convex = np.min(area, axis=0) > LEAST_AREA * np.sum(area, axis=0)
        if allowed is not None:
            convex &= allowed(one) & allowed(two)
        left, right, one, two = left[convex], right[convex], one[:, convex], two[:, convex]
        if left.size == 0:
            break
        new = worth(np.hstack([one, two]), np.concatenate([left, right])).reshape(2, -1)
        gain = value[left] + value[right] - new.sum(axis=0)
        chosen = _independent(gain, left, right, t.shape[1], least_gain)
        if chosen.size == 0:
            break
        t[:, left[chosen]], t[:, right[chosen]] = one[:, chosen], two[:, chosen]
        value[left[chosen]], value[right[chosen]] = new[:, chosen]
        count, total = count + chosen.size, total + float(gain[chosen].sum())
    return Flipped(t, count, total)


def _interior_edges(t: Index, n: int, fixed_keys: Index) -> tuple[Index, Index, Index]:
    """Elements left and right of the edges that may be flipped, and their vertices (4, edges).

    These are the ends a and b, then the vertex left and the vertex right of the way from a to b.
    """
    a, b, opposite = t.ravel(), t[[1, 2, 0]].ravel(), t[[2, 0, 1]].ravel()
    key = np.minimum(a, b) * n + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    pair = pair[~np.isin(key[order[pair]], fixed_keys)]
    one, two = order[pair], order[pair + 1]
    return one % t.shape[1], two % t.shape[1], np.stack([a[one], b[one], opposite[one], opposite[two]])


def _independent(gain: Array, left: Index, right: Index, n: int, least: float) -> Index:
    """Flips that gain, each more than any other that shares a triangle with it; the first of equals."""
    best, rank = np.full(n, -np.inf), np.full(n, gain.size)
    for side in (left, right):
        np.maximum.at(best, side, gain)
    number = np.flatnonzero((gain >= best[left]) & (gain >= best[right]) & (gain > least))
    for side in (left, right):
        np.minimum.at(rank, side[number], number)
    return number[(rank[left[number]] == number) & (rank[right[number]] == number)]


def sum_of_cotangents(nodes: Array, triangles: NDArray, _: NDArray | None = None) -> Array:
    """A worth by which flips make a mesh Delaunay: the sum of the cotangents of the angles.

    In a triangle it is ``(sum of squared edges) / (4 area)``; the Delaunay mesh has the least total
    (O. R. Musin, Properties of the Delaunay triangulation, SoCG 1997).
    """
    corner = nodes[:, triangles]
    edges = np.sum((corner - np.roll(corner, 1, axis=1)) ** 2, axis=(0, 1))
    return np.asarray(edges / (4 * np.maximum(signed_areas(nodes, triangles), 1e-300)))
