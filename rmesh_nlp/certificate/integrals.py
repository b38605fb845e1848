"""Integrals of coefficients against linear functions, with the doubt that quadrature leaves.

Constants are integrated exactly. Anything else is integrated by rules of increasing degree until two
of them agree, as for any polynomial, or there are none left, as for a coefficient that jumps
inside an element. The difference between the last two is the doubt.

x
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.vectorised import columnwise

TRIANGLE_DEGREES = (5, 8, 13, 20)
"""Degrees of the rules, tried in this order."""

EDGE_POINTS = (4, 6, 10, 31)
"""The same for edges, numbers of Gauss points."""

NEGLIGIBLE = 1e-6
"""Doubt relative to the integrals that needs no better rule."""


@dataclass(frozen=True)
class Integrals:
    """Moments of a coefficient f over simplices with barycentric coordinates phi_i.

    Attributes
    ----------
    moments : (vertices, simplices) array
        Integrals of f phi_i over the simplex, divided by its measure.
    square : (simplices,) array
        Mean of f^2.
    doubt : (vertices, simplices) array
        Difference of ``moments`` between two rules; zero for a constant.
    """

    moments: Array
    square: Array
    doubt: Array


def over_triangles(coefficient: Coefficient, corners: Array) -> Integrals:
    """Moments over triangles with ``corners`` (2, 3, triangles)."""
    return _integrals(coefficient, corners, TRIANGLE_DEGREES, triangle_rule)


def over_edges(coefficient: Coefficient, corners: Array) -> Integrals:
    """Moments over edges with ``corners`` (2, 2, edges)."""
    return _integrals(coefficient, corners, EDGE_POINTS, edge_rule)


def edge_rule(points: int) -> tuple[Array, Array]:
    """Barycentric coordinates (2, points) and weights of a Gauss rule, the weights summing to 1."""
    x, weights = np.polynomial.legendre.leggauss(points)
    return np.stack([1 - x, 1 + x]) / 2, weights / 2


def values_at(coefficient: Coefficient, corners: Array, barycentric: Array) -> Array:
    """Values (points, simplices) at points given by barycentric coordinates (vertices, points)."""
    shape = (barycentric.shape[1], corners.shape[-1])
    if not callable(coefficient):
        return np.full(shape, float(coefficient))
    where = np.einsum("cve,vp->cpe", corners, barycentric).reshape(2, 1, -1)
    if where.shape[-1] == 0:
        return np.zeros(shape)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function("coefficient", [x, y], [ca.densify(ca.SX(coefficient(x, y)))])
    return columnwise(function, where.shape[-1])(list(where))[0].reshape(shape)


def _integrals(
    coefficient: Coefficient,
    corners: Array,
    degrees: tuple[int, ...],
    rule: Callable[[int], tuple[Array, Array]],
) -> Integrals:
    vertices, count = corners.shape[1:]
    if not callable(coefficient):
        value = float(coefficient)
        flat = np.full((vertices, count), value / vertices)
        return Integrals(flat, np.full(count, value**2), np.zeros((vertices, count)))
    moments, square = _by_rule(coefficient, corners, *rule(degrees[0]))
    doubt = np.abs(moments)
    for degree in degrees[1:]:
        coarser = moments
        moments, square = _by_rule(coefficient, corners, *rule(degree))
        doubt = np.abs(moments - coarser)
        if np.sum(doubt) <= NEGLIGIBLE * np.sum(np.abs(moments)):
            break
    return Integrals(moments, square, doubt)


def _by_rule(
    coefficient: Coefficient, corners: Array, barycentric: Array, weights: Array
) -> tuple[Array, Array]:
    values = values_at(coefficient, corners, barycentric)
    return (barycentric * weights) @ values, weights @ values**2


@dataclass(frozen=True)
class Loads:
    """Sources or body forces, component by component, and their sums over elements.

    Attributes
    ----------
    moments, doubt : (components, 3, elements) arrays
        As in :class:`rmesh_nlp.certificate.integrals.Integrals`.
    square : (elements,) array
        Mean of |f|^2.
    constant : (elements,) bool array
    """

    moments: Array
    doubt: Array
    square: Array
    constant: Array


def loads(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Moments of the load of a problem on each element."""
    n, count = problem.components, skeleton.triangles.shape[1]
    moments, doubt = np.zeros((2, n, 3, count))
    square, constant = np.zeros(count), np.ones(count, dtype=bool)
    corners = skeleton.nodes[:, skeleton.triangles]
    for law, elements in problem.regions:
        for i, coefficient in enumerate(law.load):
            part: Integrals = over_triangles(coefficient, corners[:, :, elements])
            moments[i][:, elements], doubt[i][:, elements] = part.moments, part.doubt
            square[elements] += part.square
            if callable(coefficient):
                constant[elements] = False
    return Loads(moments, doubt, square, constant)


def work(moments: Array, displacement: Array, skeleton: Skeleton) -> Array:
    """(elements,) integrals of f . u for a displacement (components, nodes)."""
    local = displacement[:, skeleton.triangles]
    return np.asarray(np.einsum("cie,cie,e->e", moments, local, skeleton.areas))


def doubtful_work(doubt: Array, displacement: Array, skeleton: Skeleton) -> float:
    """How much the energy may be wrong by the doubt of the moments of the load."""
    if not np.any(doubt):
        return 0.0
    largest = float(np.max(np.abs(displacement)))
    local = np.abs(displacement[:, skeleton.triangles]) + largest
    return float(np.einsum("cie,cie,e->", doubt, local, skeleton.areas))
