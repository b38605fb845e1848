"""Quadrature rules for loads: which one a load needs, and their points."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.special import roots_jacobi
from skfem.quadrature import get_quadrature_line, get_quadrature_tri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.switches import affine_switches, degree_of_pieces, polynomial_degree, switches

TRACTION_DEGREE = 4
"""Least degree of the Gauss rule for tractions, exact for cubic ones times P1 and quadratic ones times P2; a
higher one of the load is taken for tractions too."""

MIDPOINT = "midpoint"
"""The three edge midpoints, exact to degree 2."""

CORNER = "corner"
"""Of functions that are rational in the distance from the second corner, as u_r^2 / r with r = 0 there."""

MOST_POINTS = 400
"""A cell is left whole where rules on the pieces between jumps of its load would have more points."""


def exact_rule(
    loads: Sequence[Coefficient], tractions: Sequence[Coefficient], order: int = 1
) -> str | int | None:
    """The cheapest rule that is exact for these loads times functions of an order; None if none is.

    Tractions are integrated with ``TRACTION_DEGREE`` at least, whatever the rule.
    """
    degrees = [[_degree(part) for part in parts] for parts in (loads, tractions)]
    if None in [*degrees[0], *degrees[1]]:
        return None
    body, edge = (max((d + order for d in part if d is not None), default=0) for part in degrees)
    needed = max(body, edge if edge > TRACTION_DEGREE else 0)
    # points on the sides of a triangle are of no use where it is split
    rule = MIDPOINT if needed <= 2 and not affine_switches(loads) else needed
    are_split = is_split(loads, rule, 3) and is_split(tractions, traction_degree(rule), 2)
    return rule if are_split else None


def _degree(coefficient: Coefficient) -> int | None:
    """Of the pieces of a coefficient between affine switches."""
    degree = degree_of_pieces(coefficient)
    switching = None if degree is None else switches(coefficient)
    is_affine = switching is None or set(map(polynomial_degree, switching.functions)) == {1}
    return degree if is_affine else None


def is_split(coefficients: Sequence[Coefficient], rule: str | int, corners: int) -> bool:
    """Whether cells with so many corners are split at all affine switches of coefficients."""
    number = len(affine_switches(coefficients))
    points = (triangle_rule(rule) if corners == 3 else line_rule(traction_degree(rule)))[1]
    return number == 0 or (2 if corners == 2 else 4) ** number * points.size <= MOST_POINTS


def traction_degree(rule: str | int) -> int:
    """Degree of the Gauss rule for tractions beside a rule for other loads."""
    return TRACTION_DEGREE if isinstance(rule, str) else max(rule, TRACTION_DEGREE)


@lru_cache
def line_rule(degree: int) -> tuple[Array, Array]:
    """Gauss rule on an edge: barycentric coordinates (2, points) and weights (points,), summing to 1.

    Not to be written to, as of triangles.
    """
    points, weights = get_quadrature_line(degree)
    return np.vstack([1 - points.ravel(), points.ravel()]), weights


@lru_cache
def triangle_rule(quadrature: str | int) -> tuple[Array, Array]:
    """Barycentric coordinates (3, points) and weights (points,), summing to 1.

    "midpoint" is the three edge midpoints, exact to degree 2; a number asks for that degree; "corner" has
    degree 10, also times powers of the distance from the second corner.
    """
    if quadrature == MIDPOINT:
        return (np.ones((3, 3)) - np.eye(3)) / 2, np.full(3, 1 / 3)
    if quadrature in (0, 1):  # where scikit-fem's has three points
        return np.full((3, 1), 1 / 3), np.ones(1)
    degree = 10 if quadrature == CORNER else int(quadrature)
    conical = quadrature == CORNER or degree > 19  # the highest degree of scikit-fem's
    points, weights = (_conical_product_rule if conical else get_quadrature_tri)(degree)
    return np.vstack([1 - points.sum(axis=0), points]), 2 * weights


def _conical_product_rule(degree: int) -> tuple[Array, Array]:
    """Gauss-Jacobi times Gauss-Legendre on the reference triangle, for any degree (Stroud 1971)."""
    n = degree // 2 + 1
    r, weight_r = roots_jacobi(n, 1, 0)
    s, weight_s = roots_jacobi(n, 0, 0)
    x, z = (1 + r) / 2, (1 + s) / 2
    points = np.vstack([np.repeat(x, n), np.outer(1 - x, z).ravel()])
    return points, np.outer(weight_r / 4, weight_s / 2).ravel()
