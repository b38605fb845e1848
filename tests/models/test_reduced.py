"""The reduced energy: what its evaluations count, remember and add."""

from __future__ import annotations

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return EXAMPLES["6.3"]((4, 2))


def test_the_solution_on_the_given_mesh_is_counted_when_it_is_first_asked_for(
    problem: ContactProblem,
) -> None:
    outer = Outer(problem)
    reduced, q, given = outer.energy, np.zeros(outer.n), outer.given
    assert (reduced.contact_solves, reduced.cold_solves, reduced.factorisations) == (0, 0, 0)
    for _ in range(2):
        assert reduced(q).equilibrium.energy == given.energy
        assert (reduced.contact_solves, reduced.cold_solves) == (1, 1)
        assert reduced.factorisations == given.iterations
        reduced._last = None
    reduced(q + 0.1)
    assert (reduced.contact_solves, reduced.cold_solves) == (2, 1)


def test_solves_are_counted_and_the_last_point_is_remembered(problem: ContactProblem) -> None:
    outer = Outer(problem)
    reduced = ReducedEnergy(outer.relocation)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, outer.relocation.n_q)
    counts = lambda: (reduced.contact_solves, reduced.cold_solves)  # noqa: E731
    first = reduced(q)
    assert counts() == (1, 1)
    assert reduced.factorisations == first.equilibrium.iterations
    assert reduced(q.copy()) is first
    assert counts() == (1, 1)
    second = reduced(0.5 * q)
    assert counts() == (2, 1)
    assert reduced.factorisations == first.equilibrium.iterations + second.equilibrium.iterations
    cold = ContactSolver(discretise(problem)).solve(outer.relocation.nodes(0.5 * q))
    assert second.value == pytest.approx(cold.energy, rel=1e-10)
    np.testing.assert_array_equal(second.weak, np.zeros(problem.contact_nodes.size, dtype=bool))


def test_terms_in_the_positions_are_added_and_undefined_where_an_element_is_inverted() -> None:
    plain, mixed = (Outer(EXAMPLES["6.1"](3), text) for text in ("energy", "energy + 0.5*quality"))
    q = np.random.default_rng(0).uniform(-0.5, 0.5, plain.relocation.n_q)
    quality = Outer(EXAMPLES["6.1"](3), "energy + 1*quality")
    weight = mixed.energy.of_positions(q)
    assert weight == pytest.approx(0.5 * quality.energy.of_positions(q))
    assert mixed.energy(q).value == pytest.approx(plain.energy(q).value + weight)
    assert plain.energy.of_positions(q) == 0
    far = np.full(q.size, 50.0)
    assert mixed.energy.is_defined(q)
    assert not mixed.energy.is_defined(far) or mixed.energy.of_positions(far) > 1e3
    function = plain.minimising(parse_objective("quality")).function
    assert function.is_defined(q)
    assert not function.is_defined(20 * (-1.0) ** np.arange(q.size))
