"""Energies of elements and loads as CasADi Functions of (X_e, u_e), and where they are on a mesh.

All energies are per unit thickness, in N m/m. Columns run node by node:
``X_e = (x_1, y_1, x_2, y_2, ...)``, and ``u_e`` likewise with one or two components.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Index
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.cells import Blended, Cell, Straight, shape_functions
from rmesh_nlp.fem.element import NO_ROWS, PointSums, vector
from rmesh_nlp.fem.fields import NONE, Field, Fields
from rmesh_nlp.fem.functional import Groups
from rmesh_nlp.fem.pieces import cuts, piecewise
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import sides_on
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at, is_nonzero, once
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.quadrature import CORNER, traction_degree, triangle_rule

RATIONAL: dict[int | str, float] = {4: 0.837, 7: 0.493, 11: 0.254, CORNER: 0.0}
"""Degrees of rules, less that of the measure, and the least r of a triangle in terms of its largest one.

The error of a rule of degree d for functions that are rational in r is about ``((1 + a) / (1 - a))^(1 - d)``
of them, a the root of that share (L. N. Trefethen, SIAM Review 50, 2008): here 5e-6 of a stiffness.
"""


@once
def strain_energy(law: Law, cell: Straight | Blended, degree: int | str | None = None) -> ca.Function:
    """``(*place, u_e) -> (energy, empty)`` of one triangle: 1/2 a(u, u) of (3.3), (3.15).

    Its rule is of a degree and that of the measure; by default it is that of a plane body. Of a body of
    revolution it is without :func:`hoop_energy`, and so a polynomial in a straight triangle.
    """
    energy = cell.kind(0)
    for shares, weight in cell.energy_rule if degree is None else cell.rule(degree):
        point = cell.at(shares)
        u = point.det * cell.displacement(shares)
        density = law.energy_density(law.extended(point.scaled, u, point.x))
        if law.has_hoop:
            density -= law.energy_density(law.extended(0 * point.scaled, u, point.x))
        energy += weight * point.part * density / point.det  # quadratic: one division
    return cell.function("strain_energy", energy)


@once
def hoop_energy(law: Law, cell: Straight | Blended, degree: int | str) -> ca.Function:
    """``(*place, u_e) -> (energy, empty)`` of u itself in one triangle: u_r / r squared is rational."""
    own, u = cell.kind.sym("own", law.components), cell.columns[-1]
    square = cell.kind(*2 * u.shape[:1])
    for shares, weight in cell.rule(degree):
        point, values = cell.at(shares), shape_functions(cell.order, shares)
        density = law.energy_density(law.extended(ca.DM(law.components, 2), own, point.x))
        each = ca.hessian(density, own)[0] * weight * point.part * point.det / 2
        square += ca.kron(values @ values.T, each)
    return cell.function("hoop_energy", ca.bilin(square, u, u))


@once
def load_energy(law: Law, cell: Straight, quadrature: str | int) -> tuple[ca.Function, PointSums]:
    """``(X_e, u_e, sums) -> (-work of the load, empty)`` of one triangle, and the sums.

    They are means of the load times shape functions, between its affine jumps where these cut a triangle.
    """
    shares, weights = triangle_rule(quadrature)
    x, y, means = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("f", *cell.u.T.shape)
    work = cell.at(shares[:, 0]).det / 2 * ca.dot(means.T, cell.u)
    function = ca.Function("load_energy", [*cell.columns, ca.vec(means)], [-work, NO_ROWS])
    density = ca.SX(vector(law.load, x, y)) * at(cell.measure, x, y)
    load = ca.Function("load", [x, y], [ca.densify(density)], OPEN)
    switches, cut = cuts(cell, law.load, quadrature), None
    if switches:
        sums = sum(
            weight * shape_functions(cell.order, share) @ load(*ca.vertsplit(cell.X @ share)).T
            for share, weight in piecewise(cell, law.load, quadrature)
        )
        signs = [ca.vertcat(*(s(*ca.vertsplit(x)) for x in ca.horzsplit(cell.X))) for s in switches]
        cut = ca.Function("cut", cell.columns[:1], [ca.vec(sums), ca.horzcat(*signs)], OPEN)
    return function, PointSums(load, shares, functions(cell.order, shares) * weights, cut)


@once
def force_energy(force: tuple[Coefficient, ...], cell: Cell, degree: str | int) -> ca.Function:
    """``(*place, u_e) -> (-integral of force . u, empty)``: a load on a triangle, a traction on an edge."""
    rule = piecewise(cell, force, degree) if isinstance(cell, Straight) else cell.rule(degree)
    work = cell.integral(lambda x, y, u, _: ca.dot(vector(force, x, y), u), rule)
    return cell.function("force_energy", -work)


def point_energy(force: tuple[float, ...]) -> ca.Function:
    """``(u_i,) -> (-force . u, empty)`` at one node."""
    u = ca.SX.sym("u", len(force))
    return ca.Function("point_energy", [u], [-ca.dot(ca.vertcat(*force), u), NO_ROWS], OPEN)


def strain(on: Fields) -> Groups:
    """The strain energy, by region; beside a curve by curve."""
    groups = []
    for law, cell, local, vertices in _cells(on):
        degree = 2 * (cell.order - law.has_hoop) if law.varies else None
        groups.append(on.group(strain_energy(law, cell, degree), local))
        for rule, own in _rules(on.problem, vertices) if law.has_hoop else ():
            groups.append(on.group(hoop_energy(law, cell, rule), [field.elements(own) for field in local]))
    return groups


def _rules(problem: ContactProblem, vertices: Index) -> Iterator[tuple[int | str, Index]]:
    """Degrees of rules for the hoop energy, and which triangles with vertices (3, n) take them.

    With a side on the axis u_r / r is a polynomial.
    """
    r = np.where(problem.on_axis, 0.0, problem.mesh.p[0])[vertices]
    share = np.where(np.sum(r == 0, axis=0) == 2, 1.0, np.min(r, axis=0) / np.max(r, axis=0))
    first = np.searchsorted(-np.array(list(RATIONAL.values())), -share)
    for number in np.unique(first).tolist():
        yield list(RATIONAL)[number], np.flatnonzero(first == number)


def loads(on: Fields, rule: str | int) -> Groups:
    """Minus the work of source or body force, tractions, point loads and forces on tools."""
    groups = []
    for law, cell, local, _ in _cells(on):
        if not any(map(is_nonzero, law.load)):
            continue
        if isinstance(cell, Straight):
            function, at_points = load_energy(law, cell, rule)
            groups.append(on.group(function, local, at_points=at_points))
        else:
            groups.append(on.group(force_energy(law.load, cell, rule), local))
    for traction in on.problem.tractions:
        for edge, place, nodes in on.edges(traction.boundary, on.problem.components):
            function = force_energy(traction.value, edge, traction_degree(rule))
            groups.append(on.group(function, [place, on.displacement.at(nodes)]))
    for node, force in on.space.forces:
        groups.append(on.group(point_energy(force), [on.displacement.at(np.array([[node]]))]))
    return groups


def _cells(on: Fields) -> Iterator[tuple[Law, Straight | Blended, list[Field], Index]]:
    """For each region its law and its triangles, those away from curves and those beside each curve.

    With their local values, of place and displacement, and their vertices: of a body of revolution, away from
    curves, the second one is the nearest to the axis. A triangle with two arcs counts as one beside the first
    of them: its other side is a chord.
    """
    problem, order = on.problem, on.space.order
    vertices, owner = problem.triangles.copy(), np.full(problem.mesh.nelements, NONE)
    for number, name in enumerate(problem.motion.curves):
        sides = sides_on(problem, problem.mesh.boundaries[name])
        elements, first = np.unique(sides.element, return_index=True)
        new = owner[elements] == NONE
        elements, apex = elements[new], 3 - sides.ends[:, first[new]].sum(axis=0)
        owner[elements] = number
        local = np.stack([(apex + 1) % 3, (apex + 2) % 3, apex])  # counter-clockwise, the arc first
        vertices[:, elements] = np.take_along_axis(vertices[:, elements], local, axis=0)
    if problem.axisymmetric:
        turn = np.argmin(problem.mesh.p[0, vertices], axis=0) + np.arange(-1, 2)[:, None]
        turned = np.take_along_axis(vertices, turn % 3, axis=0)
        vertices = np.where(owner == NONE, turned, vertices)
    for law, elements in problem.regions:
        for number in np.unique(owner[elements]).tolist():
            chosen = vertices[:, elements[owner[elements] == number]]
            u = on.displacement.at(on.space.nodes_of(chosen))
            if number == NONE:
                cell: Straight | Blended = Straight(3, law.components, order, law.measure)
                place = [on.positions.at(chosen)]
            else:
                cell = Blended(problem.curves[number], law.components, order, law.measure)
                place = [on.parameters(number, chosen[:2]), on.positions.at(chosen[2:])]
            yield law, cell, [*place, u], chosen


def displacement_field(space: DisplacementSpace) -> tuple[Field, int]:
    """The displacement as unknowns numbered from zero, fixed where it is given.

    With an origin the unknowns are what is added to it, so that slip is counted from there.

    Returns the field (components, nodes) and the number of unknowns.
    """
    held, value = space.given()
    count = int((~held).sum())
    # node by node, so that the unknowns of a node stay together
    index = np.full(held.T.shape, NONE)
    index[~held.T] = np.arange(count)
    start = value if space.problem.origin is None else np.where(held, value, space.problem.origin)
    return Field(index.T, np.ones(value.shape), start), count
