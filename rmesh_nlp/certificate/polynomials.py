"""Moments of polynomials against those of Bernstein, and the polynomials with given moments.

A moment is an integral over an edge or a triangle, divided by its measure. Functions are numbered as in
:mod:`rmesh_nlp.fem.bernstein`, those of vertices first, and run over the last axis but one of all arrays; the
last one runs over edges or triangles.
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import SIDES

DENOMINATORS = {2: {2: 6, 3: 12, 4: 30}, 3: {2: 12, 3: 30, 4: 90}}
"""Of the means of products of two functions, by the number of vertices and the sum of the degrees."""


def moments(coefficients: Array, degree: int, vertices: int = 2) -> Array:
    """(..., functions of the degree, cells) moments of polynomials with coefficients (..., any, cells)."""
    order = degree_of(coefficients, vertices)
    if (degree, order, vertices) == (1, 1, 3):  # with fewer roundings
        return np.asarray((coefficients + coefficients.sum(axis=-2, keepdims=True)) / 12)
    return np.asarray(_mass(degree, order, vertices) @ coefficients / DENOMINATORS[vertices][degree + order])


def projection(given: Array, vertices: int = 2) -> Array:
    """(..., functions, cells) coefficients of the polynomials with these moments: the L2 projection."""
    degree = degree_of(given, vertices)
    if (degree, vertices) == (1, 3):  # with fewer roundings
        return np.asarray(12 * given - 3 * given.sum(axis=-2, keepdims=True))
    return np.asarray(_from_moments(degree, vertices) @ given)


def lowered(given: Array, degree: int, vertices: int = 2) -> Array:
    """Moments against the functions of a degree, by those of the same or a higher one."""
    if degree_of(given, vertices) == degree:
        return given
    return np.asarray(elevation(vertices).T @ given)


def degree_of(given: Array, vertices: int) -> int:
    """Degree, 1 or 2, of polynomials by the number of their coefficients."""
    return 1 if given.shape[-2] == vertices else 2


@lru_cache
def elevation(vertices: int) -> Array:
    """(functions of degree 2, vertices) coefficients of degree 2 of the linear functions.

    They are their values at vertices and middles of edges.
    """
    corners = np.eye(vertices)
    return np.vstack([corners, *((corners[a] + corners[b]) / 2 for a, b in SIDES[vertices])])


@lru_cache
def _mass(degree: int, other: int, vertices: int) -> Array:
    """Means of products of the functions of two degrees, times their denominator: whole numbers."""
    dimension = vertices - 1

    def mean(first: Array, second: Array) -> float:
        integral = factorial(dimension) * _product(first + second) / factorial(degree + other + dimension)
        return factorial(degree) * factorial(other) / (_product(first) * _product(second)) * integral

    table = [[mean(a, b) for b in _powers(other, vertices)] for a in _powers(degree, vertices)]
    return np.rint(np.array(table) * DENOMINATORS[vertices][degree + other])


def _powers(degree: int, vertices: int) -> Array:
    """(functions, vertices) powers of the barycentric coordinates."""
    return np.asarray(degree * (np.eye(vertices) if degree == 1 else elevation(vertices)), dtype=int)


def _product(powers: Array) -> int:
    return int(np.prod([factorial(int(power)) for power in powers]))


@lru_cache
def _from_moments(degree: int, vertices: int) -> Array:
    """Inverse of the matrix of means of products, whole numbers too."""
    return np.rint(np.linalg.inv(_mass(degree, degree, vertices)) * DENOMINATORS[vertices][2 * degree])
