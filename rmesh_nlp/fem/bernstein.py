"""Bernstein's polynomials on edges and triangles: the shape functions of displacements of order 1 and 2.

With barycentric coordinates ``l_i`` they are the ``l_i`` themselves, and of order 2 ``l_i^2`` at vertices and
``2 l_i l_j`` at edges. They are nowhere negative and add up to one, so that a polynomial is nowhere below its
least coefficient: gaps whose coefficients are not negative hold along whole edges. Values at middles of edges
do not have that property.

Coefficients at vertices are the values there; that of an edge ab with the middle m is

    c_m = 2 u(m) - (u(a) + u(b)) / 2.

(G. Farin, Triangular Bernstein-Bezier patches, Comput. Aided Geom. Design 3 (1986) 83-127.)
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array

SIDES: dict[int, tuple[tuple[int, int], ...]] = {1: (), 2: ((0, 1),), 3: ((0, 1), (1, 2), (2, 0))}
"""Pairs of vertices of points, edges and triangles, in the order of the functions at edges."""


def size(order: int, vertices: int) -> int:
    """Number of functions on a point, an edge or a triangle with so many vertices."""
    return vertices + (len(SIDES[vertices]) if order == 2 else 0)


def functions(order: int, shares: Array) -> Array:
    """Values (functions, ...) at barycentric coordinates (vertices, ...): of vertices, then of edges."""
    if order == 1:
        return shares
    return np.stack([*(shares**2), *(2 * shares[a] * shares[b] for a, b in SIDES[len(shares)])])


def slopes(order: int, shares: Array) -> Array:
    """Derivatives (functions, vertices, ...) by the barycentric coordinates."""
    n = len(shares)
    result = np.zeros((size(order, n), n, *shares.shape[1:]))
    for i in range(n):
        result[i, i] = 1.0 if order == 1 else 2 * shares[i]
    if order == 2:
        for row, (a, b) in enumerate(SIDES[n], n):
            result[row, a], result[row, b] = 2 * shares[b], 2 * shares[a]
    return result


def to_coefficients(order: int, vertices: int) -> Array:
    """(functions, functions) matrix from values at vertices and middles of edges to the coefficients."""
    matrix = np.eye(size(order, vertices))
    if order == 2:
        for row, (a, b) in enumerate(SIDES[vertices], vertices):
            matrix[row, [a, b, row]] = -0.5, -0.5, 2.0
    return matrix
