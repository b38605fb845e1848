"""Energies of elements and loads as CasADi Functions of (X_e, u_e), and where they are on a mesh.

All energies are per unit thickness, in N m/m. Columns run node by node:
``X_e = (x_1, y_1, x_2, y_2, ...)``, and ``u_e`` likewise with one or two components.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Expression
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.cells import Arc, Blended, Cell, Rule, Straight
from rmesh_nlp.fem.element import NO_ROWS, vector
from rmesh_nlp.fem.fields import CONSTANT, ElementTerm, Field, constant_field
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem import ContactProblem, PointLoad
from rmesh_nlp.problem.body import sides_on
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, is_nonzero
from rmesh_nlp.problem.laws import Law, energy_density
from rmesh_nlp.problem.quadrature import line_rule, traction_degree, triangle_rule
from rmesh_nlp.problem.switches import switches

MOST_BREAKS = 4
"""Pieces of an edge are as many and one."""


def strain_energy(law: Law, cell: Straight | Blended) -> ca.Function:
    """``(*place, u_e) -> (energy, empty)`` of one triangle: 1/2 a(u, u) of (3.3), (3.15)."""
    energy = cell.kind(0)
    for shares, weight in cell.energy_rule:
        at = cell.at(shares)
        energy += weight * at.part * energy_density(law, at.scaled) / at.det  # a quadratic one: one division
    return cell.function("strain_energy", energy)


def load_energy(law: Law, quadrature: str | int, order: int) -> tuple[ca.Function, PointValues]:
    """``(X_e, u_e, means of load times shape functions) -> (-work of the load, empty)`` of one triangle."""
    shares, weights = triangle_rule(quadrature)
    cell = Straight(3, law.components, order)
    load = ca.SX.sym("f", *cell.u.shape)
    work = cell.at(shares[:, 0]).det / 2 * ca.dot(load, cell.u)
    energy = ca.Function("load_energy", [*cell.columns, ca.vec(load)], [-work, NO_ROWS])
    weights = functions(order, shares) * weights
    return energy, PointValues.of(lambda x, y: vector(law.load, x, y), shares, weights)


def force_energy(force: tuple[Coefficient, ...], cell: Cell, rule: Rule) -> ca.Function:
    """``(*place, u_e) -> (-integral of force . u, empty)``: a load on a triangle, a traction on an edge."""
    work = cell.integral(lambda x, y, u, _: ca.dot(vector(force, x, y), u), rule)
    return cell.function("force_energy", -work)


def piecewise_rule(degree: int, places: Sequence[Expression]) -> Rule:
    """A rule for each piece of an edge between ``places``, in ascending order from 0 to 1."""
    points, weights = line_rule(degree)
    for first, last in pairwise((0.0, *places, 1.0)):
        for share, weight in zip(points[1], weights, strict=True):
            s = first + share * (last - first)
            yield ca.vertcat(1 - s, s), weight * (last - first)


def breaks(coefficients: Sequence[Coefficient], X: ca.SX) -> list[ca.SX]:
    """Where coefficients jump or kink on an edge with ends ``X`` (2, 2), in ascending order from 0 to 1.

    They follow the nodes, so that a rule has nothing to gain by a node that goes past a jump. Only zeros of
    affine switches are looked for, and only up to ``MOST_BREAKS``; one that is not on the edge is 0.
    """
    zero_of: dict[str, ca.SX] = {}
    for one in filter(None, map(switches, coefficients)):
        for function, degree in zip(one.functions, one.degrees, strict=True):
            if degree == 1:
                first, last = (function(*ca.vertsplit(X[:, k])) for k in (0, 1))
                zero = ca.if_else(first * last < 0, first / (first - last), 0)
                zero_of.setdefault(str(zero), zero)
    zeros = list(zero_of.values()) if len(zero_of) <= MOST_BREAKS else []
    for end in range(len(zeros) - 1, 0, -1):
        for k in range(end):
            zeros[k : k + 2] = ca.fmin(*zeros[k : k + 2]), ca.fmax(*zeros[k : k + 2])
    return zeros


def point_energy(load: PointLoad) -> ca.Function:
    """``(u_i,) -> (-force . u, empty)`` at one node."""
    u = ca.SX.sym("u", len(load.force))
    return ca.Function("point_energy", [u], [-ca.dot(ca.vertcat(*load.force), u), NO_ROWS], OPEN)


def strain_terms(space: DisplacementSpace) -> list[ElementTerm]:
    """Strain energy of positions and displacement, a term per region; more for triangles beside a curve."""
    terms = []
    for law, straight, beside in _elements(space.problem):
        vertices = space.problem.triangles[:, straight]
        function = strain_energy(law, Straight(3, law.components, space.order))
        terms.append(ElementTerm(function, (vertices, space.nodes_of(vertices))))
        for curve, place in beside:
            function = strain_energy(law, Blended(curve, law.components, space.order))
            terms.append(_beside(space, function, *place))
    return terms


def load_terms(space: DisplacementSpace, rule: str | int) -> list[ElementTerm]:
    """Minus the work of source or body force, tractions and point loads, of positions and displacement."""
    problem, terms = space.problem, []
    degree = traction_degree(rule)
    for law, straight, beside in _elements(problem):
        if any(is_nonzero(component) for component in law.load):
            terms.append(_load_term(space, law, rule, problem.triangles[:, straight]))
            for curve, place in beside:
                triangle = Blended(curve, law.components, space.order)
                terms.append(_beside(space, force_energy(law.load, triangle, triangle.rule(degree)), *place))
    for traction in problem.tractions:
        for number, edges in problem.edges_by_curve(traction.boundary):
            nodes = space.nodes_of(edges)
            if number < 0:
                edge = Straight(2, problem.components, space.order)
                pieces = piecewise_rule(degree, breaks(traction.value, edge.X))
                terms.append(ElementTerm(force_energy(traction.value, edge, pieces), (edges, nodes)))
            else:
                arc = Arc(problem.curves[number], problem.components, space.order)
                function = force_energy(traction.value, arc, arc.rule(degree))
                terms.append(ElementTerm(function, (None, nodes), arc=(number, edges)))
    for load in problem.point_loads:
        terms.append(ElementTerm(point_energy(load), (None, space.nodes_of(np.array([[load.node]])))))
    return terms


Place = tuple[int, Index]
"""The number of a curve, and the vertices a, b, c (3, elements) of triangles with an arc ab on it."""


def _elements(problem: ContactProblem) -> list[tuple[Law, Index, list[tuple[Curve, Place]]]]:
    """For each region its law, its triangles away from curves, and those beside each curve.

    A triangle with two arcs counts as one beside the first of them: its other side is a chord.
    """
    vertices, owner = problem.triangles.copy(), np.full(problem.triangles.shape[1], CONSTANT)
    for number, name in enumerate(problem.motion.curves):
        sides = sides_on(problem, np.asarray(problem.mesh.boundaries[name], dtype=np.int64))
        elements, first = np.unique(sides.element, return_index=True)
        new = owner[elements] == CONSTANT
        elements, apex = elements[new], 3 - sides.ends[:, first[new]].sum(axis=0)
        owner[elements] = number
        local = np.stack([(apex + 1) % 3, (apex + 2) % 3, apex])  # counter-clockwise, the arc first
        vertices[:, elements] = np.take_along_axis(vertices[:, elements], local, axis=0)
    regions = []
    for law, elements in problem.regions:
        of = owner[elements]
        beside = [
            (problem.curves[k], (k, vertices[:, elements[of == k]])) for k in np.unique(of[of >= 0]).tolist()
        ]
        regions.append((law, elements[of == CONSTANT], beside))
    return regions


def _beside(space: DisplacementSpace, function: ca.Function, number: int, vertices: Index) -> ElementTerm:
    return ElementTerm(function, (vertices[2:], space.nodes_of(vertices)), arc=(number, vertices[:2]))


def _load_term(space: DisplacementSpace, law: Law, rule: str | int, triangles: Index) -> ElementTerm:
    function, at_points = load_energy(law, rule, space.order)
    return ElementTerm(function, (triangles, space.nodes_of(triangles)), at_points=at_points)


def displacement_field(space: DisplacementSpace) -> tuple[Field, int]:
    """The displacement as unknowns numbered from zero, fixed where it is given.

    Returns the field (components, nodes) and the number of unknowns.
    """
    held, value = space.given()
    count = int((~held).sum())
    # node by node, so that the unknowns of a node stay together
    index = np.full(held.T.shape, CONSTANT)
    index[~held.T] = np.arange(count)
    field = constant_field(value)
    return Field(index.T, field.scale, field.offset, space=space), count
