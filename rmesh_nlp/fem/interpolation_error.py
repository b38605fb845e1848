"""Error of interpolation on a triangle, in the energy of a law, from derivatives of the displacement.

Let u be quadratic with second derivatives H, and e_i the edge opposite to vertex i of a triangle. At the
midpoint of e_i the gradient of the interpolation error is ``(e_j' H e_k) / 2 * grad(lambda_i)`` up to its
sign, with j and k the other two vertices. The energy is quadratic in it, so that the rule of the three
midpoints is exact. With ``g = grad(lambda_i)`` the energy density of a gradient ``w g'`` is
``kappa w^2 |g|^2 / 2`` for the scalar law, and ``((lambda + mu) (w.g)^2 + mu |w|^2 |g|^2) / 2`` for isotropic
elasticity.

Of a body of revolution that is multiplied by the measure; the error of the hoop strain is h / r times less.

Let u be cubic with third derivatives D instead, and interpolated by a quadratic polynomial. The error
vanishes at vertices and middles of edges: on the edge e_i it is ``D(e_i, e_i, e_i) / 12`` times the bubble
``lambda_j lambda_k (lambda_j - lambda_k)``, and ``lambda_0 lambda_1 lambda_2`` has a coefficient of its own.

The error of a triangle of area A is ``phi(shape, derivatives) A^(k + 1)`` with the order k of interpolation.
So N triangles of the best shapes have the least error, ``(integral of phi^(1 / (k + 1)))^(k + 1) / N^k``,
where their number per area is proportional to ``phi^(1 / (k + 1))``.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import comb

import numpy as np

from rmesh_nlp.evaluation import Array, Expression, cross
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.quadrature import triangle_rule

EQUILATERAL = np.array([[1.0, -0.5, -0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]]) / (27 / 16) ** 0.25
"""(2, 3) vertices of an equilateral triangle of area 1."""

LARGEST_ASPECT = 64.0
"""Of the shapes that are looked for."""

TURNS = (0.0, np.pi / 6)
"""Turns of an equilateral triangle. Its error varies with them like cos(6 turn): the mean over these two is
that over all."""

STEPS, HALVINGS = (0.4, 0.35, np.pi / 9), 7
"""First steps of stretch, angle and turn in the search for the best shapes, and how often they are halved."""


def errors(law: Law, triangles: Expression, derivatives: Expression) -> Expression:
    """(n,) errors in the energy on triangles (2, 3, n), counter-clockwise.

    ``derivatives`` of each component of the displacement, constant on a triangle: (components, 3, n) xx, xy
    and yy for linear interpolation, (components, 4, n) xxx, xxy, xyy and yyy for quadratic. Of nested lists
    of CasADi symbols the error is an expression.
    """
    return (_of_linear if len(derivatives[0]) == 3 else _of_quadratic)(law, triangles, derivatives)


def _edges(triangles: Expression) -> tuple[list[Expression], Expression]:
    """Edges from vertex i + 1 to i + 2, and twice the area."""
    x, y = triangles
    edges = [(x[i - 1] - x[i - 2], y[i - 1] - y[i - 2]) for i in range(3)]
    return edges, cross(edges[0], edges[1])


def _of_linear(law: Law, triangles: Expression, second: Expression) -> Expression:
    (edges, double), total = _edges(triangles), 0.0
    for i in range(3):
        cx, cy = edges[i]
        w = [_along(H, edges[i - 1], edges[i - 2]) for H in second]
        # the gradient of lambda_i is (-cy, cx) / (2 area)
        total += law.energy_product([[-wi * cy, wi * cx] for wi in w])
    return total / (48 * double)  # area / 3 * 1/4 * 1/2 / (2 area)^2


def _of_quadratic(law: Law, triangles: Expression, third: Expression) -> Expression:
    edges, double = _edges(triangles)
    bubbles = []
    for D in third:
        along = [_along(D, edge, edge, edge) / 12 for edge in edges]
        inner = 3 * along[2] + along[0] - along[1] + _along(D, edges[2], edges[2], edges[1]) / 2
        bubbles.append([*along, inner])
    total = 0.0
    for point, weight in enumerate(BUBBLE_WEIGHTS):
        slopes = []
        for bubble in bubbles:  # twice the area times the gradient of the error of each component
            by_lambda = [
                sum(BUBBLE_SLOPES[m, k, point] * value for m, value in enumerate(bubble)) for k in range(3)
            ]
            slopes.append(
                (
                    sum(-edge[1] * rate for edge, rate in zip(edges, by_lambda, strict=True)),
                    sum(edge[0] * rate for edge, rate in zip(edges, by_lambda, strict=True)),
                )
            )
        total += weight * law.energy_product(slopes)
    return total / (4 * double)  # area * 1/2 / (2 area)^2


def _along(D: Expression, *directions: tuple[Expression, Expression]) -> Expression:
    """The derivative xx, xy, yy or xxx, xxy, xyy, yyy in as many directions."""
    for x, y in directions:
        D = [x * by_x + y * by_y for by_x, by_y in pairwise(D)]
    return D[0]


def _bubble_slopes(shares: Array) -> Array:
    """(4 bubbles, 3, points) derivatives by the barycentric coordinates of those in the module's text."""
    zero, rows = np.zeros(shares.shape[1]), []
    for i in range(3):
        a, b = shares[i - 2], shares[i - 1]
        by = [zero] * 3
        by[i - 2], by[i - 1] = b * (2 * a - b), a * (a - 2 * b)
        rows.append(by)
    rows.append([shares[1] * shares[2], shares[2] * shares[0], shares[0] * shares[1]])
    return np.array(rows)


_POINTS, BUBBLE_WEIGHTS = triangle_rule(4)

BUBBLE_SLOPES = _bubble_slopes(_POINTS)
"""At the points of a rule that is exact for the energy, with weights that sum to one."""


def stretched(stretch: Array, angle: Array, turn: Array | float) -> Array:
    """(2, 3, n) triangles of area 1, ``exp(2 stretch)`` times as long along ``angle`` as across it.

    They are equilateral ones, turned and then stretched: equilateral still in a metric.
    """
    c, s = np.cos(turn - angle), np.sin(turn - angle)
    (x, y), long = EQUILATERAL[:, :, None], np.exp(stretch)
    along, across = long * (c * x - s * y), (s * x + c * y) / long
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([along * c - across * s, along * s + across * c])


def best_shapes(
    law: Law, derivatives: Array, largest_aspect: float = LARGEST_ASPECT
) -> tuple[Array, Array, Array]:
    """Stretch and angle (n,) of the best triangles equilateral in a metric, and their errors ``phi``.

    The errors are means over all turns, which remeshing leaves to chance.
    """
    (xx, xy, yy), degree = _squares(derivatives), derivatives.shape[1] - 1
    angle = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2  # long where the derivatives are small
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    ratio = np.sqrt(np.maximum(mean - spread, 0.0) / np.maximum(mean + spread, 1e-300))
    stretch = np.minimum(-np.log(np.maximum(ratio, 1e-8)) / (2 * degree), np.log(largest_aspect) / 2)
    stretch[mean == 0] = 0.0  # no derivatives: all shapes are as good

    def value(point: Array) -> Array:
        return np.mean(
            [errors(law, stretched(point[0], point[1], turn), derivatives) for turn in TURNS], axis=0
        )

    (stretch, angle), phi = _descended(value, np.stack([stretch, angle]), largest_aspect)
    return stretch, angle, phi


def least_errors(law: Law, derivatives: Array, stretch: Array, angle: Array) -> Array:
    """(n,) errors ``phi`` of the best triangles of area 1 whatsoever, as in a lattice.

    They are looked for around those of :func:`best_shapes`, which have ``stretch`` and ``angle``.
    """

    def value(point: Array) -> Array:
        return errors(law, stretched(point[0], point[1], point[2]), derivatives)

    starts = [
        np.stack([stretch + added, angle + off, np.full(angle.size, turn)])
        for turn in TURNS
        for added in (0.0, np.log(3) / 4)  # of an equilateral triangle it makes a right one
        for off in (0.0, np.pi / 4, np.pi / 2)
    ]
    derivatives = np.tile(derivatives, len(starts))
    _, phi = _descended(value, np.hstack(starts), LARGEST_ASPECT, repeats=2)
    return phi.reshape(len(starts), -1).min(axis=0)


def isotropic_errors(law: Law, derivatives: Array) -> Array:
    """(n,) errors ``phi`` of equilateral triangles of area 1, which local refinement tends to at best."""
    zero = np.zeros(derivatives.shape[2])
    return np.mean([errors(law, stretched(zero, zero, turn), derivatives) for turn in TURNS], axis=0)


def _squares(derivatives: Array) -> tuple[Array, Array, Array]:
    """Entries of the sum over i of the squares of the derivatives of du/dx_i, all components added up."""
    degree = derivatives.shape[1] - 1
    by_x, by_y = derivatives[:, :-1], derivatives[:, 1:]
    times = np.array([comb(degree - 1, k) for k in range(degree)])[:, None]
    pairs = (by_x, by_x), (by_x, by_y), (by_y, by_y)
    xx, xy, yy = (np.sum(times * first * second, axis=(0, 1)) for first, second in pairs)
    return xx, xy, yy


def _descended(
    value: Callable[[Array], Array], point: Array, largest_aspect: float, repeats: int = 1
) -> tuple[Array, Array]:
    """Pattern searches from many points (variables, n) at once: the ends, and the values (n,) there."""
    best, most = value(point), np.log(largest_aspect) / 2
    for halving in np.repeat(np.arange(HALVINGS), repeats):
        for variable, step in enumerate(STEPS[: len(point)]):
            for sign in (1, -1):
                tried = np.array(point)
                tried[variable] += sign * step * 0.5**halving
                tried[0] = np.clip(tried[0], 0.0, most)
                values = value(tried)
                lower = values < best
                point, best = np.where(lower, tried, point), np.where(lower, values, best)
    return point, best
