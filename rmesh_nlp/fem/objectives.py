"""Outer objectives other than the energy, as element groups of positions and displacement.

Errors are measured against the problem's exact solution u:

``error-energy``  I1 of (4.1), 1/2 a(u_h - u, u_h - u)
``error-l2``      squared L2 norm of u_h - u
``error-h1``      squared H1 seminorm of u_h - u
``contact``       I2 of (4.2), the work of the exact contact stress on the discrete gap
``friction``      I3 of (4.2), what friction takes on the discrete slip less the work of the exact stress
``compliance``    work of the loads, ``f . u``
``area``          of the body, in the positions alone; beside curves that of the polygon
``quality``, ``shape-size``, ``elastic``
                  distortion against the initial mesh, see :mod:`rmesh_nlp.fem.distortion`
"""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Expression
from rmesh_nlp.fem.cells import Straight
from rmesh_nlp.fem.contact_terms import friction
from rmesh_nlp.fem.distortion import DISTORTIONS, distortion
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.energy import loads, strain
from rmesh_nlp.fem.fields import ElementGroup, Fields
from rmesh_nlp.fem.functional import scaled_group
from rmesh_nlp.fem.objective import Groups, Term
from rmesh_nlp.fem.space import outward_edges
from rmesh_nlp.problem import ExactSolution, Obstacle
from rmesh_nlp.problem.laws import entries

ERROR_DEGREE = 10
"""Degree of the rules for error integrals: high, since an optimiser exploits a low one."""

SPLINE_DEGREE = 5
"""The same for a reference given by splines, which are dear and smooth on the scale of an element."""


def energy(on: Fields) -> list[ElementGroup]:
    """The total potential energy (3.3), (3.15)."""
    return [*strain(on), *loads(on, on.problem.rule), *friction(on)]


def _energy(on: Fields) -> list[ElementGroup]:
    if not on.problem.has_energy:
        raise BadInputError("with Coulomb friction there is no energy that the displacement minimises")
    return energy(on)


def _compliance(on: Fields) -> list[ElementGroup]:
    """The work of source or body force, tractions and point loads, (3.3)."""
    groups = loads(on, on.problem.rule)
    if not groups:
        raise BadInputError(f"the objective 'compliance' needs a load, and {on.problem.name!r} has none")
    return [scaled_group(group, -1.0) for group in groups]


def _area(on: Fields) -> list[ElementGroup]:
    cell = Straight(3, 1, 1, on.problem.measure)
    size = cell.integral(lambda x, y, u, slope: 1, cell.rule(0))
    function = ca.Function("area", cell.columns[:1], [size, NO_ROWS])
    return [on.group(function, [on.positions.at(on.problem.triangles)])]


def _error(which: str, on: Fields) -> list[ElementGroup]:
    """Integral over the body of a density of the law, the error and its gradient."""
    exact = _exact(on, which)
    degree = ERROR_DEGREE if exact.symbol is ca.SX else SPLINE_DEGREE
    solution, groups = _with_gradient(exact), []
    for law, elements in on.problem.regions:

        def density(x: Any, y: Any, u: Any, slope: Any, law: Any = law) -> Any:
            value, gradient = solution(x, y)
            if which == "error-energy":
                return law.energy_density(law.extended(slope - gradient, u - value, ca.vertcat(x, y)))
            return ca.sumsqr(u - value if which == "error-l2" else slope - gradient)

        cells = on.problem.triangles[:, elements]
        groups.append(on.integral("error", cells, degree, density, kind=exact.symbol))
    return groups


def _contact(on: Fields) -> list[ElementGroup]:
    """I2 of (4.2): integral of (T(u) . normal) times the discrete gap over the contact boundary.

    T(u) is the exact traction (the outward normal derivative of a scalar problem).
    """
    exact = _theorem(on, "contact")
    if len(on.problem.laws) > 1 or any(not isinstance(o.boundary, str) for o in on.problem.obstacles):
        raise BadInputError("the objective 'contact' needs one law and contact on a boundary")
    return [_work(on, exact, obstacle) for obstacle in on.problem.obstacles]


def _friction(on: Fields) -> list[ElementGroup]:
    """I3 of (4.2): integral of ``g |u_t| + T_t(u) u_t`` over the contact boundary.

    u_t is the discrete slip and T_t(u) the exact tangential stress on the body, of size g at most, so the
    integrand is not negative; it vanishes where the discrete solution sticks and slides as the exact one.
    The first part is that of the energy, for a constant bound and order 1 the trapezoidal rule of (5.9), the
    second is taken accurately.
    """
    exact = _theorem(on, "friction")
    if not on.problem.frictional:
        raise BadInputError("the objective 'friction' needs a contact boundary with friction")
    if len(on.problem.laws) > 1:
        raise BadInputError("the objective 'friction' needs one law")
    rough = [obstacle for obstacle in on.problem.obstacles if obstacle.friction_law]
    return [*friction(on), *(_work(on, exact, obstacle, along=True) for obstacle in rough)]


def _work(on: Fields, exact: ExactSolution, obstacle: Obstacle, *, along: bool = False) -> ElementGroup:
    """Work of the exact stress on one contact boundary: normal on the gap, or ``along`` it on the slip."""
    law, solution = on.problem.laws[0], _with_gradient(exact)

    def density(x: Expression, y: Expression, u: Expression, n: Expression) -> Expression:
        direction = obstacle.tangential(x, y) if along else obstacle.direction(x, y)
        way = ca.dot(direction, u) + (0 if along else obstacle.distance(x, y))
        value, gradient = solution(x, y)
        stress = ca.blockcat(law.stress(entries(law.extended(gradient, value, ca.vertcat(x, y)))))
        return ca.dot(direction, stress[:, :2] @ n) * way

    edges = outward_edges(on.problem, str(obstacle.boundary))
    return on.integral("contact_error", edges, ERROR_DEGREE, density, kind=exact.symbol)


def _exact(on: Fields, name: str) -> ExactSolution:
    if on.problem.exact is None:
        raise BadInputError(
            f"the objective {name!r} needs an exact or reference solution, and {on.problem.name!r} has none"
        )
    return on.problem.exact


def _theorem(on: Fields, name: str) -> ExactSolution:
    if not on.problem.has_energy:
        raise BadInputError(
            f"the objective {name!r} is a term of Theorem 4.1 on a least energy, and with Coulomb friction "
            "there is none"
        )
    return _exact(on, name)


def _with_gradient(exact: ExactSolution) -> ca.Function:
    """``(x, y) -> (value, gradient)``, the gradient (components, 2)."""
    x, y = exact.symbol.sym("x"), exact.symbol.sym("y")
    u = ca.vertcat(exact.value(x, y))
    return ca.Function("exact", [x, y], [u, ca.horzcat(ca.jacobian(u, x), ca.jacobian(u, y))])


def _terms() -> dict[str, Term]:
    errors: dict[str, Groups] = {
        name: partial(_error, name) for name in ("error-energy", "error-l2", "error-h1")
    }
    errors |= {"contact": _contact, "friction": _friction}
    terms = [
        Term("energy", _energy, minimised_only=True),
        *(Term(name, groups, needs_exact=True, minimised_only=True) for name, groups in errors.items()),
        Term("compliance", _compliance),
        Term("area", _area, of_positions=True),
        *(
            # size: means of densities of which 1 is subtracted
            Term(
                name, partial(distortion, name), of_positions=True, barrier=True, minimised_only=True, size=1
            )
            for name in DISTORTIONS
        ),
    ]
    return {term.name: term for term in terms}


TERMS: dict[str, Term] = _terms()
"""The named terms."""

ENERGY = TERMS["energy"].alone
