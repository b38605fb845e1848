"""Bernstein's polynomials of any degree: derivatives, moments, and the polynomials with given moments.

A moment is an integral over an edge or a triangle, divided by its measure. Functions of degree 1 and 2 are
numbered as in :mod:`rmesh_nlp.fem.bernstein`, those of vertices first, and run over the last axis but one of
all arrays; the last one runs over edges or triangles.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import comb, factorial

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.bernstein import SIDES


@lru_cache
def powers(degree: int, vertices: int) -> Index:
    """(functions, vertices) powers of the barycentric coordinates."""
    corners = np.eye(vertices, dtype=np.int64)
    if degree == 0:
        return 0 * corners[:1]
    if degree <= 2:
        sides = [corners[a] + corners[b] for a, b in SIDES[vertices]] if degree == 2 else []
        return np.vstack([degree * corners, *sides])
    every = powers(degree - 1, vertices)[:, None] + corners
    return np.unique(every.reshape(-1, vertices), axis=0)


def bernstein(degree: int, shares: Array) -> Array:
    """(functions, points) values of the functions of any degree at barycentric coordinates (3, points)."""
    each = powers(degree, len(shares))
    ways = factorial(degree) / np.prod(factorial(each), axis=1, keepdims=True)
    return ways * np.prod(shares ** each[:, :, None], axis=1)


@lru_cache
def raised(degree: int, vertices: int) -> Index:
    """(functions of the degree below, vertices) the function with one more power of a coordinate.

    The derivative by this coordinate has the coefficients of these functions times the degree.
    """
    number = {tuple(power): i for i, power in enumerate(powers(degree, vertices).tolist())}
    corners = np.eye(vertices, dtype=np.int64)
    below = powers(degree - 1, vertices)
    return np.array([[number[tuple(power)] for power in (row + corners).tolist()] for row in below])


@lru_cache
def elevation(degree: int, vertices: int) -> Array:
    """(functions, functions of the degree below) coefficients of the polynomials of the degree below."""
    below = powers(degree - 1, vertices)
    matrix = np.zeros((len(powers(degree, vertices)), len(below)))
    matrix[raised(degree, vertices), np.arange(len(below))[:, None]] = (below + 1) / degree
    return matrix


@lru_cache
def mass(degree: int, vertices: int) -> Array:
    """Means of products of two functions."""
    each, sides = powers(degree, vertices), vertices - 1
    ways = np.prod(comb(each[:, None] + each, each), axis=2)
    return ways / (comb(2 * degree, degree) * comb(2 * degree + sides, sides))


def moments(coefficients: Array, vertices: int = 2) -> Array:
    """(..., functions, cells) moments of polynomials with these coefficients."""
    return mass(degree_of(coefficients, vertices), vertices) @ coefficients


def projection(given: Array, vertices: int) -> Array:
    """(..., functions, cells) coefficients of the polynomials with these moments: the L2 projection."""
    degree = degree_of(given, vertices)
    if (degree, vertices) == (1, 3):  # with fewer roundings: the remainder of a load is the root of theirs
        return 12 * given - 3 * given.sum(axis=-2, keepdims=True)
    whole = np.rint(np.linalg.inv(mass(degree, vertices)))  # the inverse has whole numbers
    return whole @ given


def degree_of(given: Array, vertices: int) -> int:
    """Degree, 1 or 2, of polynomials by the number of their coefficients."""
    return 1 if given.shape[-2] == vertices else 2
