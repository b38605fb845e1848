"""Equilibrated stresses of plane elasticity: the composite element of Johnson and Mercier [1]_.

A triangle is cut at its barycentre into three. The stress is symmetric and linear on each of them and its
tractions are continuous inside: 15 degrees of freedom, nine of them without divergence, which linear
tractions on the three edges (12 values, in equilibrium) determine. A body force that is linear on the
triangle is balanced by six more stresses, quadratic on each third, again with linear tractions on the edges.

With the Jacobian F of the map from the reference triangle and J = det F, ``sigma = F sigma_ref F^T / J`` has
``div sigma = F div sigma_ref / J``, and the force through an edge is ``F`` times that of the reference. So
all is computed once there, and for all elements by products with the metric ``F^T F / J``.

References
----------
.. [1] C. Johnson, B. Mercier, Some equilibrium finite element methods for two-dimensional elasticity
   problems, Numer. Math. 30 (1978) 103-116.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.linalg

from rmesh_nlp.certificate.conditions import Conditions, NotCertifiableError
from rmesh_nlp.certificate.equilibration import EquilibratedField, Guess, balance
from rmesh_nlp.certificate.hybrid import hybrid
from rmesh_nlp.certificate.integrals import Loads
from rmesh_nlp.certificate.oscillation import korn
from rmesh_nlp.certificate.polynomials import moments
from rmesh_nlp.certificate.skeleton import AFTER, CORNERS, Skeleton, edge_normals
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem import ContactProblem, Elastic

FREE = 9
"""Functions without divergence."""

MIDDLE = ((0, 1), (1, 2), (2, 0))
"""Vertices beside the midpoints. Stresses are stored by their values at the six nodes of quadratic functions,
the vertices and these midpoints."""

NODES = np.vstack([np.eye(3), *((np.eye(3)[i] + np.eye(3)[j]) / 2 for i, j in MIDDLE)])
"""(6, 3) barycentric coordinates of the nodes."""


def _quadratic_mass() -> Array:
    b, weights = triangle_rule(4)
    values = np.stack([*(b[i] * (2 * b[i] - 1) for i in range(3)), *(4 * b[i] * b[j] for i, j in MIDDLE)])
    return np.asarray((values * weights) @ values.T)


def _slopes_at_vertices() -> Array:
    result = np.zeros((3, 6, 3))
    for vertex, b in enumerate(np.eye(3)):
        result[vertex, range(3), range(3)] = 4 * b - 1
        for node, (i, j) in enumerate(MIDDLE, 3):
            result[vertex, node, [i, j]] = 4 * b[[j, i]]
    return result


MASS = _quadratic_mass()
"""Integrals of products of quadratic functions over a triangle of area 1."""

SLOPES = _slopes_at_vertices()
"""(3 vertices, 6 nodes, 3) derivatives of quadratic functions by the barycentric coordinates."""


def on_thirds(values: Array) -> Array:
    """(2, 3 vertices, 3 thirds, ...) a linear function (2, 3 vertices, ...) at the corners of the thirds.

    Third i has the vertices i + 1, i + 2 and the centre.
    """
    centre = values.mean(axis=1)
    return np.stack([np.stack([values[:, j], values[:, k], centre], axis=1) for j, k in AFTER], axis=2)


def divergence(stress: Array, corners: Array) -> Array:
    """(2, 3 vertices, 3 thirds, ...) divergence of stresses (3 thirds, 6 nodes, 3 values, ...).

    ``corners`` are those of the thirds, see :func:`on_thirds`.
    """
    normals = edge_normals(corners)
    double = normals[1, 2] * normals[0, 1] - normals[0, 2] * normals[1, 1]
    slope = np.einsum("vnb,cbi...->cvni...", SLOPES, -normals / double, optimize=True)
    rows = stress[:, :, [0, 2]], stress[:, :, [2, 1]]  # of the matrix, stored as xx, yy, xy
    return np.stack([np.einsum("cvni...,inc...->vi...", slope, row) for row in rows])


def traction(stress: Array, normal: Array) -> Array:
    """(2, ...) products of symmetric matrices (3, ...), stored as xx, yy, xy, and vectors (2, ...)."""
    xx, yy, xy = stress
    return np.stack([xx * normal[0] + xy * normal[1], xy * normal[0] + yy * normal[1]])


def jumps(stress: Array, corners: Array) -> list[Array]:
    """Jumps of the tractions between the thirds, and their deviations from linear ones on the edges.

    Takes stresses (3 thirds, 6 nodes, 3 values, ...) and the corners (2, 3, ...) of the triangles.
    """
    result, centre, normals = [], corners.mean(axis=1), edge_normals(corners)
    for i, (j, k) in enumerate(AFTER):
        along = centre - corners[:, i]
        across = np.stack([along[1], -along[0]])
        # vertex i is the second corner of third j and the first one of third k
        for first, second in ((1, 0), (2, 2), (4, 5)):
            result.append(traction(stress[j, first] - stress[k, second], across))
        bend = stress[i, 3] - (stress[i, 0] + stress[i, 1]) / 2
        result.append(traction(bend, normals[:, i]))
    return result


def edge_tractions(stress: Array, normals: Array) -> Array:
    """(3 edges, 2 ends, 2 components, ...) tractions at the ends of the edges times their length."""
    return np.stack([[traction(stress[i, end], normals[:, i]) for end in range(2)] for i in range(3)])


@dataclass(frozen=True)
class Reference:
    """Basis of the element on the reference triangle.

    The first nine functions have no divergence; of the other six, the one of vertex i and component c has the
    divergence phi_i in this component.
    """

    basis: Array  # (3 thirds, 6 nodes, 3 values xx, yy, xy, 15)
    products: Array  # (9, 225), integrals of products of two basis functions, value by value
    forces: Array  # (3 edges, 2 ends, 2 components, 15), tractions times the length of the edge


@lru_cache(maxsize=1)
def reference() -> Reference:
    """The element on the reference triangle."""
    corners = CORNERS[..., None]

    def conditions(stress: Array) -> Array:
        inside = divergence(stress, on_thirds(corners)).reshape(18, -1)
        return np.vstack([inside, *jumps(stress, corners)])

    linear = np.einsum("nv,ia,cd->incvad", NODES, np.eye(3), np.eye(3)).reshape(3, 6, 3, 27)
    free = linear @ scipy.linalg.null_space(conditions(linear))
    every = np.eye(54).reshape(3, 6, 3, 54)
    wanted = on_thirds(np.einsum("iv,cd->civd", np.eye(3), np.eye(2)).reshape(2, 3, 6))
    right = np.vstack([wanted.reshape(18, 6), np.zeros((24, 6))])
    loaded = every @ (np.linalg.pinv(conditions(every)) @ right)
    basis = np.concatenate([free, loaded], axis=3)
    products = np.einsum("ilak,lm,imbn->abkn", basis, MASS / 6, basis, optimize=True).reshape(9, 225)
    return Reference(basis, products, edge_tractions(basis, edge_normals(corners)))


@dataclass(frozen=True)
class JohnsonMercier:
    """The elements of an elastic problem, and the work of their stresses on the traces at their edges.

    The unknowns of an element are, for each edge and each of its ends, counter-clockwise, the
    moments of both displacement components against the linear function of that end, divided by
    the length of the edge.
    """

    skeleton: Skeleton
    lame_lambda: Array  # (elements,), as in the in-plane stress
    lame_mu: Array  # (elements,)
    load: Array  # (2, 3, elements), body force at the vertices of each element, linear in between

    @property
    def determinant(self) -> Array:
        """(elements,) determinants J."""
        return 2 * self.skeleton.areas

    @cached_property
    def compliance(self) -> Array:
        """(elements, 15, 15) integrals of ``C^-1 sigma : sigma`` over pairs of basis functions."""
        F = self.skeleton.jacobian / np.sqrt(self.determinant)[:, None, None]
        a, c, _, b = np.einsum("eki,ekj->ije", F, F).reshape(4, -1)
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
            self.skeleton.jacobian, self.load.transpose(2, 0, 1)
        )
        return np.ascontiguousarray(wanted.transpose(0, 2, 1)).reshape(-1, 6)

    @cached_property
    def _roots(self) -> tuple[Array, Array, Array]:
        """Cholesky factors L of the compliance of the free functions, L^-1 by forces, and L^-1 by the load.

        With L instead of an inverse, thin triangles cost half as many digits.
        """
        A, forces = self.compliance, reference().forces.reshape(12, 15)
        by_load = np.einsum("eij,ej->ei", A[:, :FREE, FREE:], self._divergent)
        right = np.concatenate(
            [np.broadcast_to(forces[:, :FREE].T, (len(A), FREE, 12)), by_load[:, :, None]], axis=2
        )
        try:
            root = np.linalg.cholesky(A[:, :FREE, :FREE])
        except np.linalg.LinAlgError:
            raise NotCertifiableError("an element is so thin that rounding loses its stresses") from None
        solved = np.linalg.solve(root, right)
        return np.asarray(root, dtype=float), solved[:, :, :12], -solved[:, :, 12]

    @cached_property
    def stiffness(self) -> Array:
        """(elements, 12, 12): forces through the edges by the traces."""
        by_force = self._roots[1].reshape(-1, FREE, 6, 2)
        half = np.einsum("eab,ekib->ekia", self.skeleton.jacobian, by_force, optimize=True).reshape(
            -1, FREE, 12
        )
        return np.asarray(half.transpose(0, 2, 1) @ half)

    @cached_property
    def source(self) -> Array:
        """(elements, 12): less the forces through the edges at vanishing traces."""
        return -self.forces(self.coefficients(np.zeros((self.determinant.size, 12))))

    def coefficients(self, traces: Array) -> Array:
        """(elements, 15) coefficients of the stress for traces (elements, 12)."""
        root, by_force, by_load = self._roots
        pulled = np.einsum("eba,eib->eia", self.skeleton.jacobian, traces.reshape(-1, 6, 2)).reshape(-1, 12)
        scaled = np.einsum("eij,ej->ei", by_force, pulled) + by_load
        free = np.linalg.solve(root.transpose(0, 2, 1), scaled[:, :, None])[:, :, 0]
        return np.hstack([free, self._divergent])

    def stress(self, coefficients: Array) -> Array:
        """(3 thirds, 6 nodes, 3 values, elements) stresses."""
        flat = reference().basis.reshape(54, 15) @ coefficients.T
        xx, yy, xy = np.moveaxis(flat.reshape(3, 6, 3, -1), 2, 0)
        (a, b), (c, d) = self.skeleton.jacobian.transpose(1, 2, 0)
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
        xx, yy, xy = np.moveaxis(stress, 2, 0)
        square = sum(
            factor * np.einsum("ile,lm,ime->e", part, MASS, part, optimize=True)
            for factor, part in ((1.0, xx), (1.0, yy), (2.0, xy), (-self._trace_part, xx + yy))
        )
        return np.asarray(square * self.skeleton.areas / 3 / (4 * self.lame_mu))

    def forces(self, coefficients: Array) -> Array:
        """(elements, 12) tractions at the ends of the edges times the length of the edge."""
        flat = coefficients @ reference().forces.reshape(12, 15).T
        return np.einsum("eab,eib->eia", self.skeleton.jacobian, flat.reshape(-1, 6, 2)).reshape(-1, 12)


def equilibrated_stress(
    problem: ContactProblem,
    skeleton: Skeleton,
    conditions: Conditions,
    load: Loads,
    guess: Guess,
    products: int,
) -> EquilibratedField:
    """The stress of largest dual energy, or nearly so: see :mod:`rmesh_nlp.certificate.equilibration`."""
    lam, mu = np.zeros((2, skeleton.triangles.shape[1]))
    for law, part in problem.regions:
        assert isinstance(law, Elastic)
        lam[part], mu[part] = law.in_plane_lambda, law.lame_mu
    u = guess.displacement
    (xx, xy), (yx, yy) = skeleton.gradients(u)
    trace = lam * (xx + yy)
    computed = linear_stress(np.stack([trace + 2 * mu * xx, trace + 2 * mu * yy, mu * (xy + yx)]))
    body_force = load.balanced
    if problem.order == 2:  # less that of the computed stress, the same all over an element
        body_force = body_force + divergence(computed, on_thirds(skeleton.corners))[:, :1, 0]
    elements = JohnsonMercier(skeleton, lam, mu, body_force)
    exerted = edge_tractions(computed, skeleton.normals).reshape(12, -1).T
    local = elements.stiffness, elements.source - exerted
    assembled = hybrid(skeleton, conditions, local, moments(u[:, skeleton.along(problem.order)], 1))
    balanced = balance(assembled, guess, products)
    coefficients = elements.coefficients(balanced.traces)
    correction = elements.stress(coefficients)
    stress, forces = computed + correction, exerted + elements.forces(coefficients)
    mean = stress[:, 3:].mean(axis=(0, 1))  # exact for quadratic stresses
    return EquilibratedField(
        values=mean,
        computed=elements.energy(computed),
        energy=elements.energy(stress),
        defect=np.sqrt(2 * elements.energy(correction)),
        variation=np.sqrt(2 * elements.energy(stress - mean)),
        forces=forces,
        balance=balanced,
        residual=residual(replace(elements, load=load.balanced), stress, forces),
        gradient_by_energy=korn(skeleton) / np.sqrt(np.minimum(2 * mu, 2 * (lam + mu))),
    )


def linear_stress(values: Array) -> Array:
    """(3 thirds, 6 nodes, 3 values, ...) stress that is constant or linear on a triangle.

    Its values at the vertices are (3 values, 1 or 3 vertices, ...).
    """
    if values.shape[1] == 1:
        return np.tile(values[:, 0], (3, 6, 1, 1))
    centre = values.mean(axis=1)
    thirds = np.stack([np.stack([values[:, j], values[:, k], centre], axis=1) for j, k in AFTER])
    return np.einsum("nv,isve->inse", NODES, thirds)


def residual(elements: JohnsonMercier, stress: Array, forces: Array) -> float:
    """Largest violation of equilibrium, measured on the stress itself, relative to the largest force.

    Divergence on each third, tractions between the thirds, and tractions on the edges, which
    must be linear and those that the edges exchange.
    """
    corners, area = elements.skeleton.corners, elements.skeleton.areas
    out = divergence(stress, on_thirds(corners)) + on_thirds(elements.load)
    exchanged = forces.T.reshape(3, 2, 2, -1)
    across = edge_tractions(stress, elements.skeleton.normals) - exchanged
    largest = max(float(np.max(np.abs(part), initial=1e-300)) for part in (forces, elements.load * area))
    violations = (out * area / 3, across, *jumps(stress, corners))
    return max(float(np.max(np.abs(part), initial=0.0)) for part in violations) / largest
