"""Quadrature rules for loads: which one a load needs, and their points."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.special import roots_jacobi
from skfem.quadrature import get_quadrature_line, get_quadrature_tri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, PiecewiseLinear, at, once

TRACTION_DEGREE = 4
"""Least degree of the Gauss rule for tractions, exact for cubic ones times P1 and quadratic ones times P2; a
higher one of the load is taken for tractions too."""

MIDPOINT = "midpoint"
"""The three edge midpoints, exact to degree 2."""

HIGH = 8
"""Degree for loads that are no polynomials. Of random problems with loads such as 4 sin(3 x) + x y none of
those solved with degree 6 had a gain that the audit did not confirm to 10 %; 8 is for faster
oscillations."""

LARGEST_EXPRESSION = 5_000
"""Operations in a derivative beyond which it is not looked at further."""


def suitable_rule(
    loads: Sequence[Coefficient], tractions: Sequence[Coefficient], order: int = 1
) -> str | int:
    """The cheapest rule that is exact for these loads times functions of an order, or ``HIGH``.

    Tractions are integrated with ``TRACTION_DEGREE`` at least, whatever the rule.
    """
    degrees = [[polynomial_degree(part) for part in parts] for parts in (loads, tractions)]
    if None in [*degrees[0], *degrees[1]]:
        return HIGH
    body, edge = (max((d + order for d in part if d is not None), default=0) for part in degrees)
    needed = max(body, edge if edge > TRACTION_DEGREE else 0)
    return MIDPOINT if needed <= 2 else needed


@once
def polynomial_degree(coefficient: Coefficient) -> int | None:
    """Degree in x and y together; None if it is no polynomial up to ``HIGH - 1``, where that is exact."""
    if not callable(coefficient):
        return 0
    if isinstance(coefficient, PiecewiseLinear):
        return 1 if not coefficient.kinks else None
    point = ca.SX.sym("point", 2)
    try:
        derivatives = ca.SX(at(coefficient, point[0], point[1]))
    except (NotImplementedError, RuntimeError, TypeError, ValueError):
        return None  # a function of MX alone, or one that the assembly refuses with a reason
    for degree in range(HIGH):
        if ca.Function("count", [point], [derivatives], OPEN).n_nodes() > LARGEST_EXPRESSION:
            return None
        highest = derivatives
        derivatives = ca.sparsify(ca.simplify(ca.vec(ca.jacobian(derivatives, point))))
        derivatives = ca.vertcat(*{hash(e): e for e in ca.vertsplit(derivatives) if e.nnz()}.values())
        if derivatives.shape[0] == 0:
            # that of a branch, such as |x|, depends on the point by its condition
            return None if ca.depends_on(highest, point) else degree
    return None


def traction_degree(rule: str | int) -> int:
    """Degree of the Gauss rule for tractions beside a rule for other loads."""
    return TRACTION_DEGREE if isinstance(rule, str) else max(rule, TRACTION_DEGREE)


def line_rule(degree: int) -> tuple[Array, Array]:
    """Gauss rule on an edge: barycentric coordinates (2, points) and weights (points,), summing to 1."""
    points, weights = get_quadrature_line(degree)
    return np.vstack([1 - points.ravel(), points.ravel()]), weights


def triangle_rule(quadrature: str | int) -> tuple[Array, Array]:
    """Barycentric coordinates (3, points) and weights (points,), summing to 1.

    "midpoint" is the three edge midpoints, exact to degree 2; a number asks for that degree.
    """
    if quadrature == MIDPOINT:
        return (np.ones((3, 3)) - np.eye(3)) / 2, np.full(3, 1 / 3)
    assert isinstance(quadrature, int)
    if quadrature <= 19:  # the highest degree of scikit-fem's
        points, weights = get_quadrature_tri(quadrature)
    else:
        points, weights = _conical_product_rule(quadrature)
    return np.vstack([1 - points.sum(axis=0), points]), 2 * weights


def _conical_product_rule(degree: int) -> tuple[Array, Array]:
    """Gauss-Jacobi times Gauss-Legendre on the reference triangle, for any degree (Stroud 1971)."""
    n = degree // 2 + 1
    r, weight_r = roots_jacobi(n, 1, 0)
    s, weight_s = roots_jacobi(n, 0, 0)
    x, z = (1 + r) / 2, (1 + s) / 2
    points = np.vstack([np.repeat(x, n), np.outer(1 - x, z).ravel()])
    return points, np.outer(weight_r / 4, weight_s / 2).ravel()
