"""What a finite element of fluxes or stresses in equilibrium must offer, on the reference triangle.

An element cuts the triangle into parts, one or several. On each part a field is a polynomial of degree
k + 1, stored by its coefficients of Bernstein's polynomials: (parts, functions, values, ...) arrays, whose
last axis runs over elements or basis functions. The divergence is of degree k on each part. Tractions are
continuous between the parts, and of degree k along the edges of the triangle, where they meet those of
neighbours. Loads of degree k on the triangle are balanced.

With the Jacobian F of the map from the reference triangle and J = det F, a flux is ``F tau / J``, of
divergence ``div tau / J`` and with the same flux through the edges. A stress is ``F sigma F^T / J``, of
divergence ``F div sigma / J`` and with F times the forces through the edges. So a basis on the reference
triangle, an :class:`Element`, is all there is to say of a new one: name its parts, and fields among which it
is found. There are two:
:func:`rmesh_nlp.certificate.raviart_thomas.raviart_thomas` and
:func:`rmesh_nlp.certificate.johnson_mercier.johnson_mercier`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from rmesh_nlp.certificate.polynomials import bernstein, elevation, powers, raised
from rmesh_nlp.certificate.skeleton import AFTER, CORNERS
from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.bernstein import functions, size, to_coefficients
from rmesh_nlp.problem.body import edge_normals, gradients
from rmesh_nlp.problem.quadrature import triangle_rule

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
        return np.linalg.det(self.corners)

    @cached_property
    def linear(self) -> Array:
        """(parts, functions, 3) coefficients of linear functions, by their values at the vertices."""
        return powers(self.degree + 1, 3) / (self.degree + 1) @ self.corners

    @cached_property
    def restriction(self) -> Array:
        """(parts, functions, functions) coefficients on the parts of polynomials of degree k."""
        nodes = powers(self.degree, 3) / self.degree @ self.corners
        values = functions(self.degree, np.moveaxis(nodes, 2, 0))
        return to_coefficients(self.degree, 3) @ np.moveaxis(values, 0, 2)

    def fields(self, functions: Array) -> Array:
        """All fields each value of which is, on one part, a combination of these functions."""
        parts, values = len(self.corners), self.matrix.shape[2]
        every = np.einsum("fg,pq,vw->pfvqgw", functions, np.eye(parts), np.eye(values))
        return every.reshape(parts, len(functions), values, -1)

    def divergence(self, field: Array, corners: Array) -> Array:
        """(components, parts, functions, ...) coefficients of degree k.

        ``corners`` (2, 3, ...) are those of the triangles.
        """
        of_shares = gradients(np.einsum("pwv,dv...->dwp...", self.corners, corners))
        derived = (self.degree + 1) * field[:, raised(self.degree + 1, 3)]
        slopes = np.einsum("pfwv...,dwp...->pfdv...", derived, of_shares)
        return np.einsum("idv,pfdv...->ipf...", self.matrix, slopes)

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
        reduced = np.linalg.pinv(elevation(self.degree + 1, 2))
        rows = np.zeros((3, self.degree + 1, self.linear[..., 0].size))
        for row, (a, b) in zip(rows, np.eye(3)[AFTER], strict=True):
            row[:, self._along[tuple(a), tuple(b)]] = reduced
        return rows.reshape(-1, rows.shape[2])

    @cached_property
    def _conformity(self) -> tuple[Array, Array]:
        """(m, coefficients) what must vanish, and (m, 3) along which edge, in barycentric coordinates."""
        raising, forward = elevation(self.degree + 1, 2), powers(self.degree + 1, 2).tolist()
        every, backward = np.eye(len(forward)), [forward.index(power[::-1]) for power in forward]
        rows, directions = [], []
        for (a, b), numbers in self._along.items():
            row = np.zeros((len(every), self.linear[..., 0].size))
            if (b, a) in self._along:
                row[:, numbers], row[:, self._along[b, a][backward]] = every, -every
            else:
                row[:, numbers] = every - raising @ np.linalg.pinv(raising)
            rows.append(row)
            directions += [np.subtract(b, a)] * len(row)
        return np.vstack(rows), np.array(directions)

    @cached_property
    def _along(self) -> dict[tuple[Point, Point], Index]:
        """Numbers of the coefficients along the edges of the parts, counter-clockwise, by the ends."""
        order, edges = self.degree + 1, {}
        number = {tuple(power): i for i, power in enumerate(powers(order, 3).tolist())}
        for part, corners in enumerate(self.corners.tolist()):
            for ends in AFTER:
                along = powers(order, 2) @ np.eye(3, dtype=np.int64)[ends]
                numbers = np.array([number[tuple(power)] for power in along.tolist()])
                first, last = (tuple(corners[end]) for end in ends)
                edges[first, last] = part * len(number) + numbers
        return edges


@dataclass(frozen=True)
class Element:
    """A basis of fields without faults on the reference triangle: (parts, functions, values, n) arrays."""

    pieces: Pieces
    free: Array  # without divergence
    loaded: Array  # for each function of degree k and each component that whose divergence it is
    hoop: Array  # of a body of revolution hoop stresses of degree k
    weight: int = 0  # degree of what energies are weighted by

    @classmethod
    def among(cls, pieces: Pieces, free: Array, loaded: Array) -> Element:
        """Those combinations of fields that have no faults, and no divergence or that of the loads.

        A load is balanced by fields of ``free`` as far as these can, the rest of it by the combination of
        ``loaded`` with least coefficients. So the field of a displacement is one of the element, and the best
        field does not depend on the displacement that it is counted from.
        """
        corners = CORNERS[..., None]

        def conditions(fields: Array) -> Array:
            parts = pieces.divergence(fields, corners), pieces.faults(fields, corners)
            return np.vstack([part.reshape(-1, fields.shape[3]) for part in parts])

        loads = np.einsum("pfi,cd->cpfid", pieces.restriction, np.eye(len(pieces.matrix)))
        loads = loads.reshape(loads[..., 0, 0].size, -1)
        rows = conditions(free)
        wanted = np.vstack([loads, np.zeros((len(rows) - len(loads), loads.shape[1]))])
        first = np.linalg.pinv(rows) @ wanted
        rest = np.linalg.pinv(conditions(loaded)) @ (wanted - rows @ first)
        own = free @ scipy.linalg.null_space(rows)
        return cls(pieces, own, free @ first + loaded @ rest, own[..., :0])

    @cached_property
    def of_revolution(self) -> Element:
        """The same for r times a flux, or for r times a stress and the hoop stress, the last value."""
        pieces, hoops = self.pieces, len(self.pieces.matrix) - 1
        wider = (0, 0), (0, 0), (0, hoops)
        free, loaded = (np.pad(part, (*wider, (0, 0))) for part in (self.free, self.loaded))
        hoop = np.zeros((*free.shape[:3], hoops * size(pieces.degree, 3)))
        hoop[:, :, 3:] = (elevation(pieces.degree + 1, 3) @ pieces.restriction)[:, :, None, : hoop.shape[3]]
        return Element(replace(pieces, matrix=np.pad(pieces.matrix, wider)), free, loaded, hoop, 4)

    @cached_property
    def basis(self) -> Array:
        """All of them, the free ones first and the loaded ones last."""
        return np.concatenate([self.free, self.hoop, self.loaded], axis=3)

    @cached_property
    def mass(self) -> Array:
        """(m, parts, functions, functions) of Lagrange's polynomials of weights times two functions.

        On a triangle of area 1.
        """
        pieces, degree = self.pieces, self.pieces.degree + 1
        (shares, weights), lattice = triangle_rule(2 * degree + self.weight), powers(self.weight, 3).T
        at_nodes, values = bernstein(self.weight, lattice / max(self.weight, 1)), bernstein(degree, shares)
        weighting = [bernstein(self.weight, corners.T @ shares) * weights for corners in pieces.corners]
        products = np.einsum("pmq,fq,gq->mpfg", weighting, values, values) * pieces.shares[:, None, None]
        return np.tensordot(np.linalg.inv(at_nodes), products, 1)

    @cached_property
    def products(self) -> Array:
        """(m values^2, n^2) integrals of products of values of two functions, on a triangle of area 1."""
        of_values = np.einsum("pfak,mpfg,pgbl->mabkl", self.basis, self.mass, self.basis, optimize=True)
        return of_values.reshape(-1, self.basis.shape[3] ** 2)

    @cached_property
    def forces(self) -> Array:
        """(3 (k + 1), components, n) forces through the edges."""
        return self.pieces.forces(self.basis, edge_normals(CORNERS[..., None]))
