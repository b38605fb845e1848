"""The program of the moves with its Hessian, and what it is for: area constraints, and ipopt."""

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.reduced_nlp import ReducedNLP, dense, reduced_nlp, with_hessian
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from support.formulations import nested

PROBLEMS = {
    "6.1 with areas": (lambda: EXAMPLES["6.1"](3, 0.9), "energy"),
    "6.3 with areas": (lambda: EXAMPLES["6.3"]((6, 3), (1.0, 0.5)), "energy"),
    "6.1 and its error": (lambda: EXAMPLES["6.1"](4), "error-l2"),
}


def program_of(problem: ContactProblem, objective: str) -> ReducedNLP:
    outer = Outer(problem, objective)
    return with_hessian(
        reduced_nlp(outer.relocation, outer.function, outer.is_valid, outer.residual, outer.tolerance)
    )


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_hessian_is_that_of_the_lagrangian(name: str) -> None:
    make, objective = PROBLEMS[name]
    program = program_of(make(), objective)
    nlp, derivatives = program.nlp, program.nlp.derivatives
    rng = np.random.default_rng(4)
    q, d = 0.02 * rng.uniform(-1, 1, nlp.n_x), rng.uniform(-1, 1, nlp.n_x)
    lam_f, lam_g = 1.5, rng.uniform(-1, 0, nlp.n_g)

    def gradient(x: np.ndarray) -> np.ndarray:
        slope = derivatives.grad_f(x, [])[1].full().ravel()
        return lam_f * slope + derivatives.jac_g(x, [])[1].T.full() @ lam_g

    upper = derivatives.hess_lag(q, [], lam_f, lam_g).full()
    assert np.all(np.tril(upper, -1) == 0)
    product = (upper + np.triu(upper, 1).T) @ d
    h = 1e-5
    difference = (gradient(q + h * d) - gradient(q - h * d)) / (2 * h)
    np.testing.assert_allclose(product, difference, atol=2e-6 * np.max(np.abs(product)))


def test_columns_in_one_block_or_in_many_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    A = np.random.default_rng(0).standard_normal((7, 7))
    A = A + A.T
    monkeypatch.setattr("rmesh_nlp.models.reduced_nlp.COLUMNS", 3)
    np.testing.assert_allclose(dense(lambda d: A @ d, 7), A, rtol=1e-14)


def test_meshes_with_inverted_elements_have_no_energy() -> None:
    program = program_of(EXAMPLES["6.1"](3, 0.9), "energy")
    value, _ = program.nlp.derivatives.grad_f(np.random.default_rng(0).uniform(-1, 1, program.nlp.n_x), [])
    assert np.isnan(float(value))


@pytest.mark.parametrize("outer", ["newton", "ipopt"])
def test_area_constraints_are_met_at_a_stationary_point(outer: str) -> None:
    solution = nested.solve(EXAMPLES["6.2"]((6, 3), (1.0, 0.5)), outer=outer)
    assert solution.status.value == "converged"
    assert solution.record()["outer_method"] == "interior point with exact Hessians"
    assert np.any(solution.multipliers.area > 0)
    assert solution.contact_solves < 60


@pytest.mark.slow
@pytest.mark.parametrize("outer", ["newton", "ipopt"])
def test_a_start_at_a_minimiser_ends_there_and_never_higher(outer: str) -> None:
    problem = EXAMPLES["6.2"]((6, 3), (1.0, 0.5))
    first = nested.solve(problem)
    again = nested.solve(problem, outer=outer, start=first)
    np.testing.assert_allclose(again.mesh.p, first.mesh.p, atol=1e-6)
    assert again.energy <= first.energy + 1e-12 * abs(first.energy)
    assert again.record()["status"] == "converged"
