"""Moments of coefficients against linear functions, with the doubt that quadrature leaves.

Constants are integrated exactly. Anything else is integrated by rules of increasing degree until two
of them agree, as for any polynomial, or there are none left, as for a coefficient that jumps
inside an element. The difference between the last two is the doubt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.integrals import gauss
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import Coefficient, on_points

TRIANGLE_DEGREES = (5, 8, 13, 20)
"""Degrees of the rules, tried in this order."""

EDGE_POINTS = (4, 6, 10, 31)
"""The same for edges, numbers of Gauss points."""

NEGLIGIBLE = 1e-6
"""Doubt relative to the integrals that needs no better rule."""


@dataclass(frozen=True)
class Integrals:
    """Moments of a coefficient f over simplices with barycentric coordinates phi_i."""

    moments: Array  # (vertices, simplices), integrals of f phi_i over the simplex, divided by its measure
    square: Array  # (simplices,), mean of f^2
    doubt: Array  # (vertices, simplices), difference of ``moments`` between two rules; zero for a constant


def integrals(coefficient: Coefficient, corners: Array) -> Integrals:
    """Moments over edges or triangles with ``corners`` (2, 2 or 3, simplices)."""
    vertices, count = corners.shape[1:]
    if not callable(coefficient):
        value = float(coefficient)
        flat = np.full((vertices, count), value / vertices)
        return Integrals(flat, np.full(count, value**2), np.zeros((vertices, count)))
    rules = map(edge_rule, EDGE_POINTS) if vertices == 2 else map(triangle_rule, TRIANGLE_DEGREES)
    moments = np.zeros((vertices, count))
    for number, (barycentric, weights) in enumerate(rules):
        values, coarser = values_at(coefficient, corners, barycentric), moments
        moments, square = (barycentric * weights) @ values, weights @ values**2
        doubt = np.abs(moments - coarser)
        if number and np.sum(doubt) <= NEGLIGIBLE * np.sum(np.abs(moments)):
            break
    return Integrals(moments, square, doubt)


def edge_rule(points: int) -> tuple[Array, Array]:
    """Barycentric coordinates (2, points) and weights of a Gauss rule, the weights summing to 1."""
    s, weights = gauss(points)
    return np.stack([s[::-1], s]), weights  # the rule is symmetric


def values_at(coefficient: Coefficient, corners: Array, barycentric: Array) -> Array:
    """Values (points, simplices) at points given by barycentric coordinates (vertices, points)."""
    where = np.einsum("cve,vp->cpe", corners, barycentric)
    return on_points(coefficient, where.reshape(2, -1)).reshape(where.shape[1:])


@dataclass(frozen=True)
class Loads:
    """Sources or body forces, component by component, and their sums over elements."""

    moments: Array  # (components, 3, elements) as in :class:`Integrals`
    doubt: Array  # the same
    linear: Array  # (components, 3, elements), the best linear approximation, which a field can balance
    remainder: Array  # (elements,), L2 norm of what that leaves

    def work(self, displacement: Array, skeleton: Skeleton) -> float:
        """Integral of f . u for a displacement (components, nodes)."""
        local = displacement[:, skeleton.triangles]
        return float(np.einsum("cie,cie,e->", self.moments, local, skeleton.areas))

    def doubtful_work(self, displacement: Array, skeleton: Skeleton) -> float:
        """How much the energy may be wrong by the doubt of the moments."""
        local = np.abs(displacement[:, skeleton.triangles]) + np.max(np.abs(displacement))
        return float(np.einsum("cie,cie,e->", self.doubt, local, skeleton.areas))


def loads(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Moments of the load of a problem on each element."""
    n, count = problem.components, skeleton.triangles.shape[1]
    moments, doubt = np.zeros((2, n, 3, count))
    square, varies = np.zeros(count), np.zeros(count, dtype=bool)
    for law, elements in problem.regions:
        varies[elements] = any(callable(coefficient) for coefficient in law.load)
        for i, coefficient in enumerate(law.load):
            part = integrals(coefficient, skeleton.corners[:, :, elements])
            moments[i][:, elements], doubt[i][:, elements] = part.moments, part.doubt
            square[elements] += part.square
    means = moments.sum(axis=1, keepdims=True)
    linear = np.where(varies, 12 * moments - 3 * means, means)
    beyond = np.maximum(square - np.sum(moments * linear, axis=(0, 1)), 0.0)
    return Loads(moments, doubt, linear, np.sqrt(skeleton.areas * np.where(varies, beyond, 0.0)))
