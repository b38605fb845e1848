"""Equilibrated stresses of plane elasticity: the composite element of Johnson and Mercier [1]_.

A triangle is cut at its barycentre into three. The stress is symmetric and linear on each of
them and its tractions are continuous inside: 15 degrees of freedom. Linear tractions on the
three edges (12 values) and the divergence (constant on each third) determine it uniquely, if
these are in equilibrium.

The element is affine equivalent: with the Jacobian F of the map from the reference triangle
and J = det F, ``sigma = F sigma_ref F^T / J`` has ``div sigma = F div sigma_ref / J``, and the force
through an edge is ``F`` times that of the reference. So everything is computed once on the
reference triangle, and for all elements by products with the metric ``F^T F / J``.

References
----------
.. [1] C. Johnson, B. Mercier, Some equilibrium finite element methods for two-dimensional elasticity
   problems, Numer. Math. 30 (1978) 103-116.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.linalg

from rmesh_nlp.certificate.skeleton import AFTER, Skeleton
from rmesh_nlp.evaluation import Array

CORNERS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Vertices (2, 3) of the reference triangle."""

MASS = (np.ones((3, 3)) + np.eye(3)) / 12
"""Integrals of products of barycentric coordinates over a triangle of area 1."""


def thirds(corners: Array) -> Array:
    """(2, 3 vertices, 3 thirds, ...) corners of the thirds: third i has the vertices i + 1, i + 2, centre."""
    centre = corners.mean(axis=1)
    return np.stack([np.stack([corners[:, j], corners[:, k], centre], axis=1) for j, k in AFTER], axis=2)


def gradients(corners: Array) -> Array:
    """(2, 3, ...) gradients of the barycentric coordinates of triangles with corners (2, 3, ...)."""
    along = corners[:, AFTER[:, 1]] - corners[:, AFTER[:, 0]]
    first, second = along[:, 2], -along[:, 1]
    double = first[0] * second[1] - first[1] * second[0]
    return np.asarray(np.stack([-along[1], along[0]]) / double)


@dataclass(frozen=True)
class Reference:
    """Basis of the element on the reference triangle.

    A stress is stored by its values (xx, yy, xy) at the three vertices of the three thirds. The
    first nine functions have no divergence, the other six have a unit divergence in one component
    on one third.

    Attributes
    ----------
    basis : (3 thirds, 3 vertices, 3 values, 15) array
    products : (9, 225) array
        Integrals of products of two basis functions, value by value.
    forces : (3 edges, 2 ends, 2 components, 15) array
        Tractions at the ends of the edges, counter-clockwise, times the length of the edge.
    """

    basis: Array
    products: Array
    forces: Array


@lru_cache(maxsize=1)
def reference() -> Reference:
    """The element on the reference triangle."""
    parts = thirds(CORNERS)
    divergence = np.stack([_divergence(parts[:, :, i], i) for i in range(3)]).reshape(6, 27)
    conditions = np.vstack([divergence, _jumps()])
    free = scipy.linalg.null_space(conditions)
    unit = np.linalg.pinv(conditions)[:, :6]
    basis = np.hstack([free, unit]).reshape(3, 3, 3, 15)
    products = np.einsum("ilak,lm,imbn->abkn", basis, MASS / 6, basis).reshape(9, 225)
    along = CORNERS[:, AFTER[:, 1]] - CORNERS[:, AFTER[:, 0]]
    normals = np.stack([along[1], -along[0]])
    forces = np.stack([_times(basis[i, :2], normals[:, i]) for i in range(3)])
    return Reference(basis, products, forces)


def _times(stress: Array, normal: Array) -> Array:
    """(ends, 2, ...) products of symmetric matrices (ends, 3, ...) and a vector."""
    xx, yy, xy = stress[:, 0], stress[:, 1], stress[:, 2]
    return np.stack([xx * normal[0] + xy * normal[1], xy * normal[0] + yy * normal[1]], axis=1)


def _divergence(corners: Array, third: int) -> Array:
    """(2, 3 thirds, 3 vertices, 3 values) coefficients of the divergence on one third."""
    result = np.zeros((2, 3, 3, 3))
    slope = gradients(corners)
    result[0, third, :, 0], result[0, third, :, 2] = slope[0], slope[1]
    result[1, third, :, 2], result[1, third, :, 1] = slope[0], slope[1]
    return result


def _jumps() -> Array:
    """(12, 27) jumps of the traction at both ends of the three edges inside the triangle."""
    centre, rows = CORNERS.mean(axis=1), []
    for vertex in range(3):
        along = centre - CORNERS[:, vertex]
        normal = np.array([along[1], -along[0]])
        one, two = (vertex + 1) % 3, (vertex + 2) % 3  # the thirds that have this vertex
        for places in ((_local(one, vertex), _local(two, vertex)), (2, 2)):
            for component in range(2):
                row = np.zeros((3, 3, 3))
                for third, place, sign in zip((one, two), places, (1, -1), strict=True):
                    row[third, place, component] += sign * normal[component]
                    row[third, place, 2] += sign * normal[1 - component]
                rows.append(row.ravel())
    return np.array(rows)


def _local(third: int, vertex: int) -> int:
    return int(np.flatnonzero(AFTER[third] == vertex)[0])


@dataclass(frozen=True)
class JohnsonMercier:
    """The elements of an elastic problem, and the work of their stresses on the traces at their edges.

    The unknowns of an element are, for each edge and each of its ends, counter-clockwise, the
    moments of both displacement components against the linear function of that end, divided by
    the length of the edge.

    Attributes
    ----------
    skeleton : Skeleton
    lame_lambda, lame_mu : (elements,) arrays
        Lambda as in the in-plane stress.
    load : (2, 3 thirds, elements) array
        Body force on each third.
    """

    skeleton: Skeleton
    lame_lambda: Array
    lame_mu: Array
    load: Array

    @cached_property
    def jacobian(self) -> Array:
        """(elements, 2, 2) Jacobians F."""
        a, b, c = (self.skeleton.nodes[:, vertex] for vertex in self.skeleton.triangles)
        return np.ascontiguousarray(np.stack([b - a, c - a], axis=1).transpose(2, 0, 1))

    @cached_property
    def determinant(self) -> Array:
        """(elements,) determinants J."""
        return 2 * self.skeleton.areas

    @cached_property
    def compliance(self) -> Array:
        """(elements, 15, 15) integrals of ``C^-1 sigma : sigma`` over pairs of basis functions."""
        F = self.jacobian / np.sqrt(self.determinant)[:, None, None]
        a, b = np.sum(F[:, :, 0] ** 2, axis=1), np.sum(F[:, :, 1] ** 2, axis=1)
        c = np.sum(F[:, :, 0] * F[:, :, 1], axis=1)
        square = np.array(
            [
                [a * a, c * c, 2 * a * c],
                [c * c, b * b, 2 * b * c],
                [2 * a * c, 2 * b * c, 2 * (a * b + c * c)],
            ]
        )
        trace = np.array([a, b, 2 * c])
        form = square - self._trace_part * trace[:, None] * trace[None]
        form *= self.determinant / (2 * self.lame_mu)
        return (form.reshape(9, -1).T @ reference().products).reshape(-1, 15, 15)

    @property
    def _trace_part(self) -> Array:
        """The compliance is ``(sigma - this * trace(sigma) I) / (2 mu)``."""
        return np.asarray(self.lame_lambda / (2 * (self.lame_lambda + self.lame_mu)))

    @cached_property
    def _divergent(self) -> Array:
        """(elements, 6) coefficients of the basis functions with divergence."""
        # solving instead of inverting keeps the rounding of thin triangles small
        wanted = -self.determinant[:, None, None] * np.linalg.solve(
            self.jacobian, self.load.transpose(2, 0, 1)
        )
        return np.ascontiguousarray(wanted.transpose(0, 2, 1)).reshape(-1, 6)

    @cached_property
    def _response(self) -> tuple[Array, Array]:
        """Coefficients of the free functions: (elements, 9, 12) by forces, (elements, 9) by the load."""
        A, forces = self.compliance, reference().forces.reshape(12, 15)
        by_load = np.einsum("eij,ej->ei", A[:, :9, 9:], self._divergent)
        right = np.concatenate(
            [np.broadcast_to(forces[:, :9].T, (len(A), 9, 12)), by_load[:, :, None]], axis=2
        )
        solved = np.linalg.solve(A[:, :9, :9], right)
        return solved[:, :, :12], -solved[:, :, 12]

    @cached_property
    def stiffness(self) -> Array:
        """(elements, 12, 12): forces through the edges by the traces."""
        forces = reference().forces.reshape(12, 15)[:, :9]
        S = (forces @ self._response[0]).reshape(-1, 6, 2, 6, 2)
        F = self.jacobian
        half = np.einsum("eab,eibjd->eiajd", F, S, optimize=True)
        return np.asarray(np.einsum("eiajd,ecd->eiajc", half, F, optimize=True)).reshape(-1, 12, 12)

    @cached_property
    def source(self) -> Array:
        """(elements, 12): less the forces through the edges at vanishing traces."""
        coefficients = np.hstack([self._response[1], self._divergent])
        return -self.forces(coefficients)

    def coefficients(self, traces: Array) -> Array:
        """(elements, 15) coefficients of the stress for traces (elements, 12)."""
        by_force, by_load = self._response
        pulled = np.einsum("eba,eib->eia", self.jacobian, traces.reshape(-1, 6, 2)).reshape(-1, 12)
        free = np.einsum("eij,ej->ei", by_force, pulled) + by_load
        return np.hstack([free, self._divergent])

    def stress(self, coefficients: Array) -> Array:
        """(3 thirds, 3 vertices, 3 values, elements) stresses."""
        flat = reference().basis.reshape(27, 15) @ coefficients.T
        xx, yy, xy = np.moveaxis(flat.reshape(3, 3, 3, -1), 2, 0)
        (a, b), (c, d) = self.jacobian.transpose(1, 2, 0)
        J = self.determinant
        return np.stack(
            [
                (a * a * xx + 2 * a * b * xy + b * b * yy) / J,
                (c * c * xx + 2 * c * d * xy + d * d * yy) / J,
                (a * c * xx + (a * d + b * c) * xy + b * d * yy) / J,
            ],
            axis=2,
        )

    def energy(self, stress: Array) -> Array:
        """(elements,) integrals of ``C^-1 sigma : sigma / 2``."""
        trace = stress[:, :, 0] + stress[:, :, 1]
        square = sum(
            factor * np.einsum("ile,lm,ime->e", part, MASS, part, optimize=True)
            for factor, part in (
                (1.0, stress[:, :, 0]),
                (1.0, stress[:, :, 1]),
                (2.0, stress[:, :, 2]),
                (-self._trace_part, trace),
            )
        )
        return np.asarray(square * self.skeleton.areas / 3 / (4 * self.lame_mu))

    def forces(self, coefficients: Array) -> Array:
        """(elements, 12) tractions at the ends of the edges times the length of the edge."""
        flat = coefficients @ reference().forces.reshape(12, 15).T
        return np.einsum("eab,eib->eia", self.jacobian, flat.reshape(-1, 6, 2)).reshape(-1, 12)
