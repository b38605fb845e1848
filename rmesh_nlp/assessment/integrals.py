"""Integrals over triangles and edges of a body, by rules that are refined until two agree.

A cell is a part of a triangle, in the coordinates (r, s) of its apex, or a part of an edge. On each one
Gauss's rules of two orders are compared; cells on which they differ are cut.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.body import Body

Index = NDArray[np.int64]

Integrand = Callable[[Index, Array, Array], Array]
"""``(elements (m,), barycentric (3, m, k), points (2, m, k)) -> values (rows, m, k)``."""

EdgeIntegrand = Callable[[Index, Array, Array], Array]
"""``(edges (m,), s (m, k), points (2, m, k)) -> values (rows, m, k)``."""

EdgePoints = Callable[[Index, Array], tuple[Array, Array]]
"""``(edges (m,), s (m, k)) -> points (2, m, k) and lengths per unit of s (m, k)``."""

LOW, HIGH = 6, 10
"""Gauss points per direction of the rules that are compared: degrees 10 and 18 on a triangle."""

AGREEMENT = 1e-9
"""Largest difference of two rules on a cell, in parts of the sum of the sizes of all cells."""

DEPTH = 8
"""Times that a cell may be halved in each direction."""

CHUNK = 100_000
"""Points that are evaluated at once."""


def over_triangles(
    body: Body, elements: Index, integrand: Integrand, points: int | None = None
) -> tuple[Array, Array]:
    """Integrals (rows, elements) over triangles, and what they may be wrong by.

    Parameters
    ----------
    body : Body
    elements : (n,) int array
    integrand : Integrand
    points : int, optional
        Gauss points per direction that are known to suffice; by default two rules are compared.
    """

    def on_cells(owner: Index, low: Array, width: Array, order: int) -> Array:
        x, w = gauss(order)
        r = low[0, :, None] + width[:, None] * np.repeat(x, order)
        s = low[1, :, None] + width[:, None] * np.tile(x, order)
        weights = np.outer(width**2, np.repeat(w, order) * np.tile(w, order)) * r
        element = elements[owner]
        barycentric = np.empty((3, *r.shape))
        apex, every = body.apex[element], np.arange(element.size)
        for turn, part in enumerate((1 - r, r * (1 - s), r * s)):
            barycentric[(apex + turn) % 3, every] = part
        where, det = body.points(element, barycentric)
        return np.einsum("amk,mk->am", integrand(element, barycentric, where), weights * det)

    return _adaptive(on_cells, elements.size, 2, points)


def over_edges(at: EdgePoints, size: int, integrand: EdgeIntegrand) -> tuple[Array, Array]:
    """Integrals (rows, edges) along edges, and what they may be wrong by."""

    def on_cells(owner: Index, low: Array, width: Array, order: int) -> Array:
        x, w = gauss(order)
        s = low[0, :, None] + np.outer(width, x)
        where, speed = at(owner, s)
        return np.einsum("amk,mk->am", integrand(owner, s, where), np.outer(width, w) * speed)

    return _adaptive(on_cells, size, 1, None)


def _adaptive(
    on_cells: Callable[[Index, Array, Array, int], Array], size: int, directions: int, points: int | None
) -> tuple[Array, Array]:
    """The sums over the cells of each of ``size`` owners, which begin as one unit cell each, and doubts."""
    owner, low, width = np.arange(size), np.zeros((directions, size)), np.ones(size)
    if size == 0:
        return np.zeros((1, 0)), np.zeros((1, 0))
    total: Array | None = None
    for depth in range(DEPTH + 1):
        fine = _in_chunks(on_cells, owner, low, width, points or HIGH, directions)
        if total is None:
            total, doubt = np.zeros((2, fine.shape[0], size))
        split, wrong = np.zeros(owner.size, dtype=bool), np.zeros(fine.shape)
        if points is None:
            wrong = np.abs(fine - _in_chunks(on_cells, owner, low, width, LOW, directions))
            if depth == 0:
                scale = np.sum(np.abs(fine), axis=1, keepdims=True)
            if depth < DEPTH:
                split = np.any(wrong > AGREEMENT * scale, axis=0)
        for sums, parts in ((total, fine), (doubt, wrong)):
            for row, values in zip(sums, parts, strict=True):
                row += np.bincount(owner[~split], values[~split], size)
        if not np.any(split):
            break
        owner, low, width = owner[split], low[:, split], width[split] / 2
        corners = np.stack(np.meshgrid(*([(0, 1)] * directions), indexing="ij")).reshape(directions, -1)
        low = (low[:, None] + corners[:, :, None] * width).reshape(directions, -1)
        owner, width = np.tile(owner, 2**directions), np.tile(width, 2**directions)
    assert total is not None
    return total, doubt


def _in_chunks(
    on_cells: Callable[[Index, Array, Array, int], Array],
    owner: Index,
    low: Array,
    width: Array,
    order: int,
    directions: int,
) -> Array:
    step = max(1, CHUNK // order**directions)
    parts = [
        on_cells(owner[i : i + step], low[:, i : i + step], width[i : i + step], order)
        for i in range(0, owner.size, step)
    ]
    return np.hstack(parts)


def gauss(points: int) -> tuple[Array, Array]:
    """Points and weights of Gauss's rule on (0, 1)."""
    x, w = np.polynomial.legendre.leggauss(points)
    return (1 + x) / 2, w / 2
