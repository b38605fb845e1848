"""Outer objectives other than the energy, as element groups of positions and displacement.

Errors are measured against the problem's exact solution u:

``error-energy``  I1 of (4.1), 1/2 a(u_h - u, u_h - u)
``error-l2``      squared L2 norm of u_h - u
``error-h1``      squared H1 seminorm of u_h - u
``contact``       I2 of (4.2), the work of the exact contact stress on the discrete gap
``friction``      I3 of (4.2), what friction takes on the discrete slip less the work of the exact stress
``certificate``   guaranteed bound of half the squared error in the energy norm of a scalar problem, see
                  :mod:`rmesh_nlp.models.reduced_model`; no exact solution is needed
``quality``, ``shape-size``, ``elastic``
                  distortion against the initial mesh, see :mod:`rmesh_nlp.fem.distortion`
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.fem.contact_terms import contact_edges, friction_terms
from rmesh_nlp.fem.distortion import DISTORTIONS, distortion_group
from rmesh_nlp.fem.energy import load_terms, objective_group, strain_terms, triangle_rule
from rmesh_nlp.fem.fields import ElementGroup, Field, Index
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.problem import ContactProblem, ExactSolution, Law, Obstacle
from rmesh_nlp.problem.laws import energy_density

ERROR_DEGREE = 10
"""Degree of the rules for error integrals: high, since an optimiser exploits a low one."""

SPLINE_DEGREE = 5
"""The same for a reference given by splines, which are dear and smooth on the scale of an element."""


def energy(problem: ContactProblem, positions: Field, displacement: Field, slip: Field) -> list[ElementGroup]:
    """The total potential energy (3.3), (3.15)."""
    bulk = [*strain_terms(problem), *load_terms(problem, problem.rule)]
    return [
        *(term.on(positions, displacement) for term in bulk),
        *(term.on(positions, slip) for term in friction_terms(problem)),
    ]


def error_energy(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """I1 of (4.1)."""
    exact = _exact(problem, "error-energy")
    return [
        _triangles(problem, positions, displacement, partial(_strain_energy_of_error, law), exact, elements)
        for law, elements in problem.regions
    ]


def _strain_energy_of_error(law: Law, error: Any, gradient: Any) -> Any:
    return energy_density(law, gradient)


def error_l2(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """Squared L2 norm of the error."""
    exact = _exact(problem, "error-l2")
    return [_triangles(problem, positions, displacement, lambda e, de: ca.sumsqr(e), exact)]


def error_h1(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """Squared H1 seminorm of the error."""
    exact = _exact(problem, "error-h1")
    return [_triangles(problem, positions, displacement, lambda e, de: ca.sumsqr(de), exact)]


def contact(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """I2 of (4.2): integral of (T(u) . normal) times the discrete gap over the contact boundary.

    T(u) is the exact traction (the outward normal derivative of a scalar problem).
    """
    exact = _exact(problem, "contact")
    if len(problem.laws) > 1 or any(not isinstance(o.boundary, str) for o in problem.obstacles):
        raise ValueError("the objective 'contact' needs one law and contact on a boundary")
    return [
        _contact_work(problem, positions, displacement, exact, obstacle) for obstacle in problem.obstacles
    ]


def friction(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """I3 of (4.2): integral of ``g |u_t| + T_t(u) u_t`` over the contact boundary.

    u_t is the discrete slip and T_t(u) the exact tangential stress on the body, of size g at most, so the
    integrand is not negative; it vanishes where the discrete solution sticks and slides as the exact one.
    The first part is taken by the trapezoidal rule, as in the energy (5.9), the second accurately.
    """
    exact = _exact(problem, "friction")
    if not problem.frictional:
        raise ValueError("the objective 'friction' needs a contact boundary with friction")
    if len(problem.laws) > 1:
        raise ValueError("the objective 'friction' needs one law")
    return [
        *(term.on(positions, slip) for term in friction_terms(problem)),
        *(
            _contact_work(problem, positions, displacement, exact, part.obstacle, along=True)
            for part in problem.contact_sets
            if part.obstacle.frictional
        ),
    ]


def _contact_work(
    problem: ContactProblem,
    positions: Field,
    displacement: Field,
    exact: ExactSolution,
    obstacle: Obstacle,
    along: bool = False,
) -> ElementGroup:
    """Work of the exact stress on one contact boundary: normal on the gap, or ``along`` it on the slip."""
    traction = _traction(problem.laws[0], exact)
    kind, components = exact.symbol, problem.components
    X_column, u_column = kind.sym("X", 4), kind.sym("u", 2 * components)
    X, u = ca.reshape(X_column, 2, 2), ca.reshape(u_column, components, 2)
    tangent = X[:, 1] - X[:, 0]
    outward = ca.vertcat(tangent[1], -tangent[0])  # times the length; the body is on the left
    total = kind(0)
    points, weights = get_quadrature_line(ERROR_DEGREE)
    for point, weight in zip(np.vstack([1 - points, points]).T, weights, strict=True):
        x, y = ca.vertsplit(X @ point)
        if along:
            direction = obstacle.tangential(x, y)
            way = ca.dot(direction, u @ point)
        else:
            direction = obstacle.direction(x, y)
            way = ca.dot(direction, u @ point) + obstacle.distance(x, y)
        total += weight * ca.dot(direction, traction(x, y, outward)) * way
    function = ca.Function("contact_error", [X_column, u_column], [total, kind(0, 1)])
    edges = _with_body_on_the_left(problem, contact_edges(problem, obstacle))
    return objective_group(function, (positions.at(edges), displacement.at(edges)))


def _distortion(
    name: str, problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    return [distortion_group(problem, positions, name)]


def certificate(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """Not a sum of element functions: the lower bound is a maximum over all of the mesh."""
    raise ValueError("the objective 'certificate' is minimised by nested only")


TERMS: dict[str, Term] = {
    "energy": Term("energy", energy),
    "error-energy": Term("error-energy", error_energy, needs_exact=True),
    "error-l2": Term("error-l2", error_l2, needs_exact=True),
    "error-h1": Term("error-h1", error_h1, needs_exact=True),
    "contact": Term("contact", contact, needs_exact=True),
    "friction": Term("friction", friction, needs_exact=True),
    "certificate": Term("certificate", certificate),
    **{name: Term(name, partial(_distortion, name), of_positions=True, barrier=True) for name in DISTORTIONS},
}
"""The named terms."""

ENERGY = Objective(((1.0, TERMS["energy"]),))


def _exact(problem: ContactProblem, name: str) -> ExactSolution:
    if problem.exact is None:
        raise ValueError(
            f"the objective {name!r} needs an exact or reference solution, and {problem.name!r} has none"
        )
    return problem.exact


def _gradient(exact: ExactSolution) -> ca.Function:
    """``(x, y) -> (value, gradient)``, the gradient (components, 2)."""
    x, y = exact.symbol.sym("x"), exact.symbol.sym("y")
    u = ca.vertcat(exact.value(x, y))
    return ca.Function("exact", [x, y], [u, ca.horzcat(ca.jacobian(u, x), ca.jacobian(u, y))])


def _triangles(
    problem: ContactProblem,
    positions: Field,
    displacement: Field,
    density: Callable[[Any, Any], Any],
    exact: ExactSolution,
    elements: Index | None = None,
) -> ElementGroup:
    """Integral of a density of the error and of its gradient over the triangles, or some of them."""
    kind, components = exact.symbol, problem.components
    X_column, u_column = kind.sym("X", 6), kind.sym("u", 3 * components)
    X, u = ca.reshape(X_column, 2, 3), ca.reshape(u_column, components, 3)
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    gradient = ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate / det
    solution = _gradient(exact)
    barycentric, weights = triangle_rule(ERROR_DEGREE if kind is ca.SX else SPLINE_DEGREE)
    total = kind(0)
    for point, weight in zip(barycentric.T, weights, strict=True):
        value, slope = solution(*ca.vertsplit(X @ point))
        total += weight * density(u @ point - value, gradient - slope)
    function = ca.Function("error", [X_column, u_column], [total * det / 2, kind(0, 1)])
    triangles = problem.triangles if elements is None else problem.triangles[:, elements]
    return objective_group(function, (positions.at(triangles), displacement.at(triangles)))


def _traction(law: Law, exact: ExactSolution) -> Callable[[Any, Any, Any], Any]:
    """The exact traction on a surface with outward normal n (of any length, which scales it)."""
    solution = _gradient(exact)

    def traction(x: Any, y: Any, n: Any) -> Any:
        slope = solution(x, y)[1]
        # the traction is the derivative of the energy density with respect to the gradient
        variable = ca.SX.sym("gradient", law.components, 2)
        stress = ca.Function("stress", [variable], [ca.gradient(energy_density(law, variable), variable)])
        return stress(slope) @ n

    return traction


def _with_body_on_the_left(problem: ContactProblem, edges: Index) -> Index:
    """The edges oriented so that their triangle is on the left."""
    t, n_nodes = problem.triangles, problem.mesh.p.shape[1]
    directed = np.hstack([t[[0, 1]], t[[1, 2]], t[[2, 0]]])
    forward = np.isin(edges[0] * n_nodes + edges[1], directed[0] * n_nodes + directed[1])
    return np.where(forward, edges, edges[::-1])
