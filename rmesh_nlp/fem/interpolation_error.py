"""Error of linear interpolation on a triangle, in the energy of a law, from second derivatives.

Let u be quadratic with second derivatives H, and e_i the edge opposite to vertex i of a triangle. At the
midpoint of e_i the gradient of the interpolation error is ``(e_j' H e_k) / 2 * grad(lambda_i)`` up to its
sign, with j and k the other two vertices. The energy is quadratic in it, so that the rule of the three
midpoints is exact. With ``g = grad(lambda_i)`` the energy density of a gradient ``w g'`` is
``kappa w^2 |g|^2 / 2`` for the scalar law, and ``((lambda + mu) (w.g)^2 + mu |w|^2 |g|^2) / 2`` for isotropic
elasticity.

The error of a triangle of area A is ``phi(shape, H) A^2``. So N triangles of the best shapes have the least
error, ``(integral of sqrt(phi))^2 / N``, where their number per area is proportional to ``sqrt(phi)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.laws import Elastic, Law

EQUILATERAL = np.array([[1.0, -0.5, -0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]]) / (27 / 16) ** 0.25
"""(2, 3) vertices of an equilateral triangle of area 1."""

LARGEST_ASPECT = 64.0
"""Of the shapes that are looked for."""

TURNS = (0.0, np.pi / 6)
"""Turns of an equilateral triangle. Its error varies with them like cos(6 turn): the mean over these two is
that over all."""

STEPS, HALVINGS = (0.4, 0.35, np.pi / 9), 7
"""First steps of stretch, angle and turn in the search for the best shapes, and how often they are halved."""


def errors(law: Law, triangles: Any, second: Any) -> Any:
    """(n,) errors in the energy on triangles (2, 3, n), counter-clockwise.

    ``second`` (components, 3, n) are the derivatives xx, xy and yy of each component of the displacement. Of
    nested lists of CasADi symbols the error is an expression.
    """
    (x, y), total = triangles, 0.0
    edges = [(x[i - 1] - x[i - 2], y[i - 1] - y[i - 2]) for i in range(3)]
    area = (edges[0][0] * edges[1][1] - edges[0][1] * edges[1][0]) / 2
    for i in range(3):
        (ax, ay), (bx, by), (cx, cy) = edges[i - 1], edges[i - 2], edges[i]
        w = [xx * ax * bx + xy * (ax * by + ay * bx) + yy * ay * by for xx, xy, yy in second]
        size = sum(one**2 for one in w) * (cx**2 + cy**2)  # the gradient of lambda_i is (-cy, cx) / (2 area)
        if isinstance(law, Elastic):
            total += law.lame_mu * size + (law.in_plane_lambda + law.lame_mu) * (w[1] * cx - w[0] * cy) ** 2
        else:
            total += law.conductivity * size
    return total / (96 * area)  # area / 3 * 1/4 * 1/2 / (2 area)^2


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
    law: Law, second: Array, largest_aspect: float = LARGEST_ASPECT
) -> tuple[Array, Array, Array]:
    """Stretch and angle (n,) of the best triangles equilateral in a metric, and their errors ``phi``.

    The errors are means over all turns, which remeshing leaves to chance.
    """
    xx, xy, yy = _squares(second)
    angle = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2  # long where the second derivatives are small
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    ratio = np.sqrt(np.maximum(mean - spread, 0.0) / np.maximum(mean + spread, 1e-300))
    stretch = np.minimum(-np.log(np.maximum(ratio, 1e-8)) / 4, np.log(largest_aspect) / 2)
    stretch[mean == 0] = 0.0  # no second derivatives: all shapes are as good

    def value(point: Array) -> Array:
        return np.mean([errors(law, stretched(point[0], point[1], turn), second) for turn in TURNS], axis=0)

    (stretch, angle), found = _descended(value, np.stack([stretch, angle]), largest_aspect)
    return stretch, angle, found


def least_errors(law: Law, second: Array, stretch: Array, angle: Array) -> Array:
    """(n,) errors ``phi`` of the best triangles of area 1 whatsoever, as in a lattice made for ``second``.

    They are looked for around those of :func:`best_shapes`, which have ``stretch`` and ``angle``.
    """

    def value(point: Array) -> Array:
        return errors(law, stretched(point[0], point[1], point[2]), second)

    starts = [
        np.stack([stretch + more, angle + off, np.full(angle.size, turn)])
        for turn in TURNS
        for more in (0.0, np.log(3) / 4)  # of an equilateral triangle it makes a right one
        for off in (0.0, np.pi / 4, np.pi / 2)
    ]
    second = np.tile(second, len(starts))
    _, found = _descended(value, np.hstack(starts), LARGEST_ASPECT, repeats=2)
    return np.asarray(found.reshape(len(starts), -1).min(axis=0))


def isotropic_errors(law: Law, second: Array) -> Array:
    """(n,) errors ``phi`` of equilateral triangles of area 1, which local refinement tends to at best."""
    zero = np.zeros(second.shape[2])
    return np.mean([errors(law, stretched(zero, zero, turn), second) for turn in TURNS], axis=0)


def _squares(second: Array) -> tuple[Array, Array, Array]:
    """Entries of the sum of the squares of the matrices of all components."""
    a, b, c = second[:, 0], second[:, 1], second[:, 2]
    return np.sum(a**2 + b**2, axis=0), np.sum(b * (a + c), axis=0), np.sum(b**2 + c**2, axis=0)


def _descended(
    value: Callable[[Array], Array], point: Array, largest_aspect: float, repeats: int = 1
) -> tuple[Array, Array]:
    """Pattern searches from many points (variables, n) at once: the ends, and the values (n,) there."""
    found, most = value(point), np.log(largest_aspect) / 2
    for halving in np.repeat(np.arange(HALVINGS), repeats):
        for variable, step in enumerate(STEPS[: len(point)]):
            for sign in (1, -1):
                tried = np.array(point)
                tried[variable] += sign * step * 0.5**halving
                tried[0] = np.clip(tried[0], 0.0, most)
                there = value(tried)
                lower = there < found
                point, found = np.where(lower, tried, point), np.where(lower, there, found)
    return point, found
