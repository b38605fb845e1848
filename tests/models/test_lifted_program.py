"""The sparse matrix that stands for the dense Hessian of the reduced energy, and solves with it."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.reduced_nlp import STIFF, ReducedNLP, lifted, reduced_nlp, with_hessian
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain
from rmesh_nlp.solving.clock import TOLERANCE
from rmesh_nlp.solving.outer import Outer
from support.formulations import nested

PROBLEMS = {
    "6.1, areas": lambda: EXAMPLES["6.1"](3, 0.9),
    "6.2, gaps that move": lambda: EXAMPLES["6.2"]((6, 3), (1.0, 0.5)),
    "6.3, friction": lambda: EXAMPLES["6.3"]((6, 3), (1.0, 0.5)),
    "gaps along edges": lambda: bumpy(0.0),
    "gaps along edges, friction": lambda: bumpy(0.3),
}


def bumpy(friction: float) -> ContactProblem:
    """A gap along edges depends on the positions of two neighbours, which are of no common element."""
    foundation = Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.02 * ca.sin(2 * x) ** 2, friction, gap="edge")
    law = PlaneStrain(50.0, 50.0, (1.0, -4.0))
    return ContactProblem(rectangle(4, 3, x=(0, 2)), law, ("left",), foundation, Motion(None))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_newton_converges_with_gaps_along_edges(friction: float) -> None:
    """Without some entries of the matrix Ipopt's steps are not Newton's, and it meets its limit of 500."""
    solution = nested.solve(bumpy(friction), outer="newton")
    assert solution.status.value == "converged"
    assert solution.iterations <= 100


def program_of(problem: ContactProblem, objective: str = "energy") -> ReducedNLP:
    outer = Outer(problem, objective)
    return reduced_nlp(outer.relocation, outer.function, outer.is_valid, outer.residual, outer.tolerance)


def whole(upper: np.ndarray) -> np.ndarray:
    return upper + np.triu(upper, 1).T


@pytest.mark.parametrize("factor", [1.5, 0.0])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_schur_complement_in_the_moves_is_the_dense_hessian(name: str, factor: float) -> None:
    program = program_of(PROBLEMS[name]())
    larger, n = lifted(program), program.nlp.n_x
    rng = np.random.default_rng(7)
    q, lam_g = 0.02 * rng.uniform(-1, 1, n), rng.uniform(-1, 0, program.nlp.n_g)
    matrix = whole(
        larger.derivatives.hess_lag(np.append(q, np.zeros(larger.n_x - n)), [], factor, lam_g).full()
    )
    corner = matrix[n:, n:]
    schur = matrix[:n, :n] - matrix[:n, n:] @ np.linalg.solve(corner, matrix[n:, :n])
    other = with_hessian(program)  # its callback must outlive the call
    dense = whole(other.nlp.derivatives.hess_lag(q, [], factor, lam_g).full())
    np.testing.assert_allclose(schur, dense, atol=1e-9 * np.max(np.abs(dense)))
    # definite, and so stiff that a shift of the moves' size does not change the complement
    assert np.linalg.eigvalsh(corner)[0] > 0
    np.testing.assert_allclose(np.diag(corner), STIFF * np.max(np.abs(matrix[:n, :n])), rtol=1e-9)


def test_additional_unknowns_change_neither_objective_nor_constraints() -> None:
    program = program_of(PROBLEMS["6.1, areas"]())
    larger, n = lifted(program), program.nlp.n_x
    rng = np.random.default_rng(1)
    x = np.concatenate([0.02 * rng.uniform(-1, 1, n), rng.standard_normal(larger.n_x - n)])
    value, slope = larger.derivatives.grad_f(x, [])
    own, own_slope = program.nlp.derivatives.grad_f(x[:n], [])
    assert float(value) == float(own)
    np.testing.assert_array_equal(slope.full()[:n], own_slope.full())
    assert not np.any(slope.full()[n:])
    rows = larger.derivatives.jac_g(x, [])[1].full()
    np.testing.assert_array_equal(rows[:, :n], program.nlp.derivatives.jac_g(x[:n], [])[1].full())
    assert not np.any(rows[:, n:])


def test_other_objectives_are_not_lifted() -> None:
    with pytest.raises(TypeError, match="energy"):
        lifted(program_of(EXAMPLES["6.1"](3), "error-l2"))


@pytest.mark.parametrize("outer", ["newton", "newton-cg"])
@pytest.mark.parametrize("name", ["6.2, gaps that move", "6.3, friction"])
def test_few_contact_solves_lead_to_a_stationary_point(name: str, outer: str) -> None:
    solution = nested.solve(PROBLEMS[name](), outer=outer)
    assert solution.status.value == "converged"
    assert solution.stationarity_residual <= TOLERANCE
    assert solution.contact_solves <= 2 * solution.iterations
    if outer == "newton":  # one that went on below the tolerance would spend dozens of solves on rounding
        assert all(step.stationarity > TOLERANCE for step in solution.history[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6.2", "6.3"])
def test_conjugate_gradients_alone_do_where_no_area_is_in_the_way(name: str) -> None:
    one, two = (nested.solve(EXAMPLES[name](), outer=outer) for outer in ("newton-cg", "newton"))
    assert one.status.value == two.status.value == "converged"
    assert one.record()["outer_method"] == "projected Newton-CG"
    assert one.contact_solves < two.contact_solves


@pytest.mark.slow
def test_crowded_areas_are_left_to_the_interior_point() -> None:
    problem = replace(EXAMPLES["6.1"](6, 0.15), quadrature=6)
    few = nested.solve(problem, outer="newton-cg", settings={"newton": {"crowded": 1}})
    assert few.status.value == "converged"
    assert few.record()["outer_method"] == "projected Newton-CG, then interior point with exact Hessians"
    numbers = [step.iteration for step in few.history]
    assert numbers == sorted(numbers)
    assert few.energy < few.energy_initial


@pytest.mark.slow
def test_thousands_of_moves_without_boxes_take_a_contact_solve_per_iteration() -> None:
    problem = EXAMPLES["6.1"](40)
    problem = replace(problem, motion=replace(problem.motion, delta=None), quadrature=8)
    solution = nested.solve(problem, max_iterations=6)
    assert solution.multipliers.area.size > 3000
    assert solution.status.value == "iteration_limit"
    assert solution.valid
    assert solution.improved
    assert solution.success
    assert solution.iterations <= 6
    assert solution.contact_solves <= 20
    assert solution.energy < solution.energy_initial
