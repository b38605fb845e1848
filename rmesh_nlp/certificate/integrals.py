"""Moments of coefficients against polynomials, with the doubt that quadrature leaves.

Constants are integrated exactly, anything else by :mod:`rmesh_nlp.assessment.integrals`: part by part
where it jumps or kinks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.integrals import over_edges, over_triangles
from rmesh_nlp.certificate.polynomials import projection
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.errors import located
from rmesh_nlp.evaluation import Array, Index, magnitude
from rmesh_nlp.fem.bernstein import functions, size
from rmesh_nlp.problem import ContactProblem, Traction
from rmesh_nlp.problem.body import Edges
from rmesh_nlp.problem.coefficients import Coefficient, on_points, product


@dataclass(frozen=True)
class Integrals:
    """Moments of a coefficient f over simplices, against Bernstein's polynomials phi_i of some degree."""

    moments: Array  # (functions, simplices), integrals of f phi_i over the simplex, divided by its measure
    square: Array  # (simplices,), mean of f^2
    doubt: Array  # (functions, simplices), what ``moments`` may be wrong by; zero for a constant
    is_certain: bool = True  # whether it is known where f jumps and kinks


def integrals(coefficient: Coefficient, skeleton: Skeleton, cells: Index, vertices: int) -> Integrals:
    """Moments over some edges (of two ``vertices``) or triangles (of three)."""
    order = skeleton.space.order
    shape = size(order, vertices), cells.size
    if not callable(coefficient):
        value = float(coefficient)  # all functions have the same integral
        return Integrals(np.full(shape, value / shape[0]), np.full(shape[1], value**2), np.zeros(shape))

    def tested(_: Index, barycentric: Array, where: Array, weights: Array) -> Array:
        values = on_points(coefficient, where)
        each = np.concatenate([functions(order, barycentric) * values, values[None] ** 2])
        return np.sum(each / skeleton.body.problem.measured(where) * weights, axis=2)

    if vertices == 2:
        sums, measure = over_edges(Edges(skeleton.body, cells), tested, (coefficient,)), skeleton.lengths
    else:
        sums, measure = over_triangles(skeleton.body, cells, tested, (), (coefficient,)), skeleton.areas
    means, doubt = sums.value / measure[cells], sums.doubt / measure[cells]
    return Integrals(means[:-1], means[-1], doubt[:-1], sums.is_certain)


@dataclass(frozen=True)
class Loads:
    """Body forces on elements or tractions on edges, and the polynomials that a field balances instead.

    The polynomials are the best approximations of the displacements' order, as are the field's tractions.
    Moments are as in :class:`Integrals`.
    """

    nodes: Index  # (functions, cells), nodes of the displacements on each element or edge
    measure: Array  # (cells,), areas or lengths
    moments: Array  # (components, functions, cells)
    doubt: Array  # (components, functions, cells)
    balanced: Array  # (components, functions of the field's degree, cells) coefficients
    remainder: Array  # (cells,), L2 norm of what the polynomials leave
    is_certain: bool  # whether it is known where the loads jump and kink

    def work(self, displacement: Array) -> float:
        """On a displacement with coefficients (components, nodes)."""
        return float(np.sum(self.moments * displacement[:, self.nodes] * self.measure))

    def doubtful_work(self, displacement: Array) -> float:
        """How much the energy may be wrong by the doubt of the moments."""
        local = np.abs(displacement[:, self.nodes]) + magnitude(displacement)
        return float(np.sum(self.doubt * local * self.measure))


def body_forces(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Sources or body forces on each element."""
    given = [(law.load, elements) for law, elements in problem.regions]
    return _loads(problem, skeleton, given, 3, skeleton.space.elements, skeleton.areas)


def tractions(problem: ContactProblem, skeleton: Skeleton, loads: Sequence[Traction]) -> Loads:
    """Given tractions on each edge."""
    given = [(load.value, np.unique(problem.mesh.boundaries[load.boundary])) for load in loads]
    return _loads(problem, skeleton, given, 2, skeleton.along, skeleton.lengths)


def _loads(
    problem: ContactProblem,
    skeleton: Skeleton,
    given: Sequence[tuple[Sequence[Coefficient], Index]],
    vertices: int,
    nodes: Index,
    measure: Array,
) -> Loads:
    value, doubt = np.zeros((2, problem.components, *nodes.shape))
    remainder, is_certain = np.zeros(measure.size), True
    for coefficients, cells in given:
        unmet = np.zeros(len(cells))  # mean square of what the best approximation leaves
        for i, one in enumerate(coefficients):
            coefficient = product(problem.measure, one)
            with located(f"component {i + 1} of a load"):
                part = integrals(coefficient, skeleton, cells, vertices)
            value[i][:, cells] += part.moments
            doubt[i][:, cells] += part.doubt
            is_certain &= part.is_certain
            if callable(coefficient):
                met = np.sum(part.moments * projection(part.moments, vertices), axis=0)
                unmet += np.maximum(part.square - met, 0.0)
        remainder[cells] += np.sqrt(measure[cells] * unmet)
    return Loads(nodes, measure, value, doubt, projection(value, vertices), remainder, is_certain)
