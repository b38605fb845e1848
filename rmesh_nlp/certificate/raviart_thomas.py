"""Equilibrated fluxes of scalar problems: Raviart-Thomas elements of the second and third order [1]_.

For displacements of order k the flux is a polynomial of degree k on each edge, and balances a source of
degree k on each element. That of a lower order is cheaper, but its own error is as large as that of the
displacements.

With the Jacobian F of the map from the reference triangle and J = det F, ``tau = F tau_ref / J`` has
``div tau = div tau_ref / J`` and the same flux through the edges. So all is computed once on the reference
triangle, and for all elements by products with the metric ``F^T F``.

References
----------
.. [1] D. Boffi, F. Brezzi, M. Fortin, Mixed finite element methods and applications, Springer 2013,
   section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from rmesh_nlp.certificate.conditions import Conditions, NotCertifiableError
from rmesh_nlp.certificate.equilibration import EquilibratedField, Guess, balance
from rmesh_nlp.certificate.hybrid import InteriorObstacle, hybrid
from rmesh_nlp.certificate.integrals import Loads, integrals
from rmesh_nlp.certificate.polynomials import elevation, moments
from rmesh_nlp.certificate.skeleton import AFTER, CORNERS, Skeleton, edge_normals
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import SIDES, to_coefficients
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.laws import Laplace

FREE = {1: 5, 2: 9}
"""Number of functions without divergence, by the degree."""


@dataclass(frozen=True)
class Reference:
    """Functions on the reference triangle.

    First the curls of x, y, x^2, x y, y^2 and, of degree 2, of x^3, x^2 y, x y^2, y^3, of no divergence; then
    (x - centre) / 2, of divergence 1. The others have no normal component on the edges:
    ``phi_i (x - x_i) / 3`` for the first two vertices, of divergence phi_i - 1/3, that of the third vertex
    being less the sum of these two; and, of degree 2, ``phi_a phi_b (2 x - x_a - x_b) / 4`` for the edges, of
    divergence ``2 phi_a phi_b - (phi_a + phi_b) / 4``.
    """

    products: Array  # (4, n^2), integrals of products of components a, b of two of n functions, over the area
    variations: Array  # (4, n^2), the same of the functions less their means
    means: Array  # (2, n)
    forces: Array  # (3 k, n), coefficients of normal components times the edge's length, edge by edge
    divergences: Array  # (3 or 6, n), their coefficients


@lru_cache
def reference(degree: int) -> Reference:
    """The element on the reference triangle."""
    barycentric, weights = triangle_rule(2 * degree + 2)
    values = _functions(barycentric, degree)
    means = np.einsum("p,apk->ak", weights, values)
    deviations = values - means[:, None]
    products, variations = (
        np.einsum("p,apk,bpl->abkl", weights, some, some).reshape(4, -1) for some in (values, deviations)
    )
    forces = []
    for normal, ends in zip(edge_normals(CORNERS).T, np.eye(3)[AFTER], strict=True):
        points = np.vstack([ends, ends.mean(axis=0)])[: degree + 1]
        through = np.einsum("c,cek->ek", normal, _functions(points.T, degree))
        forces.append(to_coefficients(degree, 2) @ through)
    free = np.zeros((3 * degree, FREE[degree]))
    inside = np.column_stack([np.ones(3), np.eye(3)[:, :2] - 1 / 3])
    if degree == 2:
        raised = elevation(3)
        of_edges = [raised[:, [a, b]].sum(axis=1) / 4 for a, b in SIDES[3]]
        inside = np.hstack([raised @ inside, np.eye(6)[:, 3:] - np.transpose(of_edges)])
    return Reference(products, variations, means, np.vstack(forces), np.hstack([free, inside]))


def _functions(barycentric: Array, degree: int) -> Array:
    """(2, points, functions) values at points given by barycentric coordinates (3, points)."""
    x, y = CORNERS @ barycentric
    zero, one = np.zeros_like(x), np.ones_like(x)
    curls = [(zero, -one), (one, zero), (zero, -2 * x), (x, -y), (2 * y, zero)]
    radial = [((x - 1 / 3) / 2, (y - 1 / 3) / 2)]
    bubbles = [
        (phi * (x - corner[0]) / 3, phi * (y - corner[1]) / 3)
        for phi, corner in zip(barycentric[:2], CORNERS.T[:2], strict=True)
    ]
    if degree == 2:
        curls += [(zero, -3 * x**2), (x**2, -2 * x * y), (2 * x * y, -(y**2)), (3 * y**2, zero)]
        for a, b in SIDES[3]:
            both, ends = barycentric[a] * barycentric[b] / 4, CORNERS[:, a] + CORNERS[:, b]
            bubbles.append((both * (2 * x - ends[0]), both * (2 * y - ends[1])))
    return np.array([*curls, *radial, *bubbles]).transpose(1, 2, 0)


@dataclass(frozen=True)
class RaviartThomas:
    """The elements of a scalar problem, and the work of their fluxes on the traces at their edges.

    The unknowns of an element are, for each edge, the moments of the displacement against Bernstein's
    polynomials, those of its ends counter-clockwise and then the rest, divided by the length of the edge.

    With ``obstacle`` the reaction of an obstacle, a polynomial on each element, is to be found too. The
    moments of the displacement against Bernstein's polynomials, divided by the area, are unknowns as well
    then; their forces are the coefficients of source and reaction, times the area.
    """

    skeleton: Skeleton
    conductivity: Array  # (elements,)
    load: Array  # (3 or 6, elements), coefficients of the source
    obstacle: bool = False
    penalty: Array | float = 0.0  # (elements,), weight of the squared variation in what the flux minimises

    @property
    def degree(self) -> int:
        """Of the source, and of the flux through the edges."""
        return len(self.load) // 3

    @property
    def reference(self) -> Reference:
        """The element on the reference triangle."""
        return reference(self.degree)

    @cached_property
    def metric(self) -> Array:
        """(elements, 4) factors of integrals of products of components on the reference triangle."""
        metric = np.einsum("eca,ecb->eab", self.skeleton.jacobian, self.skeleton.jacobian).reshape(-1, 4)
        # over the area: integral of |tau|^2 = area / J^2 tau_ref . G tau_ref, and J = 2 area
        return np.asarray(metric / (4 * self.skeleton.areas * self.conductivity)[:, None])

    @cached_property
    def compliance(self) -> Array:
        """(elements, n, n) integrals of ``tau . tau' / k`` over pairs of the n functions."""
        return self._matrices(self.metric, self.reference.products)

    @cached_property
    def minimised(self) -> Array:
        """(elements, n, n) matrices of what the flux minimises, the energy with the penalty."""
        if np.isscalar(self.penalty):
            return self.compliance
        metric = self.metric * np.asarray(self.penalty)[:, None]
        return np.asarray(self.compliance + self._matrices(metric, self.reference.variations))

    def _matrices(self, metric: Array, of_reference: Array) -> Array:
        n = self.reference.means.shape[1]
        return np.asarray((metric @ of_reference).reshape(-1, n, n))

    @cached_property
    def prescribed(self) -> Array:
        """(elements, 3 or 6) coefficients of the functions with divergence; to be found for an obstacle."""
        if self.obstacle:
            return np.zeros(self.load.T.shape)
        linear, bent = self.load[:3].copy(), self.load[3:].copy()
        for bend, (a, b) in zip(bent, SIDES[3], strict=False):
            bend -= (self.load[a] + self.load[b]) / 2
            linear[[a, b]] += bend / 4
        values = [linear.mean(axis=0), linear[0] - linear[2], linear[1] - linear[2], *bent]
        return np.ascontiguousarray((-2 * self.skeleton.areas * np.stack(values)).T)

    @property
    def free(self) -> int:
        """Number of the functions that the source leaves free, which come first."""
        return FREE[self.degree] + len(self.load) * int(self.obstacle)

    @cached_property
    def rows(self) -> Array:
        """(forces, n) forces by coefficients: through the edges, and with an obstacle less the divergence."""
        if not self.obstacle:
            return self.reference.forces
        # times the area, 1/2 on the reference triangle, after division by the Jacobian
        return np.vstack([self.reference.forces, -0.5 * self.reference.divergences])

    @cached_property
    def _response(self) -> tuple[Array, Array]:
        """Coefficients of the free functions: by traces, and by the source."""
        A, n, rows = self.minimised, self.free, self.rows
        by_load = np.einsum("eij,ej->ei", A[:, :n, FREE[self.degree] :], self.prescribed)
        forces = np.broadcast_to(rows[:, :n].T, (len(A), n, len(rows)))
        solved = np.linalg.solve(A[:, :n, :n], np.concatenate([forces, by_load[:, :, None]], axis=2))
        return solved[:, :, :-1], -solved[:, :, -1]

    @cached_property
    def stiffness(self) -> Array:
        """(elements, k, k): forces by the traces."""
        return np.asarray(self.rows[:, : self.free] @ self._response[0])

    @cached_property
    def source(self) -> Array:
        """(elements, k): less the forces at vanishing traces."""
        return -self.forces(self._with_prescribed(self._response[1]))

    def coefficients(self, traces: Array) -> Array:
        """(elements, n) coefficients of the flux for traces (elements, k)."""
        by_trace, by_load = self._response
        return self._with_prescribed(np.einsum("eij,ej->ei", by_trace, traces) + by_load)

    def _with_prescribed(self, free: Array) -> Array:
        result = np.hstack([np.zeros((len(free), FREE[self.degree])), self.prescribed])
        result[:, : self.free] += free
        return result

    def forces(self, coefficients: Array) -> Array:
        """(elements, k) coefficients of normal fluxes times the edges' lengths, and of the inflow."""
        return np.asarray(coefficients @ self.rows.T)

    def energy(self, coefficients: Array) -> Array:
        """(elements,) integrals of ``|tau|^2 / (2 k)``."""
        return _squares(self.compliance, coefficients) / 2

    def variation(self, coefficients: Array) -> Array:
        """(elements,) squares of the distance of the flux from its mean, in the energy norm."""
        return _squares(self._matrices(self.metric, self.reference.variations), coefficients)

    def mean(self, coefficients: Array) -> Array:
        """(2, elements) means."""
        pushed = np.einsum("eab,eb->ae", self.skeleton.jacobian, coefficients @ self.reference.means.T)
        return np.asarray(pushed / (2 * self.skeleton.areas))


def linear_flux(skeleton: Skeleton, flux: Array, degree: int) -> Array:
    """(elements, n) coefficients of a flux that is constant or linear on each element.

    Its values at the vertices are (2, 1 or 3, elements).
    """
    pulled = np.linalg.solve(skeleton.jacobian, (2 * skeleton.areas * flux).transpose(2, 0, 1))
    result = np.zeros((len(pulled), reference(degree).means.shape[1]))
    x, y = pulled[:, :, 0].T
    if pulled.shape[2] == 3:  # (p x + q y, r x + s y) besides
        (p, r), (q, s) = (pulled[:, :, 1] - pulled[:, :, 0]).T, (pulled[:, :, 2] - pulled[:, :, 0]).T
        result[:, 2], result[:, 3], result[:, 4], result[:, FREE[degree]] = -r / 2, (p - s) / 2, q / 2, p + s
        x, y = x + (p + s) / 6, y + (p + s) / 6
    result[:, 0], result[:, 1] = -y, x
    return result


def _squares(A: Array, coefficients: Array) -> Array:
    """(elements,) values of quadratic forms; not negative, however thin the element."""
    values = np.einsum("ei,eij,ej->e", coefficients, A, coefficients, optimize=True)
    return np.asarray(np.maximum(values, 0.0))


def obstacle_inside(
    obstacle: Obstacle | None, skeleton: Skeleton, offset: Array, source: Array, u: Array
) -> InteriorObstacle | None:
    """The obstacle in the interior in the terms of the traces from a base ``u`` (1, nodes), if there is one.

    ``offset`` are the moments of its gap without displacement, ``source`` the coefficients of the source:
    (3 or 6, elements) arrays.
    """
    if obstacle is None:
        return None
    sign = obstacle.normal[0]
    of_base = moments(u[0][skeleton.displaced], len(source) // 3, 3)
    return InteriorObstacle(sign, (offset + sign * of_base).T, (source * skeleton.areas).T)


def equilibrated_flux(
    problem: ContactProblem,
    skeleton: Skeleton,
    conditions: Conditions,
    load: Loads,
    guess: Guess,
    products: int,
) -> EquilibratedField:
    """The flux of largest dual energy, or nearly so: see :mod:`rmesh_nlp.certificate.equilibration`."""
    conductivity = np.zeros(skeleton.areas.size)
    for law, part in problem.regions:
        assert isinstance(law, Laplace)
        conductivity[part] = law.conductivity
    inside = [obstacle for obstacle in problem.obstacles if obstacle.boundary is Place.INTERIOR]
    if len(inside) > 1:
        raise NotCertifiableError("there are two obstacles in the interior")
    (source,), u, degree = load.balanced, guess.displacement, conditions.degree
    below = integrals(inside[0].offset if inside else 0.0, skeleton.corners, problem.order)
    interior = obstacle_inside(inside[0] if inside else None, skeleton, below.moments, source, u)
    computed = linear_flux(skeleton, conductivity * skeleton.gradients(u)[0], degree)
    balances = computed[:, FREE[degree]] / (2 * skeleton.areas)  # less the source of the computed flux
    elements = RaviartThomas(skeleton, conductivity, source + balances, bool(inside))
    local = elements.stiffness, elements.source - elements.forces(computed)
    assembled = hybrid(skeleton, conditions, local, moments(u[:, skeleton.along(degree)], degree), interior)
    balanced = balance(assembled, guess, products)
    correction, reaction = elements.coefficients(balanced.traces), balanced.obstacle_force
    flux = computed + correction
    forces = elements.forces(flux)
    # what leaves an element through its edges is the source and the reaction within it
    wanted = (source * skeleton.areas).T + (interior.sign * reaction if interior else 0.0)
    edges, inflow = np.hsplit(forces, [3 * (degree + 1)])
    whole = edges.sum(axis=1) / (degree + 1) + wanted.mean(axis=1)
    out = np.append(whole, inflow - wanted[:, : inflow.shape[1]])
    scale = max(float(np.max(np.abs(part), initial=1e-300)) for part in (edges, wanted))
    defect = np.sqrt(2 * elements.energy(correction))
    variation = np.sqrt(elements.variation(flux))
    return EquilibratedField(
        values=elements.mean(flux),
        computed=elements.energy(computed),
        energy=elements.energy(flux),
        defect=defect,
        variation=np.minimum(variation, defect) if degree == 2 else variation,
        forces=edges,
        balance=balanced,
        residual=float(np.max(np.abs(out))) / scale,
        gradient_by_energy=1 / np.sqrt(conductivity),
        obstacle_work=-np.sum(reaction * below.moments.T, axis=1),
        obstacle_gap=np.sum(reaction * interior.gap, axis=1) if interior else 0.0,
        obstacle_doubt=float(np.sum(reaction * below.doubt.T)),
        is_certain=below.is_certain,
    )
