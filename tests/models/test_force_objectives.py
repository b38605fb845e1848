"""Objectives of contact forces: values by hand and from the forces of a solution, derivatives, refusals."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.contact_results import contact_results
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.evaluation import Evaluator
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, Fields
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.models.kkt_model import bilevel, kkt_unknowns
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.problem import ContactProblem, signed_areas
from support.objectives import even_sum, value_on, values_at
from support.orders import ORDERS, slow_but
from support.problems import COULOMB, LENGTH, PRESSURE, SHEAR, coulomb_slab, sliding_block
from support.reduced import CONTACTS, OTHERS, reduced
from support.solved import example
from support.taylor import difference_order, taylor_order


def punch() -> ContactProblem:
    """Half a block on a plane, whose lower edge may move up and down."""
    return rm.ContactProblem(
        rm.shapes.rectangle(4, 3),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("top", (None, -0.02))),
        replace(rm.Obstacle.graph("bottom", lambda x, y: -0.002 * x), coulomb=0.2),
        rm.Motion(0.05, free=("bottom",)),
        tractions=rm.Traction("right", (-1.0, lambda x, y: 2 * y)),
    )


ROUGH = {
    "Coulomb": lambda: coulomb_slab(0.4, (6, 2)),
    "Coulomb, varying": lambda: coulomb_slab(lambda x, y: 0.8 + 0.1 * x + 0.05 * y, (6, 3)),
    "punch of a free shape, Coulomb": punch,
}
PROBLEMS = {name: CONTACTS[name] for name in ("6.3", "curved foundation, stick and slip")} | ROUGH
PROBLEMS["two obstacles at a node"] = OTHERS["two obstacles at a node"]


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
        groups.append(on.group(function, [on.positions.at(vertices), *local]))
    return groups


def of_sums(on: Fields) -> Functional:
    """A function of three sums, one of which stands for itself."""
    first, second = Functional(of_forces(on)), Functional(of_forces(on)[:1])
    ratio = first.then(lambda a: a**2) + second.then(lambda b: ca.sqrt(1 + b**2))
    return Functional(of_forces(on)) + ratio.then(lambda c: 1e-3 * c * ca.log(1 + c**2)).scaled(0.1)


def check_derivatives(problem: ContactProblem, parts: list[Objective | str]) -> None:
    """Taylor's rate of the gradient, that of differences of it, of objectives in equal shares."""
    outer = rm.Outer.of(problem)
    function, rng = ReducedObjective(outer.energy, even_sum(outer, parts)), np.random.default_rng(6)
    q, *directions = rng.uniform(-1, 1, (4, outer.n)) * [[0.2], [1], [1], [1]]
    here = function(q)
    assert not np.any(here.weak)
    hessian = function.hessian(here)
    d = max(directions, key=lambda one: abs(one @ hessian(one)))  # terms of third order are small beside that
    assert abs(taylor_order(function, q, d, 1e-3) - 2) < 0.02
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d, 1e-3) > 1.9


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "name", slow_but(PROBLEMS, "curved foundation, stick and slip", "punch of a free shape, Coulomb")
)
def test_derivatives_of_a_function_of_forces(name: str, order: int) -> None:
    forces = Objective(((1.0, Term("function of sums", of_sums)),))
    check_derivatives(replace(PROBLEMS[name](), order=order), [forces])


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


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_derivatives_of_named_quantities(order: int) -> None:
    problem = replace(PROBLEMS["Coulomb, varying"](), order=order)
    check_derivatives(problem, [text.format("contact") for text in TERMS])


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_of_the_area(order: int) -> None:
    """Levels collapse with it where it is added to the energy, as with all terms in the positions alone."""
    problem = replace(punch(), obstacle=rm.Obstacle.graph("bottom", 0.0), order=order)
    check_derivatives(problem, ["square(area - 0.9)", "level-pressure(bottom)"])
    energy = reduced(problem, "energy + 30*area")
    q, d = np.random.default_rng(6).uniform(-1, 1, (2, energy.relocation.parts.n_q)) * [[0.2], [1]]
    assert abs(taylor_order(energy, q, d) - 2) < 0.02
    assert energy.of_positions(q) == pytest.approx(
        30 * signed_areas(energy.relocation.nodes(q), problem.triangles).sum()
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6.3", "Coulomb, varying"])
def test_the_kkt_model_has_the_value_and_the_sums(name: str) -> None:
    outer = rm.Outer.of(PROBLEMS[name]())
    wanted = even_sum(outer, [text.format("contact") for text in TERMS])
    start = kkt_unknowns(outer.energy(np.zeros(outer.n)), outer.discretisation.friction_rows)
    program = bilevel(outer.discretisation, wanted, length=1e-3, force=7.0, value=3.0, start=start)
    point = ReducedObjective(outer.energy, wanted)(0.2 * np.random.default_rng(6).uniform(-1, 1, outer.n))
    x = program.point(point)
    derivatives = program.mpcc.derivatives
    assert 3 * Evaluator(derivatives.grad_f)(x, [])[0][0] == pytest.approx(point.value, rel=1e-9)
    rows = Evaluator(derivatives.jac_g)(x, [])[0][: program.n_equations]
    np.testing.assert_allclose(rows, 0, atol=1e-9)
    assert 0.01 < np.max(np.abs(x[-program.sums.size :])) < 100


MU, P, F = SHEAR, PRESSURE, COULOMB

ON_THE_SLIDING_BLOCK = {
    "level-pressure(bottom)": 0.0,
    "resultant(bottom)": P * LENGTH,
    "shear(bottom)": -F * P * LENGTH,
    "contact-length(bottom, 1)": LENGTH * 9 / 10,
    "contact-length(bottom, 1e-9)": LENGTH,
    "peak-pressure(bottom, 1.5, 5)": 2.0**5,
    "compliance": 0.0,  # both sides move alike
    "area": LENGTH,
    "square(resultant(bottom) - 4)": (P * LENGTH - 4) ** 2,
    "square(2*area + shear(bottom) + 1e-1)": (2 * LENGTH - F * P * LENGTH + 0.1) ** 2,
    "square(square(area - 1) - 3.5)": (1 - 3.5) ** 2,
    "square(-area)": LENGTH**2,
    "2*square(area-1e+0) + 0.5*resultant(bottom)": 2 + P,
}


@pytest.mark.parametrize("order", [1, 2])
def test_a_sliding_block_by_hand(order: int) -> None:
    found = values_at(rm.Outer.of(sliding_block(order), "area"), list(ON_THE_SLIDING_BLOCK))
    assert dict(zip(ON_THE_SLIDING_BLOCK, found, strict=True)) == pytest.approx(
        ON_THE_SLIDING_BLOCK, rel=1e-9, abs=1e-10
    )


def test_compliance_of_a_bar_and_of_a_membrane_by_hand() -> None:
    """A bar, 2 long, under the traction 3 on its end, E = 2 mu; u = x (1 - x/2) under the source 1."""
    mesh = rm.shapes.rectangle(4, 2, x=(0, 2))
    supports = rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("bottom", (None, 0.0))
    bar = ContactProblem(
        mesh, rm.PlaneStrain(0.0, MU), supports, rm.Obstacle("top", (0.0, -1.0), 1.0),
        tractions=rm.Traction("right", (3.0, 0.0)),
    )  # fmt: skip
    assert value_on(bar, "compliance") == pytest.approx(3 * (3 / (2 * MU)) * 2)
    membrane = ContactProblem(
        rm.shapes.rectangle(4, 4), rm.Laplace(1.0), "left", rm.Obstacle("right", (1.0,), 9.0), order=2
    )
    assert value_on(membrane, "compliance") == pytest.approx(1 / 2 - 1 / 6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ["6.1", "sloped, stick and slip", *slow_but(["6.3", "gaps along edges"])])
def test_sums_over_the_nodes_of_a_contact_boundary(name: str, order: int) -> None:
    problem = replace((CONTACTS | OTHERS)[name](), order=order)
    outer, boundary = rm.Outer.of(problem), problem.obstacles[0].boundary
    q = 0.3 * np.random.default_rng(0).uniform(-1, 1, outer.n)
    point = outer.energy(q)
    state, space, nodes = point.equilibrium, outer.discretisation.space, outer.nodes(q)
    ends = problem.mesh.facets[:, problem.mesh.boundaries[boundary]]
    (part,), size = space.contact_sets, np.linalg.norm(nodes[:, ends[0]] - nodes[:, ends[1]], axis=0)
    shares, forces = np.zeros((2, space.n_nodes))
    forces[part.nodes] = state.normal_force[part.rows]
    for end in ends:  # half the force and the length of each edge
        np.add.at(shares, end, size / 2)
        if order == 2:
            np.add.at(forces, end, forces[space.nodes_of(ends)[2]] / 2)
    is_free = np.isin(np.arange(space.n_nodes), part.nodes) & (shares > 0)
    weights, force = shares[is_free], forces[is_free]
    total, pressure = np.sum(weights), force / weights
    assert np.ptp(pressure) > 0.1 * np.max(pressure) > 0
    given = problem.mesh.p[:, ends]
    length = np.sum(np.linalg.norm(given[:, 0] - given[:, 1], axis=0))
    (printed,) = contact_results(space, nodes, point.system, state).values()
    # and the share at supports, if any
    assert printed.normal_force >= np.sum(state.normal_force) * (1 - 1e-12)
    expected = {
        f"resultant({boundary})": printed.normal_force,
        f"level-pressure({boundary})": weights @ (pressure - np.sum(force) / total) ** 2,
        f"contact-length({boundary}, 3)": weights @ (pressure**2 / (pressure**2 + 9)),
        f"peak-pressure({boundary}, 2, 4)": weights @ (pressure / 2) ** 4 / length,
        f"peak-pressure({boundary}, 2)": weights @ (pressure / 2) ** 8 / length,
    }
    if problem.frictional:
        expected[f"shear({boundary})"] = printed.tangential_force
    assert values_at(outer, list(expected), q) == pytest.approx(list(expected.values()), rel=1e-9)


def test_quantities_that_a_problem_does_not_have() -> None:
    block = sliding_block()
    twice = (rm.Obstacle("bottom"), rm.Obstacle("bottom", (0.6, 0.8), 0.1))
    membrane = replace(example("6.1", 3), obstacle=rm.Obstacle.interior(-0.1))
    for problem, text, said in (
        (replace(block, tractions=()), "compliance", "'compliance' needs a load"),
        (block, "square(energy - 1)", "there is no energy"),
        (replace(block, obstacle=twice), "resultant(bottom)", "'bottom' may meet 2 obstacles"),
        (membrane, "resultant(contact)", "'contact' is not a contact boundary: choose from none"),
    ):
        with pytest.raises(ValueError, match=said):
            value_on(problem, text)


def test_supports_have_no_part_in_the_shear() -> None:
    """The node in the corner is held along the foundation: what is tangential there is no friction."""
    block = sliding_block()
    held = replace(block, dirichlet=(rm.Dirichlet("top", (None, -0.02)), rm.Dirichlet("left", (0.0, None))))
    sizes = [
        sum(group.size for group in rm.objective("shear(bottom)").on(discretise(problem).fields()).groups)
        for problem in (block, held)
    ]
    assert sizes == [6, 5]
