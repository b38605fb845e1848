"""The reduced model: Taylor rates of its gradients, (5.7) and (5.11), and what is counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedObjective
from rmesh_nlp.problem import ContactProblem, ExactSolution, Motion
from rmesh_nlp.solving.outer import Outer
from support.contact_geometry import block_sliding_on_a_circle
from support.curved import CURVES, plate, spline_of_the_hole
from support.formulations import fixed, joint, mpcc, nested
from support.problems import sloped_block
from support.taylor import taylor_order

BENT_LOAD = (lambda x, y: x * y, lambda x, y: ca.sin(x))


def with_exact(problem: ContactProblem) -> ContactProblem:
    """The problem with some smooth function in the place of its exact solution.

    Its traction does not vanish at x = 0, the only place where nodes of 6.3 do not touch.
    """

    def value(x: Any, y: Any) -> Any:
        return ca.vertcat(-1e-3 * (x + 1) * y, -1e-2 * (x * x + y))

    return replace(problem, exact=ExactSolution(value, 0.0))


PROBLEMS = {
    "6.1": lambda: EXAMPLES["6.1"](),
    "6.2": lambda: with_exact(EXAMPLES["6.2"]()),
    "6.3": lambda: with_exact(EXAMPLES["6.3"]()),
    "sloped, stick and slip": lambda: with_exact(sloped_block()),
    "curved foundation, stick and slip": lambda: with_exact(block_sliding_on_a_circle()),
}
OBJECTIVES = ("error-l2", "error-energy", "contact", "energy", "energy + 0.1*quality")
QUICK = {
    ("6.1", "error-energy"),
    ("6.1", "contact"),
    ("6.3", "energy"),
    ("sloped, stick and slip", "error-l2"),
    ("curved foundation, stick and slip", "energy"),
}
"""Each objective and each kind of contact once; the other combinations are slow."""


def order_at_random(function: Any, n: int, seed: int, size: float) -> float:
    rng = np.random.default_rng(seed)
    q, d = size * rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    assert not np.any(function(q).weak)
    return taylor_order(function, q, d)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_energy_gradient_has_rate_2(name: str, seed: int) -> None:
    outer = Outer(PROBLEMS[name]())
    assert order_at_random(outer.energy, outer.n, seed, 0.6) >= 1.9


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        pytest.param(name, objective, marks=() if (name, objective) in QUICK else pytest.mark.slow)
        for name in PROBLEMS
        for objective in OBJECTIVES
    ],
)
def test_the_adjoint_gradient_has_rate_2(name: str, objective: str) -> None:
    outer = Outer(PROBLEMS[name]())
    function = ReducedObjective(outer.energy, parse_objective(objective))
    assert order_at_random(function, outer.n, 1, 0.5) >= 1.9


@pytest.mark.parametrize(
    "curve",
    [*CURVES.values(), pytest.param(spline_of_the_hole(), marks=pytest.mark.slow)],
    ids=lambda c: type(c).__name__,
)
def test_the_gradient_has_rate_2_where_nodes_slide_along_a_curve(curve: Curve) -> None:
    problem = plate({"hole": curve}, delta=0.4, load=BENT_LOAD)
    assert np.min(rm.verify_gradient(problem).orders) > 1.99


@pytest.mark.parametrize(
    ("kind", "objective"),
    [
        ("scalar", "2*certificate + 0.01*quality"),
        ("membrane", "certificate"),
        pytest.param("membrane", "2*certificate + 0.01*quality", marks=pytest.mark.slow),
    ],
)
def test_the_gradient_of_the_bound_of_the_error_has_rate_2(kind: str, objective: str) -> None:
    problem = replace(random_problem(2, kind=kind), motion=Motion(delta=0.05))
    assert rm.verify_gradient(problem, objective, seed=1).order > 1.9


def test_the_gradient_of_the_bound_has_rate_2_where_nodes_slide_along_a_circle() -> None:
    mesh = plate({}).mesh
    problem = rm.ContactProblem(
        mesh,
        rm.Laplace(source=-1.0),
        ("left",),
        motion=Motion(delta=rm.Relative(0.3), curves={"hole": CURVES["circle"]}),
    )
    assert rm.verify_gradient(problem, "certificate").order > 1.9


def test_weights_that_do_not_move_would_be_noticed() -> None:
    """The derivative of omega_i is a visible part of the gradient of 6.3."""
    problem = EXAMPLES["6.3"]()
    outer, given = Outer(problem), np.zeros(Outer(problem).n)
    moving = outer.energy(given).gradient
    state = outer.energy(given).equilibrium
    smooth = Outer(replace(problem, obstacle=replace(problem.obstacle, friction=1e-12)))
    still = smooth.energy.gradient(
        outer.energy.point(given, state), state.normal_force, state.tangential_force
    )
    assert np.max(np.abs(moving - still)) > 0.1 * np.max(np.abs(moving))


@pytest.mark.parametrize("make", [sloped_block, block_sliding_on_a_circle])
def test_the_energy_gradient_is_the_adjoint_gradient_of_the_energy(make: Any) -> None:
    outer = Outer(make())
    q = 0.1 * np.random.default_rng(2).uniform(-1, 1, outer.n)
    envelope, adjoint = outer.energy(q), ReducedObjective(outer.energy, parse_objective("energy"))(q)
    assert adjoint.value == pytest.approx(envelope.value, rel=1e-12)
    size = np.max(np.abs(envelope.gradient))
    np.testing.assert_allclose(adjoint.gradient, envelope.gradient, atol=1e-10 * size)


@pytest.fixture(scope="module")
def small() -> ContactProblem:
    return EXAMPLES["6.3"]((4, 2))


def test_the_solution_on_the_given_mesh_is_counted_when_it_is_first_asked_for(small: ContactProblem) -> None:
    outer = Outer(small)
    reduced, q, given = outer.energy, np.zeros(outer.n), outer.given
    assert (reduced.contact_solves, reduced.cold_solves, reduced.factorisations) == (0, 0, 0)
    for _ in range(2):
        assert reduced(q).equilibrium.energy == given.energy
        assert (reduced.contact_solves, reduced.cold_solves) == (1, 1)
        assert reduced.factorisations == given.iterations
        reduced._last = None
    reduced(q + 0.1)
    assert (reduced.contact_solves, reduced.cold_solves) == (2, 1)


def test_solves_are_counted_and_the_last_point_is_remembered(small: ContactProblem) -> None:
    outer = Outer(small)
    reduced = ReducedEnergy(outer.relocation, outer.contact)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, outer.n)
    first = reduced(q)
    assert reduced(q.copy()) is first
    assert (reduced.contact_solves, reduced.cold_solves) == (1, 1)
    second = reduced(0.5 * q)
    assert (reduced.contact_solves, reduced.cold_solves) == (2, 1)
    assert reduced.factorisations == first.equilibrium.iterations + second.equilibrium.iterations
    cold = ContactSolver(discretise(small)).solve(outer.nodes(0.5 * q))
    assert second.value == pytest.approx(cold.energy, rel=1e-10)
    np.testing.assert_array_equal(second.weak, np.zeros(small.contact_nodes.size, dtype=bool))


def test_terms_in_the_positions_are_added_and_undefined_where_an_element_is_inverted() -> None:
    plain, mixed, quality = (
        Outer(EXAMPLES["6.1"](3), text) for text in ("energy", "energy + 0.5*quality", "energy + 1*quality")
    )
    q = np.random.default_rng(0).uniform(-0.5, 0.5, plain.n)
    term = mixed.energy.of_positions(q)
    assert term == pytest.approx(0.5 * quality.energy.of_positions(q))
    assert mixed.energy(q).value == pytest.approx(plain.energy(q).value + term)
    assert plain.energy.of_positions(q) == 0
    function = plain.minimising(parse_objective("quality")).function
    inverted = 20 * (-1.0) ** np.arange(q.size)
    for defined in (mixed.energy.is_defined, function.is_defined):
        assert defined(q)
        assert not defined(inverted)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scalar", "membrane"])
def test_nested_lowers_the_bound_from_the_given_mesh_and_from_that_of_least_energy(kind: str) -> None:
    problem = replace(random_problem(2, kind=kind), motion=Motion(delta=0.05))
    by_energy = nested.solve(problem)
    for start in (None, by_energy):
        found = nested.solve(problem, objective="certificate", start=start)
        assert found.success
        record = found.record()
        assert record["objective_value"] < record["objective_initial"]
        certificate = rm.certify(found)
        assert certificate.guaranteed_lower
        assert certificate.error_bound < certificate.error_bound_initial
        # what is minimised is a bound as well, and close to that of the certificate
        half_square = certificate.error_bound**2 / 2
        assert record["objective_value"] == pytest.approx(half_square, rel=0.05)
    # with its own lower bound, not the better one of the given mesh
    assert half_square <= 1.001 * rm.certify(by_energy).error_bound ** 2 / 2


@pytest.mark.slow
def test_formulations_without_a_reduced_model_refuse_the_bound_and_fixed_tells_it() -> None:
    problem = replace(random_problem(2, kind="scalar"), motion=Motion(delta=0.05))
    for formulation in (joint, mpcc):
        with pytest.raises(ValueError, match="certificate"):
            formulation.solve(problem, objective="certificate")
    with pytest.raises(ValueError, match="scalar"):
        nested.solve(EXAMPLES["6.3"]((4, 2)), objective="certificate")
    assert fixed.solve(problem, objective="certificate").record()["objective_value"] > 0
