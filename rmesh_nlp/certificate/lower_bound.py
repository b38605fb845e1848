"""The lower bound of the least energy of a scalar problem as a function of the nodes, with its gradient.

The equilibration is solved to the end here, contact included, so that the bound is a smooth function
wherever strict complementarity holds. Its derivative is that of functions of one element or one edge.

The dual energy at a flux with coefficients c, see
:mod:`rmesh_nlp.certificate.raviart_thomas`, traces W and contact forces P is a sum over elements and edges,

    sum_T ( -1/2 c^T A(X) c + W . (R c) ) - sum_e applied(X) . W - P . (N W + offset(X)),

c_p(X) of c given by the source. The matrices R and N do not change with the positions X, for the element is
mapped such that the flux through its edges is kept. At the solution the sum is stationary in everything but
X, so that its derivative is the partial one.

The oscillation term ``eta r + r^2 / 2`` of an element, eta the variation of the flux, is not quadratic. For
any number e > 0 it is at most

    r (eta^2 / e + e) / 2 + r^2 / 2,

which is, and with which the flux is therefore found: a bound as well, and a smooth one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions, conditions_of
from rmesh_nlp.certificate.equilibration import balanced
from rmesh_nlp.certificate.hybrid import Hybrid, hybrid
from rmesh_nlp.certificate.integrals import edge_rule
from rmesh_nlp.certificate.oscillation import POINCARE
from rmesh_nlp.certificate.polynomials import moments
from rmesh_nlp.certificate.raviart_thomas import (
    FREE,
    RaviartThomas,
    linear_flux,
    obstacle_inside,
    reference,
)
from rmesh_nlp.certificate.skeleton import skeleton_of
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.system import ActiveSet
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.coefficients import Coefficient, at
from rmesh_nlp.problem.laws import Laplace
from rmesh_nlp.problem.rigid import rigid_motions
from rmesh_nlp.vectorised import Columns, columnwise

Index = NDArray[np.int64]

BALANCING = 3
"""Equilibrations on the mesh as given that choose the numbers e of the oscillation term."""

LEAST = 1e-3
"""Least of these numbers, relative to the largest."""


class _Edges(NamedTuple):
    """A function on some edges, and where they stand among what it is multiplied with."""

    kind: str  # "offset", "given" or "applied"
    which: Index
    number: Index
    slope: Columns


@dataclass(frozen=True)
class _State:
    """A solved equilibration: coefficients of the flux, traces of the elements, and forces."""

    e: Array  # (elements,) numbers of the oscillation term
    elements: RaviartThomas
    problem: Hybrid
    flux: Array  # (elements, 8)
    traces: Array  # (elements, 6 or 9), not counted from any base
    force: Array  # of contact, those of an obstacle in the interior first
    reaction: Array  # (traces,) forces through the edges less the applied ones
    value: float


class LowerBound:
    """Evaluates the lower bound of one scalar problem.

    Displacements that it is called with are of ``space``; by default its nodes are the vertices. It raises a
    ValueError if the problem has no certificate, has two components, or a traction that is not linear along
    an edge.
    """

    def __init__(self, problem: ContactProblem, space: DisplacementSpace | None = None) -> None:
        if problem.components != 1:
            raise ValueError("the objective 'certificate' is for scalar problems, and this one is elastic")
        if problem.order != 1:
            raise ValueError("the objective 'certificate' is for displacements of order 1: take order = 1")
        if rigid_motions(problem).size > 0:
            raise ValueError("the objective 'certificate' needs a certificate: only contact holds the body")
        inside = [o for o in problem.obstacles if o.boundary is Place.INTERIOR]
        if len(inside) > 1:
            raise ValueError("the objective 'certificate' takes one obstacle in the interior")
        self.problem, self._node = problem, (space or DisplacementSpace.of(problem)).number
        self._inside = inside[0] if inside else None
        offset = self._inside.offset if self._inside else None
        regions = [(law, which) for law, which in problem.regions if isinstance(law, Laplace)]
        self._groups = [_Elements(law, which, offset) for law, which in regions]
        skeleton = skeleton_of(problem, problem.mesh.p)
        conditions = conditions_of(problem, skeleton)
        largest = float(np.max(np.abs(conditions.traction), initial=0.0))
        bent = conditions.traction_oscillation / np.sqrt(skeleton.lengths)
        if np.max(bent, initial=0.0) > 1e-6 * largest:
            raise ValueError("the objective 'certificate' takes tractions that are linear along each edge")
        self._edges = _edge_functions(problem, conditions)
        self._active: ActiveSet | None = None

    def __call__(self, nodes: Array, displacement: Array) -> tuple[float, Array]:
        """Value and gradient (2, nodes) at positions (2, nodes); the displacement is the base alone."""
        state = self._equilibrated(nodes, displacement[:, self._node], self._variation)
        return state.value, self._gradient(state)

    @cached_property
    def _variation(self) -> Array:
        """(elements,) the numbers e of the oscillation term: variation of the flux on the mesh as given."""
        nodes = np.asarray(self.problem.mesh.p)
        e = np.full(self.problem.mesh.t.shape[1], np.inf)
        if not any(group.varies for group in self._groups):
            return e
        for _ in range(BALANCING):
            state = self._equilibrated(nodes, np.zeros((1, nodes.shape[1])), e)
            found = np.sqrt(state.elements.variation(state.flux))
            e = np.maximum(found, LEAST * np.max(found, initial=0.0) + 1e-300)
        return e

    def _equilibrated(self, nodes: Array, u: Array, e: Array) -> _State:
        """Solve the equilibration, contact included; without oscillation term where e is infinite."""
        skeleton = skeleton_of(self.problem, nodes)
        conditions, count = conditions_of(self.problem, skeleton), skeleton.areas.size
        columns = _columns(skeleton.corners)
        conductivity, r = np.zeros((2, count))
        source, offset = np.zeros((2, 3, count))
        for group in self._groups:
            X = columns[:, group.which]
            conductivity[group.which] = group.conductivity
            source[:, group.which], offset[:, group.which] = group.data([X])
            if group.varies:
                r[group.which] = group.oscillation([X])[0]
        elements = RaviartThomas(skeleton, conductivity, source, self._inside is not None, penalty=r / e)
        computed = linear_flux(skeleton, conductivity * skeleton.gradients(u)[0], 1)
        interior = obstacle_inside(self._inside, skeleton, offset, source, u)
        local = elements.stiffness, elements.source - elements.forces(computed)
        problem = hybrid(skeleton, conditions, local, moments(u[:, skeleton.ends], 1), interior)
        solved = solve(problem.system, self._active)
        self._active, force = solved.active, solved.normal_force
        found = balanced(problem, solved.u, force, np.zeros(0))
        flux, W = computed + elements.coefficients(found.traces), problem.traces(solved.u)
        value = (
            found.reaction_work
            - float(np.sum(elements.energy(flux)))
            - float(force[problem.inside :] @ conditions.offset.ravel())
            - float(np.sum(found.obstacle_force * offset.T))
        )
        if np.all(np.isfinite(e)):
            value -= float(np.sum(r * (elements.variation(flux) / e + e) / 2 + r**2 / 2))
        traces = problem.of_elements(W + problem.start)
        if interior is not None:
            traces[:, 6:] += moments(u[0][skeleton.triangles], 1, 3).T
        return _State(e, elements, problem, flux, traces, force, problem.reaction(W), value)

    def _gradient(self, state: _State) -> Array:
        """(2, nodes) partial derivatives of the dual energy by the positions."""
        elements, problem, skeleton = state.elements, state.problem, state.problem.skeleton
        result, columns = np.zeros(skeleton.nodes.shape), _columns(skeleton.corners)
        strain = np.einsum("eij,ej->ei", elements.minimised, state.flux)
        nu = (state.traces @ elements.rows - strain)[:, FREE[1] :]
        inside = within = np.zeros((len(state.flux), 3))
        if problem.inside:
            inside, within = state.force[: problem.inside].reshape(-1, 3), state.traces[:, 6:]
        for group in self._groups:
            which = group.which
            given = (part[which].T for part in (state.flux, nu, within, inside))
            e = np.minimum(state.e[None, which], 1.0 / np.finfo(float).tiny)
            (slope,) = group.slope([columns[:, which], *given, e])
            _add(result, skeleton.triangles[:, which], slope)
        on_edges = np.zeros((2, skeleton.ends.shape[1]))  # traces at the ends
        of_elements = state.traces[:, :6].reshape(-1, 3, 2).transpose(1, 2, 0)
        on_edges[skeleton.place, skeleton.edges[:, None]] = of_elements
        multipliers = {
            "offset": -state.force[problem.inside :].reshape(2, -1),
            "given": state.reaction[: 2 * skeleton.ends.shape[1]].reshape(-1, 2).T,
            "applied": -on_edges,
        }
        for part in self._edges:
            ends = skeleton.ends[:, part.which]
            arguments = [_columns(skeleton.nodes[:, ends]), multipliers[part.kind][:, part.number]]
            (slope,) = part.slope(arguments)
            _add(result, ends, slope)
        return result


def _edge_functions(problem: ContactProblem, conditions: Conditions) -> list[_Edges]:
    """Those of offsets, given displacements and tractions that change with the nodes."""
    found = []
    for part in conditions.parts:
        if callable(part.obstacle.offset):
            number = np.arange(part.place.start, part.place.stop)
            slope = _on_edge(part.obstacle.offset, number.size)
            found.append(_Edges("offset", part.edges, number, slope))
    for kind, stated in (("given", problem.supports), ("applied", problem.tractions)):
        for one in stated:
            (value,), applied = one.value, kind == "applied"
            if callable(value) or (applied and value):
                edges = np.unique(problem.mesh.boundaries[one.boundary])
                slope = _on_edge(value, edges.size, forces=applied)
                found.append(_Edges(kind, edges, edges, slope))
    return found


def _columns(corners: Array) -> Array:
    """(2 v, cells) coordinates of the vertices of each cell, vertex by vertex, from (2, v, cells)."""
    return np.ascontiguousarray(corners.transpose(1, 0, 2)).reshape(2 * corners.shape[1], -1)


def _add(result: Array, nodes: Index, slope: Array) -> None:
    """Add derivatives by the positions of local nodes, column by column, to those of all (2, nodes)."""
    for i, where in enumerate(nodes):
        for axis in range(2):
            result[axis] += np.bincount(where, slope[2 * i + axis], result.shape[1])


DEGREE = 20
"""Degree of the rule for sources, that of the audit."""

TINY = 1e-24
"""Added to the mean square of what a source leaves, so that its root has a derivative."""

EDGE_POINTS = 10
"""Gauss points for functions on edges."""


class _Elements:
    """The elements of one law, and functions of the columns X (6), c (8) and others of one element.

    - ``data``: ``X -> source at the vertices (3), moments of the obstacle (3)``;
    - ``oscillation``: ``X -> r``, zero unless the source varies;
    - ``slope``: ``(X, c, nu, omega, P, e) -> derivative by X`` of less the energy and the oscillation term,
      with nu against the coefficients that the source prescribes or, with an obstacle, omega against the
      forces of the source and P against the moments of the obstacle.
    """

    def __init__(self, law: Laplace, which: Index, obstacle: Coefficient | None) -> None:
        source, conductivity = law.load[0], law.conductivity
        self.which, self.conductivity, self.varies = which, conductivity, callable(source)
        X_column, c, e = ca.SX.sym("X", 6), ca.SX.sym("c", 8), ca.SX.sym("e")
        nu, omega, P = ca.SX.sym("nu", 3), ca.SX.sym("omega", 3), ca.SX.sym("P", 3)
        X = ca.reshape(X_column, 2, 3)
        F = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
        area = (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]) / 2
        metric = F.T @ F / (4 * area * conductivity)

        def square(products: Array) -> ca.SX:
            matrices = products.reshape(2, 2, 8, 8)
            return ca.SX(sum(metric[i, j] * (c.T @ ca.DM(matrices[i, j]) @ c) for i, j in np.ndindex(2, 2)))

        values, remainder = _linear_part(source, X)
        moments = ca.SX.zeros(3) if obstacle is None else _moments(obstacle, X, *triangle_rule(DEGREE))[0]
        lagrangian, r = -square(reference(1).products) / 2, ca.SX(0)
        if self.varies:
            one, two, three = (ca.sumsqr(X[:, i] - X[:, i - 1]) for i in range(3))
            h_square = ca.fmax(ca.fmax(one, two), three)
            r = POINCARE * ca.sqrt(h_square * area * (remainder + TINY) / conductivity)
            lagrangian -= r * (square(reference(1).variations) / e + e) / 2 + r**2 / 2
        if obstacle is None:
            given = ca.vertcat(ca.sum1(values) / 3, values[0] - values[2], values[1] - values[2])
            lagrangian -= 2 * area * ca.dot(nu, given)
        else:
            lagrangian -= area * ca.dot(omega, values) + ca.dot(P, moments)
        slope = ca.gradient(lagrangian, X_column)
        self.data = self._columns([X_column], values, moments)
        self.oscillation = self._columns([X_column], r)
        self.slope = self._columns([X_column, c, nu, omega, P, e], slope)

    def _columns(self, arguments: list[ca.SX], *values: ca.SX) -> Columns:
        function = ca.Function("of_element", arguments, [ca.densify(value) for value in values])
        return columnwise(function, self.which.size)


def _moments(f: Coefficient, X: ca.SX, barycentric: Array, weights: Array) -> tuple[ca.SX, list[Any]]:
    """Integrals against the barycentric coordinates over the measure of the simplex, and values."""
    if not callable(f):
        return ca.SX([float(f) / barycentric.shape[0]] * barycentric.shape[0]), []
    values = [at(f, *ca.vertsplit(X @ point)) for point in barycentric.T]
    parts = zip(weights, values, barycentric.T, strict=True)
    return ca.SX(sum(w * value * ca.DM(point) for w, value, point in parts)), values


def _linear_part(f: Coefficient, X: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Values at the vertices of the best linear approximation, and the mean square of what it leaves."""
    if not callable(f):
        return ca.SX([float(f)] * 3), ca.SX(0)
    barycentric, weights = triangle_rule(DEGREE)
    moments, values = _moments(f, X, barycentric, weights)
    linear = 12 * moments - 3 * ca.sum1(moments)
    parts = zip(weights, values, barycentric.T, strict=True)
    return linear, ca.SX(sum(w * (value - ca.dot(linear, ca.DM(b))) ** 2 for w, value, b in parts))


def _on_edge(f: Coefficient, edges: int, *, forces: bool = False) -> Columns:
    """``(X, weights) -> derivative by X`` (4) of weights . moments of f on edges with ends X.

    Or of the forces of a traction f: its best linear approximation at the ends, times the length.
    """
    X_column, weights = ca.SX.sym("X", 4), ca.SX.sym("w", 2)
    X = ca.reshape(X_column, 2, 2)
    m = _moments(f, X, *edge_rule(EDGE_POINTS))[0]
    if forces:
        m = ca.norm_2(X[:, 1] - X[:, 0]) * ca.vertcat(4 * m[0] - 2 * m[1], 4 * m[1] - 2 * m[0])
    total = ca.dot(weights, m)
    gradient = ca.densify(ca.gradient(total, X_column))
    return columnwise(ca.Function("edge", [X_column, weights], [gradient]), edges)
