"""Equilibrated fluxes of scalar problems: the Raviart-Thomas element of the second order [1]_.

The flux is linear on each edge, and balances a source that is linear on each element. That of the lowest
order is cheaper, but its own error is as large as that of linear displacements.

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
from rmesh_nlp.certificate.skeleton import AFTER, CORNERS, Skeleton, edge_normals
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.laws import Laplace

FREE = 5
"""Functions without divergence."""


@dataclass(frozen=True)
class Reference:
    """Functions on the reference triangle.

    First the curls of x, y, x^2, x y, y^2, of no divergence; then (x - centre) / 2, of divergence 1;
    then ``phi_i (x - x_i) / 3`` for the first two vertices, of divergence phi_i - 1/3, which have no normal
    component on the edges. That of the third vertex is less the sum of these two.
    """

    products: Array  # (4, 64), integrals of products of components a, b of two functions, over the area
    variations: Array  # (4, 64), the same of the functions less their means
    means: Array  # (2, 8)
    forces: Array  # (3 edges, 2 ends, 8), normal components, counter-clockwise, times the edge's length


@lru_cache(maxsize=1)
def reference() -> Reference:
    """The element on the reference triangle."""
    barycentric, weights = triangle_rule(4)
    values = _functions(barycentric)
    means = np.einsum("p,apk->ak", weights, values)
    deviations = values - means[:, None]
    products, variations = (
        np.einsum("p,apk,bpl->abkl", weights, some, some).reshape(4, 64) for some in (values, deviations)
    )
    normals, at_corners = edge_normals(CORNERS), _functions(np.eye(3))
    forces = np.stack([np.einsum("c,cek->ek", normals[:, i], at_corners[:, AFTER[i]]) for i in range(3)])
    return Reference(products, variations, means, forces)


def _functions(barycentric: Array) -> Array:
    """(2, points, 8) values at points given by barycentric coordinates (3, points)."""
    x, y = CORNERS @ barycentric
    zero, one = np.zeros_like(x), np.ones_like(x)
    curls = [(zero, -one), (one, zero), (zero, -2 * x), (x, -y), (2 * y, zero)]
    radial = [((x - 1 / 3) / 2, (y - 1 / 3) / 2)]
    bubbles = [
        (phi * (x - corner[0]) / 3, phi * (y - corner[1]) / 3)
        for phi, corner in zip(barycentric[:2], CORNERS.T[:2], strict=True)
    ]
    return np.array([*curls, *radial, *bubbles]).transpose(1, 2, 0)


@dataclass(frozen=True)
class RaviartThomas:
    """The elements of a scalar problem, and the work of their fluxes on the traces at their edges.

    The unknowns of an element are, for each edge and each of its ends, counter-clockwise, the moments
    of the displacement against the linear function of that end, divided by the length of the edge.

    With ``obstacle`` the reaction of an obstacle, linear on each element, is to be found too. The moments of
    the displacement against the linear functions of the vertices, divided by the area, are unknowns as well
    then; their forces are the values of source and reaction at the vertices, times the area.
    """

    skeleton: Skeleton
    conductivity: Array  # (elements,)
    load: Array  # (3, elements), values of the source at the vertices
    obstacle: bool = False
    penalty: Array | float = 0.0  # (elements,), weight of the squared variation in what the flux minimises

    @cached_property
    def metric(self) -> Array:
        """(elements, 4) factors of integrals of products of components on the reference triangle."""
        metric = np.einsum("eca,ecb->eab", self.skeleton.jacobian, self.skeleton.jacobian).reshape(-1, 4)
        # over the area: integral of |tau|^2 = area / J^2 tau_ref . G tau_ref, and J = 2 area
        return np.asarray(metric / (4 * self.skeleton.areas * self.conductivity)[:, None])

    @cached_property
    def compliance(self) -> Array:
        """(elements, 8, 8) integrals of ``tau . tau' / k`` over pairs of functions."""
        return np.asarray((self.metric @ reference().products).reshape(-1, 8, 8))

    @cached_property
    def minimised(self) -> Array:
        """(elements, 8, 8) matrices of what the flux minimises, the energy with the penalty."""
        if np.isscalar(self.penalty):
            return self.compliance
        metric = self.metric * np.asarray(self.penalty)[:, None]
        return np.asarray(self.compliance + (metric @ reference().variations).reshape(-1, 8, 8))

    @cached_property
    def prescribed(self) -> Array:
        """(elements, 3) coefficients of the functions with divergence; to be found for an obstacle."""
        if self.obstacle:
            return np.zeros((self.load.shape[1], 3))
        values = np.stack([self.load.mean(axis=0), self.load[0] - self.load[2], self.load[1] - self.load[2]])
        return np.ascontiguousarray((-2 * self.skeleton.areas * values).T)

    @property
    def free(self) -> int:
        """Number of the functions that the source leaves free, which come first."""
        return FREE + 3 * int(self.obstacle)

    @cached_property
    def rows(self) -> Array:
        """(6 or 9, 8) forces by coefficients: through the edges, and less the divergence at the vertices."""
        edges = reference().forces.reshape(6, 8)
        if not self.obstacle:
            return edges
        # times the area, 1/2 on the reference triangle, after division by the Jacobian
        inflow = np.zeros((3, 8))
        inflow[:, FREE] = -0.5
        inflow[:, FREE + 1 :] = -0.5 * (np.eye(3)[:, :2] - 1 / 3)
        return np.vstack([edges, inflow])

    @cached_property
    def _response(self) -> tuple[Array, Array]:
        """Coefficients of the free functions: by traces, and by the source."""
        A, n, rows = self.minimised, self.free, self.rows
        by_load = np.einsum("eij,ej->ei", A[:, :n, FREE:], self.prescribed)
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
        """(elements, 8) coefficients of the flux for traces (elements, k)."""
        by_trace, by_load = self._response
        return self._with_prescribed(np.einsum("eij,ej->ei", by_trace, traces) + by_load)

    def _with_prescribed(self, free: Array) -> Array:
        result = np.hstack([np.zeros((len(free), FREE)), self.prescribed])
        result[:, : self.free] += free
        return result

    def constant(self, flux: Array) -> Array:
        """(elements, 8) coefficients of a flux (2, elements) that is constant on each element."""
        result = np.zeros((flux.shape[1], 8))
        pulled = (2 * self.skeleton.areas * flux).T[:, :, None]
        x, y = np.linalg.solve(self.skeleton.jacobian, pulled)[:, :, 0].T
        result[:, 0], result[:, 1] = -y, x
        return result

    def forces(self, coefficients: Array) -> Array:
        """(elements, k) normal fluxes at the ends of the edges times their length, and the inflow."""
        return np.asarray(coefficients @ self.rows.T)

    def energy(self, coefficients: Array) -> Array:
        """(elements,) integrals of ``|tau|^2 / (2 k)``."""
        return _squares(self.compliance, coefficients) / 2

    def variation(self, coefficients: Array) -> Array:
        """(elements,) squares of the distance of the flux from its mean, in the energy norm."""
        return _squares((self.metric @ reference().variations).reshape(-1, 8, 8), coefficients)

    def mean(self, coefficients: Array) -> Array:
        """(2, elements) means."""
        pushed = np.einsum("eab,eb->ae", self.skeleton.jacobian, coefficients @ reference().means.T)
        return np.asarray(pushed / (2 * self.skeleton.areas))


def _squares(A: Array, coefficients: Array) -> Array:
    """(elements,) values of quadratic forms; not negative, however thin the element."""
    values = np.einsum("ei,eij,ej->e", coefficients, A, coefficients, optimize=True)
    return np.asarray(np.maximum(values, 0.0))


def obstacle_inside(
    obstacle: Obstacle | None, skeleton: Skeleton, offset: Array, source: Array, u: Array
) -> InteriorObstacle | None:
    """The obstacle in the interior in the terms of the traces from a base ``u`` (1, nodes), if there is one.

    ``offset`` are the moments of its gap without displacement, ``source`` the values of the source at the
    vertices: (3, elements) arrays.
    """
    if obstacle is None:
        return None
    sign = obstacle.normal[0]
    return InteriorObstacle(sign, offset.T + sign * moments(u, skeleton), (source * skeleton.areas).T)


def moments(u: Array, skeleton: Skeleton) -> Array:
    """(elements, 3) moments of a linear displacement (1, nodes) against the barycentric coordinates."""
    at_vertices = u[0][skeleton.triangles].T
    return np.asarray((at_vertices + at_vertices.sum(axis=1, keepdims=True)) / 12)


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
    (source,), u = load.linear, guess.displacement
    below = integrals(inside[0].offset if inside else 0.0, skeleton.corners)
    interior = obstacle_inside(inside[0] if inside else None, skeleton, below.moments, source, u)
    elements = RaviartThomas(skeleton, conductivity, source, bool(inside))
    computed = elements.constant(conductivity * skeleton.gradients(u)[0])
    exerted = elements.forces(computed)
    found = hybrid(skeleton, conditions, (elements.stiffness, elements.source - exerted), u, interior)
    balanced = balance(found, guess, products)
    correction, reaction = elements.coefficients(balanced.traces), balanced.obstacle_force
    flux = computed + correction
    forces = elements.forces(flux)
    # what leaves an element through its edges is the source and the reaction within it
    wanted = (source * skeleton.areas).T + (interior.sign * reaction if interior else 0.0)
    edges, inflow = forces[:, :6], forces[:, 6:]
    out = np.append(edges.sum(axis=1) / 2 + wanted.mean(axis=1), inflow - wanted[:, : inflow.shape[1]])
    scale = max(float(np.max(np.abs(part), initial=1e-300)) for part in (edges, wanted))
    return EquilibratedField(
        values=elements.mean(flux),
        computed=elements.energy(computed),
        energy=elements.energy(flux),
        defect=np.sqrt(2 * elements.energy(correction)),
        variation=np.sqrt(elements.variation(correction)),
        forces=edges,
        balance=balanced,
        residual=float(np.max(np.abs(out))) / scale,
        gradient_by_energy=1 / np.sqrt(conductivity),
        obstacle_work=-np.sum(reaction * below.moments.T, axis=1),
        obstacle_gap=np.sum(reaction * interior.gap, axis=1) if interior else 0.0,
        obstacle_doubt=float(np.sum(reaction * below.doubt.T)),
    )
