"""Fields of an element on all triangles of a mesh, each found from the traces at the edges of its triangle.

On every triangle that field is sought which balances the load and whose energy, less the work of its forces
through the edges on given traces of the displacement, is least. Eliminating it leaves the traces alone: the
forces are ``stiffness @ traces - source``.

The traces of a triangle are, for each edge, counter-clockwise, and each of Bernstein's polynomials along it,
the moments of the components of the displacement, divided by the length of the edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rmesh_nlp.certificate.element import Element
from rmesh_nlp.certificate.johnson_mercier import johnson_mercier
from rmesh_nlp.certificate.oscillation import korn
from rmesh_nlp.certificate.polynomials import elevation, powers
from rmesh_nlp.certificate.raviart_thomas import raviart_thomas
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.problem import ContactProblem


def element_of(problem: ContactProblem) -> Element:
    """The element whose fields are as exact as the displacement."""
    plane = raviart_thomas(problem.order) if problem.components == 1 else johnson_mercier(problem.order)
    return plane.of_revolution if problem.axisymmetric else plane


class Law(NamedTuple):
    """The material of each triangle; strains are gradients, or xx, yy, twice xy and if any hoop."""

    stiffness: Array  # (values, values, elements), fields by strains
    compliance: Array  # (values, values, m, elements), its inverse at the nodes of weights, times these
    gradient_by_energy: Array  # (elements,), see :func:`rmesh_nlp.certificate.oscillation.oscillation`


def law_of(problem: ContactProblem, skeleton: Skeleton) -> Law:
    """The law of a problem on its triangles."""
    corners, values = skeleton.corners, len(problem.laws[0].compliance)
    least = (problem.measured(corners) + 0 * corners[0]).min(axis=0)
    weights = _weights(corners[0], values) if problem.axisymmetric else np.ones((1, 1, 1, least.size))
    stiffness, compliance = (
        np.zeros((values, values, least.size)),
        np.zeros((values, values, *weights.shape[2:])),
    )
    gradient_by_energy = np.ones(least.size) if problem.components == 1 else korn(skeleton)
    for law, part in problem.regions:
        gradient_by_energy[part] /= np.sqrt(law.least_modulus * least[part])
        stiffness[:, :, part] = law.stiffness[:, :, None]
        compliance[..., part] = law.compliance[:, :, None, None] * weights[..., part]
    return Law(stiffness, compliance, gradient_by_energy)


def _weights(r: Array, values: int) -> Array:
    """(values, values, 15, elements) of energies of r times stresses and hoop stresses, by r (3, elements).

    Those of two stresses have 1 / r from above, a polynomial p of degree 4: with r_0 the least r, and the
    zeros of Chebyshev's polynomial, ``p(r) - 1 / r = (r / r_0 - 1) (r / r_1 - 1)^2 (r / r_2 - 1)^2 / r``.
    """
    nodes = r.min(axis=0) + np.ptp(r, axis=0) * np.cos(np.pi / 10 * np.array([[5], [3], [1]])) ** 2
    at, hoops = powers(4, 3) / 4 @ r, np.arange(values) // 3
    first, *others = at / nodes[:, None] - 1
    weights = np.stack([(1 + first * np.prod(others, axis=0) ** 2) / at, np.ones(at.shape), at])
    return weights[np.add.outer(hoops, hoops)] / (2 * np.pi)


def of_displacement(element: Element, law: Law, skeleton: Skeleton, displacement: Array) -> Array:
    """The field of a displacement with coefficients (components, nodes), see :class:`TraceFields`."""
    strain = np.einsum("idv,idce->vce", element.pieces.matrix, skeleton.gradients(displacement))
    values = np.einsum("vwe,wce->vce", law.stiffness, strain)
    at_vertices = np.broadcast_to(values, (len(values), 3, values.shape[2]))
    return np.einsum("pfc,vce->pfve", element.pieces.linear, at_vertices, optimize=True)


@dataclass(frozen=True)
class TraceFields:
    """The element on all triangles of a mesh, under a load of the degree of its tractions.

    TraceFields are (parts, functions, values, elements) arrays, see :mod:`rmesh_nlp.certificate.element`.

    With ``reacts`` the load is not balanced alone but with the reaction of an obstacle in the interior. Then
    further traces of a triangle are the moments of the displacement against Bernstein's polynomials, divided
    by the area, and the forces on them the coefficients of load and reaction, times the area.
    """

    element: Element
    skeleton: Skeleton
    law: Law
    load: Array  # (components, functions, elements) coefficients
    reacts: bool = False

    @cached_property
    def turn(self) -> Array:
        """(elements, components, components) forces by those on the reference triangle."""
        F = self.skeleton.jacobian
        return F if len(self.load) == 2 else np.ones((len(F), 1, 1))

    @cached_property
    def push(self) -> Array:
        """(elements, values, values) values of a field by those on the reference triangle."""
        matrix = self.element.pieces.matrix
        each, F = matrix / np.maximum(matrix.sum(axis=(0, 1)), 1), self.skeleton.jacobian
        pushed = np.einsum("idv,eij,edg,jgw->evw", each, self.turn, F, matrix, optimize=True)
        pushed /= (2 * self.skeleton.areas)[:, None, None]
        pushed[:, 3:, 3:] = 1.0  # a hoop stress
        return pushed

    @cached_property
    def prescribed(self) -> Array:
        """(elements, m) coefficients of the basis functions with divergence; none if they are to be found."""
        if self.reacts:
            return np.zeros((self.skeleton.areas.size, 0))
        # solving instead of inverting keeps the rounding of thin triangles small
        divergence = (-2 * self.skeleton.areas * self.load).transpose(2, 0, 1)
        wanted = np.linalg.solve(self.turn, divergence)
        return np.ascontiguousarray(wanted.transpose(0, 2, 1)).reshape(len(wanted), -1)

    @cached_property
    def kernel(self) -> Array:
        """(elements, n, m) coefficients by the unknown ones: hoop stresses balance a divergence along r."""
        hoops, n = self.element.hoop.shape[3], self.element.basis.shape[3]
        m = n - self.prescribed.shape[1]
        result = np.tile(np.eye(n, m), (len(self.turn), 1, 1))
        along = 2 * self.skeleton.areas[:, None, None] * np.linalg.inv(self.turn)[:, :, :1]
        result[:, n - 2 * hoops :, m - hoops :] = np.kron(np.eye(hoops), along)
        return result

    @cached_property
    def rows(self) -> Array:
        """(elements, traces, n) forces by coefficients."""
        edges = np.einsum("eij,ajn->eain", self.turn, self.element.forces)
        edges = edges.reshape(len(edges), -1, edges.shape[-1])
        if not self.reacts:
            return edges
        # less the divergence times the area, which is half the Jacobian that it is divided by
        free, loaded = self.element.free.shape[3], self.element.loaded.shape[3]
        inflow = np.hstack([np.zeros((loaded, free)), -0.5 * np.eye(loaded)])
        return np.concatenate([edges, np.broadcast_to(inflow, (len(edges), *inflow.shape))], axis=1)

    @cached_property
    def _roots(self) -> tuple[Array, Array, Array]:
        """L^-1, L Cholesky's factors of the free functions' compliance, L^-1 by forces, and by the load.

        With L instead of the inverse of the product, thin triangles cost half as many digits.
        """
        P = self.push[:, None]
        metric = P.transpose(0, 1, 3, 2) @ self.law.compliance.transpose(3, 2, 0, 1) @ P
        metric *= self.skeleton.areas[:, None, None, None]
        n = self.element.basis.shape[3]
        A = (metric.reshape(len(P), -1) @ self.element.products).reshape(-1, n, n)
        Z, known = self.kernel, self.prescribed.shape[1]
        tested = Z.transpose(0, 2, 1) @ A
        own, by_load = tested @ Z, tested[:, :, n - known :] @ self.prescribed[:, :, None]
        # on needles rounding would leave no Cholesky factor; fields in equilibrium stay so in any metric
        largest = np.max(np.diagonal(own, axis1=1, axis2=2), axis=1)
        root = np.linalg.cholesky(own + 1e-14 * largest[:, None, None] * np.eye(n - known))
        inverse = np.linalg.inv(root)
        return inverse, inverse @ (self.rows @ Z).transpose(0, 2, 1), -(inverse @ by_load)[:, :, 0]

    @cached_property
    def stiffness(self) -> Array:
        """(elements, traces, traces): forces by the traces."""
        by_trace = self._roots[1]
        return by_trace.transpose(0, 2, 1) @ by_trace

    @cached_property
    def source(self) -> Array:
        """(elements, traces): less the forces at vanishing traces."""
        _, by_trace, by_load = self._roots
        forces = by_trace.transpose(0, 2, 1) @ by_load[:, :, None]
        forces = forces + self.rows[:, :, by_trace.shape[1] :] @ self.prescribed[:, :, None]
        return -forces[:, :, 0]

    def of_traces(self, traces: Array) -> Array:
        """The fields for traces (elements, traces)."""
        inverse, by_trace, by_load = self._roots
        scaled = by_trace @ traces[:, :, None] + by_load[:, :, None]
        coefficients = (self.kernel @ (inverse.transpose(0, 2, 1) @ scaled))[:, :, 0]
        coefficients[:, coefficients.shape[1] - self.prescribed.shape[1] :] += self.prescribed
        return np.einsum("evw,pfwn,en->pfve", self.push, self.element.basis, coefficients, optimize=True)

    def forces(self, field: Array) -> Array:
        """(elements, traces) coefficients of the tractions times the lengths of the edges."""
        through = self.element.pieces.forces(field, self.skeleton.normals)
        return np.ascontiguousarray(through.reshape(-1, through.shape[-1]).T)

    def energy(self, field: Array) -> Array:
        """(elements,) stored energies, the integrals of ``C^-1 sigma : sigma / 2``."""
        mass = self.element.mass
        strain = np.einsum("vwme,pfwe->mpfve", self.law.compliance, field)
        tested = np.sum(mass @ strain.reshape(*mass.shape[:3], -1), axis=0)
        square = np.sum(field.reshape(tested.shape) * tested, axis=(0, 1)).reshape(field.shape[2:])
        return np.maximum(square.sum(axis=0), 0.0) * self.skeleton.areas / 2

    def mean(self, field: Array) -> Array:
        """(values, elements) means."""
        return np.einsum("p,pve->ve", self.element.pieces.shares, field.mean(axis=1))

    def imbalance(self, field: Array, load: Array, scale: float = 1e-300) -> float:
        """Largest violation of equilibrium with a load in the triangles, relative to the largest force.

        That is at least ``scale``.
        """
        pieces, corners, areas = self.element.pieces, self.skeleton.corners, self.skeleton.areas
        body = np.einsum("pfg,cge->cpfe", pieces.restriction, load)
        out = pieces.divergence(field, corners) + body
        lowered = np.linalg.pinv(elevation(pieces.degree + 1, 3))
        out[0] -= np.einsum("gf,pfve->pge", lowered, field[:, :, 3:])
        share = pieces.shares[:, None, None] * areas
        largest = max(scale, *map(magnitude, (self.forces(field), load * areas)))
        violations = out * share, pieces.faults(field, corners)
        return max(map(magnitude, violations)) / largest
