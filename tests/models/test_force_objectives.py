"""Objectives of contact forces: derivatives by two adjoints that share nothing, and by differences."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Evaluator
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, element_group
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.objective import Fields, Objective, Term
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.kkt_model import bilevel, kkt_unknowns
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.second_derivatives import ObjectiveCurvature
from rmesh_nlp.problem import ContactProblem, signed_areas
from support.orders import ORDERS
from support.problems import coulomb_slab
from support.reduced import CONTACTS, OTHERS, reduced
from support.taylor import difference_order, taylor_order


def punch() -> ContactProblem:
    """Half a block on a plane, whose lower edge may move up and down."""
    return rm.ContactProblem(
        rm.shapes.rectangle(5, 4),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("top", (None, -0.02))),
        replace(rm.Obstacle.graph("bottom", lambda x, y: -0.002 * x), coulomb=0.2),
        rm.Motion(0.05, free=("bottom",)),
        tractions=rm.Traction("right", (-1.0, lambda x, y: 2 * y)),
    )


COULOMB = {
    "Coulomb": lambda: coulomb_slab(0.4, (6, 4)),
    "Coulomb, varying": lambda: coulomb_slab(lambda x, y: 0.8 + 0.1 * x + 0.05 * y, (6, 4)),
    "punch of a free shape, Coulomb": punch,
}
PROBLEMS = (
    CONTACTS | COULOMB | {name: OTHERS[name] for name in ("two foundations", "two obstacles at a node")}
)


def of_forces(on: Fields) -> list[ElementGroup]:
    """A function of position, slip, normal force and both multipliers of friction at each contact node."""
    assert on.forces is not None
    x, s, normal, minus, plus = (ca.SX.sym(name, n) for name, n in zip("Xslmp", (2, 1, 1, 1, 1), strict=True))
    value = (1 + x[0] * x[1]) * normal * (1 + normal / 10 + plus / 7) + minus**2 * (1 + s) + plus * (3 + x[0])
    function = ca.Function("of_forces", [x, s, normal, minus, plus], [value, NO_ROWS])
    groups, (given, _) = [], on.space.given()
    for part in on.space.contact_sets:
        free = part.nodes[~np.any(given[:, part.nodes], axis=0)]  # elsewhere tangential forces are supports'
        which, vertices, _ = next(on.space.kinds(free))
        fields = (on.slip, *on.forces)
        local = (field.component(part.number).at(free[None, which]) for field in fields)
        groups.append(element_group(function, on.positions, (on.positions.at(vertices), *local)))
    return groups


def of_sums(on: Fields) -> Functional:
    """A function of three sums, one of which stands for itself."""
    first, second = Functional(of_forces(on)), Functional(of_forces(on)[:1])
    ratio = first.then(lambda a: a**2) + second.then(lambda b: ca.sqrt(1 + b**2))
    return Functional(of_forces(on)) + ratio.then(lambda c: 1e-3 * c * ca.log(1 + c**2)).scaled(0.1)


FORMS = {"sum": of_forces, "function of sums": of_sums}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("name", "form"), [("6.3", "sum"), *((name, "function of sums") for name in PROBLEMS)]
)
def test_derivatives_of_a_function_of_forces(name: str, order: int, form: str) -> None:
    check_derivatives(replace(PROBLEMS[name](), order=order), Objective(((2.0, Term(form, FORMS[form])),)))


def check_derivatives(problem: ContactProblem, wanted: Objective) -> None:
    """Taylor's rate of the gradient, that of differences of it, and the same gradient by the KKT model."""
    energy = reduced(problem)
    function, rng = ReducedObjective(energy, wanted), np.random.default_rng(6)
    q, *directions = rng.uniform(-1, 1, (4, energy.relocation.n_q)) * [[0.2], [1], [1], [1]]
    here = function(q)
    assert not np.any(here.weak)
    hessian = ObjectiveCurvature(energy, wanted).at(here)
    size = np.max(np.abs(here.gradient))
    np.testing.assert_allclose(hessian.gradient, here.gradient, atol=1e-9 * size)
    d = max(directions, key=lambda one: abs(one @ hessian(one)))  # terms of third order are small beside that
    assert abs(taylor_order(function, q, d, 5e-4) - 2) < 0.02
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d, 1e-3) > 1.9


TERMS = (
    "level-pressure({0})",
    "resultant({0})",
    "contact-length({0}, 5)",
    "peak-pressure({0}, 20, 3)",
    "compliance",
    "square(resultant({0}) - 70)",
    "shear({0}) + 0.1*resultant({0})",
    "square(2*contact-length({0}, 3) + level-pressure({0}) - 1.5)",
)
QUICK = ("6.3", "Coulomb, varying")
NAMED = [name for name in PROBLEMS if name != "two obstacles at a node"]  # whose resultants do not change


@pytest.mark.parametrize("text", TERMS)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in NAMED]
)
def test_derivatives_of_named_quantities(name: str, order: int, text: str) -> None:
    problem = replace(PROBLEMS[name](), order=order)
    if "shear" in text and not problem.frictional:
        text = text.replace("shear({0}) + ", "")
    text = text.format(problem.obstacles[0].boundary)
    if not problem.obstacles[0].frictional and "shear" in text:
        pytest.skip("the other obstacle is rough")
    check_derivatives(problem, parse_objective(text))


@pytest.mark.parametrize("order", ORDERS)
def test_derivatives_of_the_area(order: int) -> None:
    """Levels collapse with it where it is added to the energy, as with all terms in the positions alone."""
    problem = replace(punch(), obstacle=rm.Obstacle.graph("bottom", 0.0), order=order)
    check_derivatives(problem, parse_objective("square(area - 0.9) + level-pressure(bottom)"))
    energy = reduced(problem, "energy + 30*area")
    q, d = np.random.default_rng(6).uniform(-1, 1, (2, energy.relocation.n_q)) * [[0.2], [1]]
    assert abs(taylor_order(energy, q, d) - 2) < 0.02
    assert energy.of_positions(q) == pytest.approx(
        30 * signed_areas(energy.relocation.nodes(q), problem.triangles).sum()
    )


@pytest.mark.parametrize("text", TERMS)
@pytest.mark.parametrize("name", ["6.3", pytest.param("Coulomb, varying", marks=pytest.mark.slow)])
def test_the_kkt_model_has_the_value_and_the_sums(name: str, text: str) -> None:
    energy, wanted = reduced(PROBLEMS[name]()), parse_objective(text.format("contact"))
    rel, given = energy.relocation, energy(np.zeros(energy.relocation.n_q))
    start = kkt_unknowns(given.q, given.equilibrium, given.system, rel.friction_rows)
    program = bilevel(rel.discretisation, wanted, length=1e-3, force=7.0, value=3.0, start=start)
    point = ReducedObjective(energy, wanted)(0.2 * np.random.default_rng(6).uniform(-1, 1, rel.n_q))
    x = program.point(point.q, point.equilibrium, point.system)
    derivatives = program.mpcc.derivatives
    assert derivatives is not None
    assert 3 * Evaluator(derivatives.grad_f)(x, [])[0][0] == pytest.approx(point.value, rel=1e-9)
    rows = Evaluator(derivatives.jac_g)(x, [])[0][: program.n_equations]
    np.testing.assert_allclose(rows, 0, atol=1e-9)
    if program.sums.size:
        assert 0.01 < np.max(np.abs(x[-program.sums.size :])) < 100
