"""Energies of elements and loads as CasADi Functions of (X_e, u_e), and where they are on a mesh.

All energies are per unit thickness, in N m/m. Columns run node by node:
``X_e = (x_1, y_1, x_2, y_2, ...)``, and ``u_e`` likewise with one or two components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Expression
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.cells import Blended, Cell, Rule, Straight
from rmesh_nlp.fem.element import NO_ROWS, PointSums, vector
from rmesh_nlp.fem.fields import NONE, ElementGroup, Field, Fields
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import PointLoad
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


def load_energy(law: Law, cell: Straight, quadrature: str | int) -> tuple[ca.Function, PointSums]:
    """``(X_e, u_e, sums) -> (-work of the load, empty)`` of one triangle, and the sums.

    They are means of the load times shape functions.
    """
    shares, weights = triangle_rule(quadrature)
    x, y, means = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("f", *cell.u.T.shape)
    work = cell.at(shares[:, 0]).det / 2 * ca.dot(means.T, cell.u)
    function = ca.Function("load_energy", [*cell.columns, ca.vec(means)], [-work, NO_ROWS])
    load = ca.Function("load", [x, y], [ca.densify(ca.SX(vector(law.load, x, y)))], OPEN)
    return function, PointSums(load, shares, functions(cell.order, shares) * weights)


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


def strain(on: Fields) -> list[ElementGroup]:
    """The strain energy, by region; beside a curve by curve."""
    return [on.group(strain_energy(law, cell), local) for law, cell, local in _cells(on)]


def loads(on: Fields, rule: str | int) -> list[ElementGroup]:
    """Minus the work of source or body force, tractions and point loads."""
    groups = []
    degree = traction_degree(rule)
    for law, cell, local in _cells(on):
        if not any(is_nonzero(component) for component in law.load):
            continue
        if isinstance(cell, Straight):
            function, at_points = load_energy(law, cell, rule)
            groups.append(on.group(function, local, at_points=at_points))
        else:
            groups.append(on.group(force_energy(law.load, cell, cell.rule(degree)), local))
    for traction in on.problem.tractions:
        for edge, place, nodes in on.edges(traction.boundary, on.problem.components):
            if isinstance(edge, Straight):
                pieces = piecewise_rule(degree, breaks(traction.value, edge.X))
            else:
                pieces = edge.rule(degree)
            groups.append(
                on.group(force_energy(traction.value, edge, pieces), [place, on.displacement.at(nodes)])
            )
    for load in on.problem.point_loads:
        groups.append(on.group(point_energy(load), [on.displacement.at(np.array([[load.node]]))]))
    return groups


def _cells(on: Fields) -> Iterator[tuple[Law, Straight | Blended, list[Field]]]:
    """For each region its law and its triangles, those away from curves and those beside each curve.

    With their local values, of place and displacement. A triangle with two arcs counts as one beside the
    first of them: its other side is a chord.
    """
    problem, order = on.problem, on.space.order
    vertices, owner = problem.triangles.copy(), np.full(problem.triangles.shape[1], NONE)
    for number, name in enumerate(problem.motion.curves):
        sides = sides_on(problem, np.asarray(problem.mesh.boundaries[name], dtype=np.int64))
        elements, first = np.unique(sides.element, return_index=True)
        new = owner[elements] == NONE
        elements, apex = elements[new], 3 - sides.ends[:, first[new]].sum(axis=0)
        owner[elements] = number
        local = np.stack([(apex + 1) % 3, (apex + 2) % 3, apex])  # counter-clockwise, the arc first
        vertices[:, elements] = np.take_along_axis(vertices[:, elements], local, axis=0)
    for law, elements in problem.regions:
        for number in np.unique(owner[elements]).tolist():
            chosen = vertices[:, elements[owner[elements] == number]]
            u = on.displacement.at(on.space.nodes_of(chosen))
            if number == NONE:
                yield law, Straight(3, law.components, order), [on.positions.at(chosen), u]
            else:
                place = on.parameters(number, chosen[:2]), on.positions.at(chosen[2:])
                yield law, Blended(problem.curves[number], law.components, order), [*place, u]


def displacement_field(space: DisplacementSpace) -> tuple[Field, int]:
    """The displacement as unknowns numbered from zero, fixed where it is given.

    Returns the field (components, nodes) and the number of unknowns.
    """
    held, value = space.given()
    count = int((~held).sum())
    # node by node, so that the unknowns of a node stay together
    index = np.full(held.T.shape, NONE)
    index[~held.T] = np.arange(count)
    return Field(index.T, np.ones(value.shape), value), count
