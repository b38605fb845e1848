"""What a finite element of fluxes or stresses in equilibrium must offer, on the reference triangle.

An element cuts the triangle into parts, one or several. On each part a field is a polynomial of degree
k + 1, stored by its coefficients of Bernstein's polynomials: (parts, functions, values, ...) arrays, whose
last axis runs over elements or basis functions. The divergence is of degree k on each part. Tractions are
continuous between the parts, and of degree k along the edges of the triangle, where they meet those of
neighbours. Loads of degree k on the triangle are balanced.

With the Jacobian F of the map from the reference triangle and J = det F, a flux is ``F tau / J``, of
divergence ``div tau / J`` and with the same flux through the edges. A stress is ``F sigma F^T / J``, of
divergence ``F div sigma / J`` and with F times the forces through the edges. So a basis on the reference
triangle, an :class:`Element`, is all there is to say of a new one. There are two:
:func:`rmesh_nlp.certificate.raviart_thomas.raviart_thomas` and
:func:`rmesh_nlp.certificate.johnson_mercier.johnson_mercier`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmesh_nlp.certificate.polynomials import Index, elevation, mass, powers, raised
from rmesh_nlp.certificate.skeleton import AFTER, CORNERS, edge_normals
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions, to_coefficients

Point = tuple[float, ...]
"""Barycentric coordinates."""

FLUX = np.eye(2)[None]
STRESS = np.array([[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]])
"""(components, 2, values): where the values of a field stand in its matrix, which has a row for each
component of the displacement. Those of a stress are xx, yy, xy."""


@dataclass(frozen=True)
class Pieces:
    """Fields that are polynomials of degree k + 1 on each part of a triangle."""

    matrix: Array  # FLUX or STRESS
    degree: int  # k
    corners: Array  # (parts, 3, 3), barycentric coordinates of the corners of each part, counter-clockwise

    @cached_property
    def shares(self) -> Array:
        """(parts,) areas of the parts of a triangle of area 1."""
        return np.asarray(np.linalg.det(self.corners))

    @cached_property
    def mass(self) -> Array:
        """(parts, functions, functions) integrals of products of functions, on a triangle of area 1."""
        return np.asarray(self.shares[:, None, None] * mass(self.degree + 1, self.degree + 1, 3))

    @cached_property
    def linear(self) -> Array:
        """(parts, functions, 3) coefficients of linear functions, by their values at the vertices."""
        return np.asarray(powers(self.degree + 1, 3) / (self.degree + 1) @ self.corners)

    @cached_property
    def restriction(self) -> Array:
        """(parts, functions, functions) coefficients on the parts of polynomials of degree k."""
        nodes = powers(self.degree, 3) / self.degree @ self.corners
        values = functions(self.degree, np.moveaxis(nodes, 2, 0))
        return np.asarray(to_coefficients(self.degree, 3) @ np.moveaxis(values, 0, 2))

    def divergence(self, field: Array, corners: Array) -> Array:
        """(components, parts, functions, ...) coefficients of degree k.

        ``corners`` (2, 3, ...) are those of the triangles.
        """
        normals = edge_normals(np.einsum("pwv,dv...->dwp...", self.corners, corners))
        slopes = -normals / (normals[1, 2] * normals[0, 1] - normals[0, 2] * normals[1, 1])
        derived = (self.degree + 1) * field[:, raised(self.degree + 1, 3)]
        gradients = np.einsum("pfwv...,dwp...->pfdv...", derived, slopes)
        return np.einsum("idv,pfdv...->ipf...", self.matrix, gradients)

    def forces(self, field: Array, normals: Array) -> Array:
        """(3 (k + 1), components, ...) coefficients of the tractions along the edges, times their lengths.

        ``normals`` (2, 3, ...) are as long as the edges.
        """
        return self._across(self._traces, field, np.repeat(normals, self.degree + 1, axis=1))

    def faults(self, field: Array, corners: Array) -> Array:
        """(m, components, ...) jumps of forces between parts, and what is not of degree k on the edges."""
        rows, directions = self._conformity
        x, y = np.einsum("mv,dv...->dm...", directions, corners)
        return self._across(rows, field, np.stack([y, -x]))

    def _across(self, rows: Array, field: Array, normals: Array) -> Array:
        """(m, components, ...) tractions of combinations of coefficients, with normals (2, m, ...)."""
        values = np.tensordot(rows, field.reshape(-1, *field.shape[2:]), 1)
        return np.einsum("imv...,mv...->mi...", np.einsum("idv,dm...->imv...", self.matrix, normals), values)

    @cached_property
    def _traces(self) -> Array:
        """(3 (k + 1), coefficients) coefficients along the edges, ends first."""
        left, reduced = self._beside(0), np.linalg.pinv(elevation(self.degree + 1, 2))
        rows = np.zeros((3, self.degree + 1, self.linear[..., 0].size))
        for row, (a, b) in zip(rows, np.eye(3)[AFTER], strict=True):
            row[:, left[tuple(a), tuple(b)]] = reduced
        return rows.reshape(-1, rows.shape[2])

    @cached_property
    def _conformity(self) -> tuple[Array, Array]:
        """(m, coefficients) what must vanish, and (m, 3) along which edge, in barycentric coordinates."""
        left, right, raising = self._beside(0), self._beside(1), elevation(self.degree + 1, 2)
        every = np.eye(self.degree + 2)
        rows, directions = [], []
        for (a, b), numbers in left.items():
            row = np.zeros((len(every), self.linear[..., 0].size))
            if (a, b) in right:
                row[:, numbers], row[:, right[a, b]] = every, -every
            else:
                row[:, numbers] = every - raising @ np.linalg.pinv(raising)
            rows.append(row)
            directions += [np.subtract(b, a)] * len(row)
        return np.vstack(rows), np.array(directions)

    def _beside(self, side: int) -> dict[tuple[Point, Point], Index]:
        """Numbers of the coefficients along edges, by their ends, of the part left (0) or right (1) of them."""
        order = self.degree + 1
        number = {tuple(power): i for i, power in enumerate(powers(order, 3).tolist())}
        edges: dict[tuple[Point, Point], Index] = {}
        for part, corners in enumerate(self.corners.tolist()):
            for a, b in np.roll(AFTER, side, axis=1):
                along = powers(order, 2) @ np.eye(3, dtype=np.int64)[[a, b]]
                numbers = np.array([number[tuple(power)] for power in along.tolist()])
                edges[tuple(corners[a]), tuple(corners[b])] = part * len(number) + numbers
        return edges


@dataclass(frozen=True)
class Element:
    """A basis of fields without faults on the reference triangle: (parts, functions, values, n) arrays."""

    pieces: Pieces
    free: Array  # without divergence
    loaded: Array  # for each function of degree k and each component that whose divergence it is

    @cached_property
    def basis(self) -> Array:
        """All of them, the free ones first."""
        return np.concatenate([self.free, self.loaded], axis=3)

    @cached_property
    def products(self) -> Array:
        """(values^2, n^2) integrals of products of values of two functions, on a triangle of area 1."""
        M = self.pieces.mass
        of_values = np.einsum("pfak,pfg,pgbl->abkl", self.basis, M, self.basis, optimize=True)
        return np.asarray(of_values.reshape(-1, self.basis.shape[3] ** 2))

    @cached_property
    def forces(self) -> Array:
        """(3 (k + 1), components, n) forces through the edges."""
        return self.pieces.forces(self.basis, edge_normals(CORNERS[..., None]))
