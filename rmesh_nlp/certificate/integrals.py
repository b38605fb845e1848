"""Moments of coefficients against polynomials, with the doubt that quadrature leaves.

Constants are integrated exactly, anything else by :mod:`rmesh_nlp.assessment.integrals`: part by part
where it jumps or kinks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.integrals import over_edges, over_triangles
from rmesh_nlp.assessment.parts import Index, Straight, straight_edges
from rmesh_nlp.certificate.polynomials import lowered, projection
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions, size
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import Coefficient, on_points


@dataclass(frozen=True)
class Integrals:
    """Moments of a coefficient f over simplices, against Bernstein's polynomials phi_i of some degree."""

    moments: Array  # (functions, simplices), integrals of f phi_i over the simplex, divided by its measure
    square: Array  # (simplices,), mean of f^2
    doubt: Array  # (functions, simplices), what ``moments`` may be wrong by; zero for a constant
    is_certain: bool = True  # whether it is known where f jumps and kinks


def integrals(coefficient: Coefficient, corners: Array, order: int = 1) -> Integrals:
    """Moments of the displacements' order over edges or triangles with ``corners`` (2, 2 or 3, simplices)."""
    vertices, count = corners.shape[1:]
    shape = size(order, vertices), count
    if not callable(coefficient):
        value = float(coefficient)  # all functions have the same integral
        return Integrals(np.full(shape, value / shape[0]), np.full(count, value**2), np.zeros(shape))

    def tested(barycentric: Array, where: Array) -> Array:
        values = on_points(coefficient, where.reshape(2, -1)).reshape(where.shape[1:])
        return np.concatenate([functions(order, barycentric) * values, values[None] ** 2])

    def along(_: Index, s: Array, where: Array) -> Array:
        return tested(np.stack([1 - s, s]), where)

    def inside(_: Index, barycentric: Array, where: Array) -> Array:
        return tested(barycentric, where)

    if vertices == 2:
        means = over_edges(straight_edges(corners), count, along, (coefficient,))
    else:
        means = over_triangles(Straight(corners), np.arange(count), inside, coefficients=(coefficient,))
    return Integrals(means.value[:-1], means.value[-1], means.doubt[:-1], means.is_certain)


def values_at(coefficient: Coefficient, corners: Array, barycentric: Array) -> Array:
    """Values (points, simplices) at points given by barycentric coordinates (vertices, points)."""
    where = np.einsum("cve,vp->cpe", corners, barycentric)
    return on_points(coefficient, where.reshape(2, -1)).reshape(where.shape[1:])


def field_degree(problem: ContactProblem) -> int:
    """Degree of equilibrated forces along edges, and of the loads that they balance.

    Fluxes are as exact as the displacement. Stresses are of the first degree, those of Johnson and Mercier.
    """
    return problem.order if problem.components == 1 else 1


@dataclass(frozen=True)
class Loads:
    """Sources or body forces, component by component, and their sums over elements."""

    moments: Array  # (components, functions, elements) as in :class:`Integrals`, of the displacements' order
    doubt: Array  # the same
    balanced: Array  # (components, functions, elements), the best approximation that a field can balance
    remainder: Array  # (elements,), L2 norm of what that leaves
    is_certain: bool  # whether it is known where they jump and kink

    def work(self, displacement: Array, skeleton: Skeleton) -> float:
        """Integral of f . u for a displacement with coefficients (components, nodes)."""
        local = displacement[:, skeleton.displaced]
        return float(np.einsum("cie,cie,e->", self.moments, local, skeleton.areas))

    def doubtful_work(self, displacement: Array, skeleton: Skeleton) -> float:
        """How much the energy may be wrong by the doubt of the moments."""
        local = np.abs(displacement[:, skeleton.displaced]) + np.max(np.abs(displacement))
        return float(np.einsum("cie,cie,e->", self.doubt, local, skeleton.areas))


def loads(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Moments of the load of a problem on each element."""
    n, count = problem.components, skeleton.triangles.shape[1]
    moments, doubt = np.zeros((2, n, size(problem.order, 3), count))
    square, varies, is_certain = np.zeros(count), np.zeros(count, dtype=bool), True
    for law, elements in problem.regions:
        varies[elements] = any(callable(coefficient) for coefficient in law.load)
        for i, coefficient in enumerate(law.load):
            part = integrals(coefficient, skeleton.corners[:, :, elements], problem.order)
            moments[i][:, elements], doubt[i][:, elements] = part.moments, part.doubt
            square[elements] += part.square
            is_certain &= part.is_certain
    tested = lowered(moments, field_degree(problem), 3)
    balanced = np.where(varies, projection(tested, 3), tested.sum(axis=1, keepdims=True))
    beyond = np.maximum(square - np.sum(tested * balanced, axis=(0, 1)), 0.0)
    remainder = np.sqrt(skeleton.areas * np.where(varies, beyond, 0.0))
    return Loads(moments, doubt, balanced, remainder, is_certain)
