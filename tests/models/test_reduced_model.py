"""The reduced model: rates of its first and second derivatives, (5.7) and (5.11), and what is counted."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.contact import active_set
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models import second_derivatives
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedObjective
from rmesh_nlp.models.second_derivatives import Curvature, curvature_of
from rmesh_nlp.problem import ContactProblem, ExactSolution
from rmesh_nlp.solving.outer import Outer
from support.curved import CURVES, HOLE, plate
from support.orders import slow_but
from support.reduced import CONTACTS, OTHERS, QUADRATIC, reduced
from support.taylor import difference_order, taylor_order

BENT_LOAD = (lambda x, y: x * y, lambda x, y: ca.sin(x))


def with_exact(problem: ContactProblem) -> ContactProblem:
    """With some smooth solution, whose traction does not vanish at x = 0, where nodes of 6.3 do not touch."""
    if problem.exact is not None:
        return problem
    value = [lambda x, y: -1e-3 * (x + 1) * y, lambda x, y: -1e-2 * (x * x + y)][: problem.components]
    smooth = ExactSolution(lambda x, y: ca.vertcat(*(component(x, y) for component in value)), 0.0)
    return replace(problem, exact=smooth)


OBJECTIVES = [
    ("6.1", "error-energy"),
    ("6.1", "contact"),
    ("6.3", "contact"),
    ("6.3", "energy + 0.1*quality"),
    ("6.3, order 2", "error-energy"),
    ("sloped, stick and slip", "error-l2"),
    ("curved foundation, stick and slip", "energy"),
]
"""Each objective, and each kind of contact."""


def order_at_random(function: Any, n: int, seed: int, size: float) -> float:
    rng = np.random.default_rng(seed)
    q, d = size * rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    assert not np.any(function(q).weak)
    return taylor_order(function, q, d)


def test_solves_are_counted_warm_or_cold_and_that_of_the_given_mesh_when_it_is_first_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def counts(energy: ReducedEnergy) -> tuple[int, int, int]:
        return energy.contact_solves, energy.cold_solves, energy.factorisations

    outer = Outer.of(EXAMPLES["6.3"]((4, 2)))
    energy, zero, given = outer.energy, np.zeros(outer.n), outer.contact.given
    assert counts(energy) == (0, 0, 0)
    assert energy(zero).equilibrium is given
    assert counts(energy) == (1, 1, given.iterations)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, outer.n)
    with monkeypatch.context() as patch:
        patch.setattr(active_set, "first_set", lambda _: pytest.fail("it begins anew"))
        first = energy(q)
        assert energy(q.copy()) is first
        q *= 0.5  # the point that is remembered has positions of its own
        second = energy(q)
    cold = ContactSolver(outer.problem).solve(energy.relocation.nodes(q))
    iterations = [state.iterations for state in (given, first.equilibrium, second.equilibrium)]
    assert counts(energy) == (3, 1, sum(iterations))
    assert second.value == pytest.approx(cold.energy, rel=1e-10)
    assert not np.any(second.weak)
    assert energy(zero).equilibrium is given
    assert counts(energy)[:2] == (3, 1)
    later = outer.minimising(outer.objective).energy  # knows it, and is asked for another point before
    later(q + 0.1)
    later(zero)
    assert counts(later)[:2] == (2, 2)


def test_terms_in_the_positions_are_added_and_undefined_where_an_element_is_inverted() -> None:
    plain, mixed, quality = (
        reduced(EXAMPLES["6.1"](3), text) for text in ("energy", "energy + 0.5*quality", "energy + 1*quality")
    )
    q = np.random.default_rng(0).uniform(-0.5, 0.5, plain.relocation.parts.n_q)
    term = mixed.of_positions(q)
    assert term == pytest.approx(0.5 * quality.of_positions(q))
    assert mixed(q).value == pytest.approx(plain(q).value + term)
    assert plain.of_positions(q) == 0
    inverted = 20 * (-1.0) ** np.arange(q.size)
    assert [energy.is_defined(at) for energy in (plain, mixed) for at in (q, inverted)] == [True] * 3 + [
        False
    ]


GEOMETRIES = ("gaps along edges", "two foundations", "graph, no normal varies", "two obstacles at a node")
PROBLEMS = {
    **CONTACTS,
    "along a circle": lambda: plate({"hole": HOLE}, delta=0.4, load=BENT_LOAD),
    "along a parametrised curve": lambda: plate({"hole": CURVES["parametrised"]}, delta=0.4, load=BENT_LOAD),
    **{name: OTHERS[name] for name in GEOMETRIES},
    **QUADRATIC,
}


@pytest.mark.parametrize("name", slow_but(PROBLEMS))
def test_both_derivatives_of_the_energy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    energy, rng = reduced(PROBLEMS[name]()), np.random.default_rng(1)
    assert order_at_random(energy, energy.relocation.parts.n_q, 1, 0.6) >= 1.9
    q, d, other = rng.uniform(-1, 1, (3, energy.relocation.parts.n_q)) * [[0.3], [1], [1]]
    hessian = Curvature(energy).at(energy(q))
    product = hessian(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 2e-3) > 1.9
    assert other @ product == pytest.approx(d @ hessian(other), rel=1e-9)
    assert np.all(hessian.diagonal() > 0)
    # one by one, in columns, or all at once
    both = hessian(np.column_stack([d, other]))
    monkeypatch.setattr(second_derivatives, "DENSE", 0)
    alone = Curvature(energy).at(energy(q))
    size = np.max(np.abs(both))
    np.testing.assert_allclose(both, np.column_stack([alone(d), alone(other)]), atol=1e-10 * size)
    np.testing.assert_allclose(both[:, 0], product, atol=1e-10 * size)
    # the same as a Schur complement of a sparse matrix
    lifted = hessian.lifted()
    outer, mixed, stiffness = (part.toarray() for part in (lifted.outer, lifted.mixed, lifted.stiffness))
    schur = outer - mixed.T @ np.linalg.solve(stiffness, mixed)
    np.testing.assert_allclose(schur @ d, product, atol=1e-9 * np.max(np.abs(schur)))
    assert np.linalg.eigvalsh(stiffness).min() > 0


@pytest.mark.parametrize(("name", "objective"), OBJECTIVES)
def test_both_derivatives_of_objectives(name: str, objective: str) -> None:
    """By the adjoint, which for the energy are those of the reduced energy."""
    energy, rng = reduced(with_exact((CONTACTS | QUADRATIC)[name]())), np.random.default_rng(1)
    function = ReducedObjective(energy, parse_objective(objective))
    assert order_at_random(function, energy.relocation.parts.n_q, 1, 0.5) >= 1.9
    q, d = rng.uniform(-1, 1, (2, energy.relocation.parts.n_q)) * [[0.3], [1]]
    here = function(q)
    hessian = curvature_of(function)(here)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d, 2e-3) > 1.9
    if objective == "energy":
        envelope = energy(q)
        assert (envelope.is_energy, here.is_energy) == (True, False)
        assert here.value == pytest.approx(envelope.value, rel=1e-12)
        for found, known in (
            (here.gradient, envelope.gradient),
            (hessian(d), Curvature(energy).at(envelope)(d)),
        ):
            np.testing.assert_allclose(found, known, atol=1e-9 * np.max(np.abs(known)))
