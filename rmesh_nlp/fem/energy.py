"""Energies of elements and loads as CasADi Functions of (X_e, u_e), and where they are on a mesh.

All energies are per unit thickness, in N m/m. Columns run node by node:
``X_e = (x_1, y_1, x_2, y_2, ...)``, and ``u_e`` likewise with one or two components.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.special import roots_jacobi
from skfem.quadrature import get_quadrature_line, get_quadrature_tri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem import arcs
from rmesh_nlp.fem.element import PointValues
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, ElementTerm, Field, Index, constant_field
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem import ContactProblem, PointLoad, Traction
from rmesh_nlp.problem.body import sides_on
from rmesh_nlp.problem.coefficients import Coefficient, at, is_nonzero
from rmesh_nlp.problem.laws import Law, energy_density

HIGHEST_TABULATED_DEGREE = 19
"""Highest degree of scikit-fem's triangle rules."""

TRACTION_DEGREE = 4
"""Least degree of the Gauss rule for tractions: exact for cubic ones times P1. A rule of higher degree for
the load, such as that of the audit, is taken for tractions too."""


def triangle_rule(quadrature: str | int) -> tuple[Array, Array]:
    """Barycentric coordinates (3, points) and weights (points,), summing to 1.

    "midpoint" is the three edge midpoints, exact to degree 2; a number asks for that degree.
    """
    if quadrature == "midpoint":
        return (np.ones((3, 3)) - np.eye(3)) / 2, np.full(3, 1 / 3)
    if not isinstance(quadrature, int) or quadrature < 1:
        raise ValueError(f"quadrature must be 'midpoint' or a degree of at least 1, got {quadrature!r}")
    if quadrature <= HIGHEST_TABULATED_DEGREE:
        points, weights = get_quadrature_tri(quadrature)
    else:
        points, weights = _conical_product_rule(quadrature)
    return np.vstack([1 - points.sum(axis=0), points]), 2 * weights


def _conical_product_rule(degree: int) -> tuple[Array, Array]:
    """Gauss-Jacobi times Gauss-Legendre on the reference triangle, for any degree (Stroud 1971)."""
    n = degree // 2 + 1
    r, weight_r = roots_jacobi(n, 1, 0)
    s, weight_s = roots_jacobi(n, 0, 0)
    x, z = (1 + r) / 2, (1 + s) / 2
    points = np.vstack([np.repeat(x, n), np.outer(1 - x, z).ravel()])
    return points, np.outer(weight_r / 4, weight_s / 2).ravel()


def strain_energy(law: Law) -> ca.Function:
    """``(X_e, u_e) -> (energy, empty)`` of one P1 triangle: 1/2 a(u, u) of (3.3), (3.15)."""
    X, u = ca.SX.sym("X", 2, 3), ca.SX.sym("u", law.components, 3)
    jacobian = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    # gradients of the barycentric coordinates, without a division per entry
    inverse = ca.vertcat(
        ca.horzcat(jacobian[1, 1], -jacobian[0, 1]), ca.horzcat(-jacobian[1, 0], jacobian[0, 0])
    )
    difference = ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0])
    scaled_gradient = difference @ inverse  # det * grad u
    # the density is quadratic, so the division by det comes once, at the end
    energy = energy_density(law, scaled_gradient) / (2 * det)
    return ca.Function("strain_energy", [ca.vec(X), ca.vec(u)], [energy, ca.SX(0, 1)])


def load_energy(law: Law, quadrature: str | int) -> tuple[ca.Function, PointValues]:
    """``(X_e, u_e, load at the points) -> (-integral of load . u, empty)`` of one P1 triangle."""
    barycentric, weights = triangle_rule(quadrature)
    X, u = ca.SX.sym("X", 2, 3), ca.SX.sym("u", law.components, 3)
    return _load_energy(
        law, X, u, _area(X, 0, 1, 2), X @ ca.DM(barycentric), u @ ca.DM(barycentric * weights)
    )


def load_energy_of_edge(law: Law) -> tuple[ca.Function, PointValues]:
    """What the midpoint of an edge adds to :func:`load_energy` from the triangles on both sides.

    ``X_e`` holds the ends and the vertices to the left and right of the edge, ``u_e`` the ends.
    Two triangles share the values there, a third of the work for each of its three edges.
    """
    X, u = ca.SX.sym("X", 2, 4), ca.SX.sym("u", law.components, 2)
    thirds = (_area(X, 0, 1, 2) + _area(X, 1, 0, 3)) / 3
    return _load_energy(law, X, u, thirds, (X[:, 0] + X[:, 1]) / 2, (u[:, 0] + u[:, 1]) / 2)


def _load_energy(
    law: Law, X: ca.SX, u: ca.SX, area: ca.SX, points: ca.SX, weighted: ca.SX
) -> tuple[ca.Function, PointValues]:
    load = ca.SX.sym("f", *weighted.shape)
    columns = [ca.vec(X), ca.vec(u)]
    energy = -area * ca.dot(load, weighted)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    value = ca.vertcat(*[at(component, x, y) for component in law.load])
    return (
        ca.Function("load_energy", [*columns, ca.vec(load)], [energy, ca.SX(0, 1)]),
        PointValues(ca.Function("points", columns, [points]), ca.Function("load", [x, y], [value])),
    )


def _area(X: ca.SX, i: int, j: int, k: int) -> ca.SX:
    return ((X[0, j] - X[0, i]) * (X[1, k] - X[1, i]) - (X[0, k] - X[0, i]) * (X[1, j] - X[1, i])) / 2


def edges_with_opposite(triangles: Index) -> Index:
    """(4, edges): the ends of each edge of some triangles (3, elements), then the vertices beside it.

    Left of the edge first. Where there is no triangle on the right, the first end stands for
    its vertex: that triangle has no area, wherever the nodes go.
    """
    first, second, third = triangles
    directed = np.hstack([[first, second, third], [second, third, first], [third, first, second]])
    low, high = np.sort(directed[:2], axis=0)
    _, left, edge = np.unique(low * (triangles.max() + 1) + high, return_index=True, return_inverse=True)
    result = np.vstack([directed[:, left], directed[0, left]])
    right = np.setdiff1d(np.arange(edge.size), left)
    result[3, edge[right]] = directed[2, right]
    return result


def traction_energy(traction: Traction, degree: int = TRACTION_DEGREE) -> ca.Function:
    """``(X_e, u_e) -> (-integral of traction . u, empty)`` on one boundary edge."""
    X, u = ca.SX.sym("X", 2, 2), ca.SX.sym("u", len(traction.value), 2)
    points, weights = get_quadrature_line(degree)
    work = _work(traction.value, X, u, np.vstack([1 - points, points]), weights)
    length = ca.norm_2(X[:, 1] - X[:, 0])
    return ca.Function("traction_energy", [ca.vec(X), ca.vec(u)], [-length * work, ca.SX(0, 1)])


def point_energy(load: PointLoad) -> ca.Function:
    """``(u_i,) -> (-force . u, empty)`` at one node."""
    u = ca.SX.sym("u", len(load.force))
    return ca.Function("point_energy", [u], [-ca.dot(ca.DM(load.force), u), ca.SX(0, 1)])


def _work(load: tuple[Coefficient, ...], X: ca.SX, u: ca.SX, barycentric: Array, weights: Array) -> Any:
    """Weighted sum of load . u over the points; the mean over the element."""
    work = ca.SX(0)
    for point, weight in zip(barycentric.T, weights, strict=True):
        x, y = ca.vertsplit(X @ point)
        value = ca.vertcat(*[at(component, x, y) for component in load])
        work += weight * ca.dot(value, u @ point)
    return work


def strain_terms(problem: ContactProblem) -> list[ElementTerm]:
    """Strain energy of positions and displacement, a term per region; more for triangles beside a curve."""
    terms = []
    for law, straight, beside in _elements(problem):
        terms.append(ElementTerm(strain_energy(law), (problem.triangles[:, straight],) * 2))
        terms += [_beside(arcs.strain_energy(law, curve), *place) for curve, place in beside]
    return terms


def load_terms(problem: ContactProblem, rule: str | int) -> list[ElementTerm]:
    """Minus the work of source or body force, tractions and point loads, of positions and displacement."""
    terms, degree = [], TRACTION_DEGREE if isinstance(rule, str) else max(rule, TRACTION_DEGREE)
    for law, straight, beside in _elements(problem):
        if any(is_nonzero(component) for component in law.load):
            terms.append(_load_term(law, rule, problem.triangles[:, straight]))
            terms += [_beside(arcs.load_energy(law, curve, degree), *place) for curve, place in beside]
    for traction in problem.tractions:
        for number, edges in problem.edges_by_curve(traction.boundary):
            if number < 0:
                terms.append(ElementTerm(traction_energy(traction, degree), (edges, edges)))
            else:
                function = arcs.traction_energy(traction.value, problem.curves[number], degree)
                terms.append(ElementTerm(function, (None, edges), arc=(number, edges)))
    for load in problem.point_loads:
        terms.append(ElementTerm(point_energy(load), (None, np.array([[load.node]]))))
    return terms


Place = tuple[int, Index]
"""The number of a curve, and the nodes a, b, c (3, elements) of triangles with an arc ab on it."""


def _elements(problem: ContactProblem) -> list[tuple[Law, Index, list[tuple[Curve, Place]]]]:
    """For each region its law, its triangles away from curves, and those beside each curve.

    A triangle with two arcs counts as one beside the first of them: its other side is a chord.
    """
    nodes_of: dict[int, Index] = {}
    owner = np.full(problem.triangles.shape[1], CONSTANT)
    for number, name in enumerate(problem.motion.curves):
        sides = sides_on(problem, np.asarray(problem.mesh.boundaries[name], dtype=np.int64))
        elements, first = np.unique(sides.element, return_index=True)
        first = first[owner[elements] == CONSTANT]
        elements, ends = sides.element[first], sides.ends[:, first]
        owner[elements] = number
        apex = 3 - ends.sum(axis=0)
        local = np.stack([(apex + 1) % 3, (apex + 2) % 3, apex])  # counter-clockwise
        nodes_of[number] = np.zeros((3, owner.size), np.int64)
        nodes_of[number][:, elements] = np.take_along_axis(problem.triangles[:, elements], local, axis=0)
    found = []
    for law, elements in problem.regions:
        beside = [
            (problem.curves[number], (number, nodes[:, elements[owner[elements] == number]]))
            for number, nodes in nodes_of.items()
        ]
        present = [(curve, place) for curve, place in beside if place[1].size]
        found.append((law, elements[owner[elements] == CONSTANT], present))
    return found


def _beside(function: ca.Function, number: int, nodes: Index) -> ElementTerm:
    return ElementTerm(function, (nodes[2:], nodes), arc=(number, nodes[:2]))


def _load_term(law: Law, rule: str | int, triangles: Index) -> ElementTerm:
    if rule == "midpoint":
        edges = edges_with_opposite(triangles)
        function, at_points = load_energy_of_edge(law)
        return ElementTerm(function, (edges, edges[:2]), at_points=at_points)
    function, at_points = load_energy(law, rule)
    return ElementTerm(function, (triangles, triangles), at_points=at_points)


def displacement_field(problem: ContactProblem) -> tuple[Field, int]:
    """The displacement as unknowns numbered from zero, fixed where it is given.

    Returns the field (components, nodes) and the number of unknowns.
    """
    held, value = problem.held()
    field = constant_field(value)
    movable = ~held
    movable[:, np.setdiff1d(np.arange(held.shape[1]), problem.mesh.t)] = False
    count = int(movable.sum())
    # node by node, so that the unknowns of a node stay together
    index = np.full(held.T.shape, CONSTANT)
    index[movable.T] = np.arange(count)
    return Field(index.T, field.scale, field.offset), count


def objective_group(
    function: ca.Function, local: tuple[Field, ...], at_points: PointValues | None = None
) -> ElementGroup:
    """Elements that add to the objective and to no constraint."""
    no_rows = np.zeros((0, local[0].index.shape[1]), dtype=np.int64)
    return ElementGroup(function, local, no_rows, at_points)
