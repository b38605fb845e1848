"""Moments of coefficients against polynomials, with the doubt that quadrature leaves.

Constants are integrated exactly, anything else by :mod:`rmesh_nlp.assessment.integrals`: part by part
where it jumps or kinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.integrals import over_edges, over_triangles
from rmesh_nlp.assessment.parts import Index, Straight, straight_edges
from rmesh_nlp.certificate.fields import element_of
from rmesh_nlp.certificate.polynomials import lowered, moments, powers, projection
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions, size, to_coefficients
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

    def tested(_: Index, barycentric: Array, where: Array) -> Array:
        values = values_on(coefficient, where)
        return np.concatenate([functions(order, barycentric) * values, values[None] ** 2])

    def along(rows: Index, s: Array, where: Array) -> Array:
        return tested(rows, np.stack([1 - s, s]), where)

    if vertices == 2:
        means = over_edges(straight_edges(corners), count, along, (coefficient,))
    else:
        means = over_triangles(Straight(corners), np.arange(count), tested, coefficients=(coefficient,))
    return Integrals(means.value[:-1], means.value[-1], means.doubt[:-1], means.is_certain)


def values_on(coefficient: Coefficient, where: Array) -> Array:
    """Values (...) at positions (2, ...)."""
    return on_points(coefficient, where.reshape(2, -1)).reshape(where.shape[1:])


def values_at(coefficient: Coefficient, corners: Array, barycentric: Array) -> Array:
    """Values (points, simplices) at points given by barycentric coordinates (vertices, points)."""
    return values_on(coefficient, np.einsum("cve,vp->cpe", corners, barycentric))


def interpolated(order: int, samples: Array, points: Array) -> tuple[Array, Array]:
    """(functions, simplices) coefficients by samples (points, simplices), and (simplices,) largest errors.

    ``points`` (vertices, points) are barycentric coordinates, the nodes of the polynomials among them.
    """
    nodes = powers(order, len(points)) / order
    nearest = np.argmin(np.sum((points.T - nodes[:, None]) ** 2, axis=2), axis=1)
    coefficients = to_coefficients(order, len(points)) @ samples[nearest]
    errors = np.abs(samples - functions(order, points).T @ coefficients)
    return coefficients, np.max(errors, axis=0)


@dataclass(frozen=True)
class Loads:
    """Body forces on elements or tractions on edges, and the polynomials that a field balances instead.

    The polynomials are the best approximations of the degree of the field's tractions. Moments are as in
    :class:`Integrals`, of the displacements' order.
    """

    nodes: Index  # (functions, cells), nodes of the displacements on each element or edge
    measure: Array  # (cells,), areas or lengths
    moments: Array  # (components, functions, cells)
    doubt: Array  # (components, functions, cells)
    balanced: Array  # (components, functions of the field's degree, cells) coefficients
    unbalanced: Array  # (components, functions, cells) moments of what the polynomials leave
    remainder: Array  # (cells,), L2 norm of that
    is_certain: bool  # whether it is known where the loads jump and kink

    def work(self, displacement: Array) -> float:
        """On a displacement with coefficients (components, nodes)."""
        return float(np.sum(self.moments * displacement[:, self.nodes] * self.measure))

    def doubtful_work(self, displacement: Array) -> float:
        """How much the energy may be wrong by the doubt of the moments."""
        local = np.abs(displacement[:, self.nodes]) + np.max(np.abs(displacement))
        return float(np.sum(self.doubt * local * self.measure))

    def unbalanced_work(self, displacement: Array) -> Array:
        """(cells,) work of what is not balanced; none if the displacement is of the field's degree."""
        return np.sum(self.unbalanced * displacement[:, self.nodes], axis=(0, 1)) * self.measure


def body_forces(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Sources or body forces on each element."""
    given = [(law.load, elements) for law, elements in problem.regions]
    return _loads(problem, given, skeleton.corners, skeleton.displaced, skeleton.areas)


def tractions(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Given tractions on each edge."""
    given = [(load.value, np.unique(problem.mesh.boundaries[load.boundary])) for load in problem.tractions]
    nodes = skeleton.along(problem.order)
    return _loads(problem, given, skeleton.nodes[:, skeleton.ends], nodes, skeleton.lengths)


def _loads(
    problem: ContactProblem,
    given: Sequence[tuple[Sequence[Coefficient], Index]],
    corners: Array,
    nodes: Index,
    measure: Array,
) -> Loads:
    order, degree, vertices = problem.order, element_of(problem).pieces.degree, corners.shape[1]
    value, doubt = np.zeros((2, problem.components, *nodes.shape))
    remainder, is_certain = np.zeros(measure.size), True
    for coefficients, cells in given:
        unmet = np.zeros(len(cells))  # mean square of what the best approximation leaves
        for i, coefficient in enumerate(coefficients):
            part = integrals(coefficient, corners[:, :, cells], order)
            value[i][:, cells] += part.moments
            doubt[i][:, cells] += part.doubt
            is_certain &= part.is_certain
            if callable(coefficient):
                tested = lowered(part.moments, degree, vertices)
                unmet += np.maximum(part.square - np.sum(tested * projection(tested, vertices), axis=0), 0.0)
        remainder[cells] += np.sqrt(measure[cells] * unmet)
    balanced = projection(lowered(value, degree, vertices), vertices)
    unbalanced = value - moments(balanced, order, vertices)
    return Loads(nodes, measure, value, doubt, balanced, unbalanced, remainder, is_certain)
