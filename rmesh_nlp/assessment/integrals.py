"""Integrals over triangles and edges of a body, by rules that are refined until two agree.

A cell is a part of a triangle, in the coordinates (r, s) of its apex, or a part of an edge. On each one
Gauss's rules of two orders are compared. Where they differ higher orders are tried, then the cell is cut.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.body import Body

Index = NDArray[np.int64]

Integrand = Callable[[Index, Array, Array], Array]
"""``(elements (m,), barycentric (3, m, k), points (2, m, k)) -> values (rows, m, k)``; on edges s (m, k) in
the place of barycentric coordinates."""

EdgePoints = Callable[[Index, Array], tuple[Array, Array]]
"""``(edges (m,), s (m, k)) -> points (2, m, k) and lengths per unit of s (m, k)``."""

OnCells = Callable[[Index, Array, Array, int], Array]
"""``(owners (m,), low (directions, m), width (m,), order) -> integrals (rows, m)``."""

FIRST, SECOND, CUT = (4, 6), (6, 10), (4, 6)
"""Gauss points per direction of the rules that are compared: of all cells, of those where these differ, and
of the parts of those where these differ too, beside kinks. (k, l) is of degrees 2 k - 2 and 2 l - 2 on a
triangle. (6, 10) for all takes twice as long on Example 6.1 (n = 64) and agrees to 3e-10. Of 60 bumps a
fiftieth of an edge wide it misses one, these two, and (3, 5) in the first place nine."""

AGREEMENT = 1e-9
"""Largest difference of two rules on a cell, in parts of the sum of the sizes of all cells."""

DEPTH = 9
"""Last stage: times that a cell may be halved in each direction, and one."""

CHUNK = 100_000
"""Points that are evaluated at once."""


def over_triangles(
    body: Body, elements: Index, integrand: Integrand, points: int | None = None
) -> tuple[Array, Array]:
    """Integrals (rows, elements) over triangles, and what they may be wrong by.

    ``points`` is the number of Gauss points per direction that is known to suffice; by default two rules are
    compared.
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


def over_edges(at: EdgePoints, size: int, integrand: Integrand) -> tuple[Array, Array]:
    """Integrals (rows, edges) along edges, and what they may be wrong by."""

    def on_cells(owner: Index, low: Array, width: Array, order: int) -> Array:
        x, w = gauss(order)
        s = low[0, :, None] + np.outer(width, x)
        where, speed = at(owner, s)
        return np.einsum("amk,mk->am", integrand(owner, s, where), np.outer(width, w) * speed)

    return _adaptive(on_cells, size, 1, None)


def _adaptive(on_cells: OnCells, size: int, directions: int, points: int | None) -> tuple[Array, Array]:
    """The sums over the cells of each of ``size`` owners, which begin as one unit cell each, and doubts."""
    total, doubt = np.zeros((2, 1, size))
    if size == 0:
        return total, doubt
    owner, low, width = np.arange(size), np.zeros((directions, size)), np.ones(size)
    corners = np.stack(np.meshgrid(*([(0, 1)] * directions), indexing="ij")).reshape(directions, -1, 1)
    for depth in range(DEPTH + 1):
        lower, higher = (FIRST, SECOND, CUT)[min(depth, 2)]
        fine, wrong = _in_chunks(on_cells, owner, low, width, points or higher), np.zeros(1)
        if points is None:
            wrong = np.abs(fine - _in_chunks(on_cells, owner, low, width, lower))
        if depth == 0:
            scale = np.sum(np.abs(fine), axis=1, keepdims=True)
        wrong = np.broadcast_to(wrong, fine.shape)
        split = np.any(wrong > AGREEMENT * scale, axis=0) & (depth < DEPTH)
        total, doubt = (
            sums + np.array([np.bincount(owner[~split], row[~split], size) for row in parts])
            for sums, parts in ((total, fine), (doubt, wrong))
        )
        if not np.any(split):
            break
        if depth == 0:
            owner, low, width = owner[split], low[:, split], width[split]
            continue
        width = width[split] / 2
        low = (low[:, None, split] + corners * width).reshape(directions, -1)
        owner, width = np.tile(owner[split], 2**directions), np.tile(width, 2**directions)
    return total, doubt


def _in_chunks(on_cells: OnCells, owner: Index, low: Array, width: Array, order: int) -> Array:
    step = max(1, CHUNK // order ** len(low))
    parts = [slice(i, i + step) for i in range(0, owner.size, step)]
    return np.hstack([on_cells(owner[part], low[:, part], width[part], order) for part in parts])


@lru_cache
def gauss(points: int) -> tuple[Array, Array]:
    """Points and weights of Gauss's rule on (0, 1); not to be written to."""
    x, w = np.polynomial.legendre.leggauss(points)
    return (1 + x) / 2, w / 2
