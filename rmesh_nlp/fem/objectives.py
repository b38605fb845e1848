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
from typing import Any

import casadi as ca

from rmesh_nlp.fem.contact_terms import friction_terms
from rmesh_nlp.fem.distortion import DISTORTIONS, distortion_group
from rmesh_nlp.fem.element import affine, corners, line_rule
from rmesh_nlp.fem.energy import load_terms, strain_terms, triangle_rule
from rmesh_nlp.fem.fields import ElementGroup, Field
from rmesh_nlp.fem.objective import Groups, Objective, Term, cell_group
from rmesh_nlp.fem.space import DisplacementSpace, outward_edges
from rmesh_nlp.problem import ContactProblem, ExactSolution, Law, Obstacle
from rmesh_nlp.problem.laws import energy_density

ERROR_DEGREE = 10
"""Degree of the rules for error integrals: high, since an optimiser exploits a low one."""

SPLINE_DEGREE = 5
"""The same for a reference given by splines, which are dear and smooth on the scale of an element."""


def _energy(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """The total potential energy (3.3), (3.15)."""
    space = displacement.space or DisplacementSpace.of(problem)
    bulk = [*strain_terms(space), *load_terms(space, problem.rule)]
    return [
        *(term.on(positions, displacement) for term in bulk),
        *(term.on(positions, slip) for term in friction_terms(space)),
    ]


def _error(name: str, density: Callable[[Law, Any, Any], Any]) -> Groups:
    """Integral over the body of a density of the law, the error and its gradient."""

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, _: Field
    ) -> list[ElementGroup]:
        exact = _exact(problem, name)
        barycentric, weights = triangle_rule(ERROR_DEGREE if exact.symbol is ca.SX else SPLINE_DEGREE)
        solution, found = _gradient(exact), []
        for law, elements in problem.regions:
            X, u = corners(3, problem.components, exact.symbol)
            det, scaled = affine(X, u)
            total = exact.symbol(0)
            for point, weight in zip(barycentric.T, weights, strict=True):
                value, slope = solution(*ca.vertsplit(X @ point))
                total += weight * density(law, u @ point - value, scaled / det - slope)
            cells = problem.triangles[:, elements]
            found.append(cell_group("error", X, u, total * det / 2, cells, positions, displacement))
        return found

    return groups


def _contact(
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


def _friction(
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
    space = displacement.space or DisplacementSpace.of(problem)
    return [
        *(term.on(positions, slip) for term in friction_terms(space)),
        *(
            _contact_work(problem, positions, displacement, exact, obstacle, along=True)
            for obstacle in problem.obstacles
            if obstacle.frictional
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
    X, u = corners(2, problem.components, exact.symbol)
    tangent = X[:, 1] - X[:, 0]
    outward = ca.vertcat(tangent[1], -tangent[0])  # times the length; the body is on the left
    total = exact.symbol(0)
    points, weights = line_rule(ERROR_DEGREE)
    for point, weight in zip(points.T, weights, strict=True):
        x, y = ca.vertsplit(X @ point)
        direction = obstacle.tangential(x, y) if along else obstacle.direction(x, y)
        way = ca.dot(direction, u @ point) + (0 if along else obstacle.distance(x, y))
        total += weight * ca.dot(direction, traction(x, y, outward)) * way
    edges = outward_edges(problem, str(obstacle.boundary))
    return cell_group("contact_error", X, u, total, edges, positions, displacement)


def _distortion(name: str) -> Groups:
    return lambda problem, positions, displacement, slip: [distortion_group(problem, positions, name)]


def _certificate(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field
) -> list[ElementGroup]:
    """Not a sum of element functions: the lower bound is a maximum over all of the mesh."""
    raise ValueError("the objective 'certificate' is minimised by nested only")


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


def _traction(law: Law, exact: ExactSolution) -> Callable[[Any, Any, Any], Any]:
    """The exact traction on a surface with outward normal n (of any length, which scales it)."""
    solution = _gradient(exact)
    variable = ca.SX.sym("gradient", law.components, 2)
    # the stress is the derivative of the energy density by the gradient
    stress = ca.Function("stress", [variable], [ca.gradient(energy_density(law, variable), variable)])
    return lambda x, y, n: stress(solution(x, y)[1]) @ n


def _terms() -> dict[str, Term]:
    errors = {
        "error-energy": _error("error-energy", lambda law, e, de: energy_density(law, de)),
        "error-l2": _error("error-l2", lambda law, e, de: ca.sumsqr(e)),
        "error-h1": _error("error-h1", lambda law, e, de: ca.sumsqr(de)),
        "contact": _contact,
        "friction": _friction,
    }
    return {
        "energy": Term("energy", _energy, minimised_only=True),
        **{name: Term(name, f, needs_exact=True, minimised_only=True) for name, f in errors.items()},
        "certificate": Term("certificate", _certificate, minimised_only=True),
        **{
            name: Term(name, _distortion(name), of_positions=True, barrier=True, minimised_only=True)
            for name in DISTORTIONS
        },
    }


TERMS: dict[str, Term] = _terms()
"""The named terms."""

ENERGY = Objective(((1.0, TERMS["energy"]),))
