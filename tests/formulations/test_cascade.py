"""The cascade of meshes: weights and work of its levels, and what an interrupt keeps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import cascade as module
from formulations.cascade import Cascade
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.models.levels import coarsened
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from support.problems import no_move_limits


def square(n: int) -> ContactProblem:
    return replace(no_move_limits(EXAMPLES["6.1"](n=n)), quadrature=8)


def test_levels_have_the_weight_of_their_error_and_add_up() -> None:
    problem = square(8)
    solution = rm.solve(problem, Cascade(coarsest=20, iterations=6))
    row, (coarse, fine) = solution.record(), solution.record()["cascade"]
    assert [level["nodes"] for level in (coarse, fine)] == [25, 81]
    assert [level["triangles"] for level in (coarse, fine)] == [32, 128]
    # the error falls like the number of nodes
    coarser = coarsened(problem, 20)
    assert coarser is not None
    error = gain_estimate(ContactSolver(coarser)) * 25 / 81
    assert row["gain_estimate"] == pytest.approx(error)
    assert row["regularisation_weight"] == pytest.approx(0.003 * error)
    assert row["iterations"] == coarse["iterations"] + fine["iterations"] <= 5 * 6
    assert 0 < coarse["contact_solves"] + fine["contact_solves"] <= row["contact_solves"]
    assert fine["energy"] == pytest.approx(solution.energy)
    assert solution.energy < solution.energy_initial


def test_a_map_that_folds_triangles_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(*given: Any) -> np.ndarray:
        return np.random.default_rng(0).uniform(-9, 9, given[-1].n_q)

    monkeypatch.setattr(module, "prolonged", folded)
    assert rm.solve(square(8), coarsest=20, iterations=2).record()["gain_audited"] > 0


def test_a_limit_on_a_coarse_mesh_takes_its_map_to_the_given_one() -> None:
    problem = square(8)
    solution = rm.solve(problem, Cascade(coarsest=20), limits=rm.Limits(iterations=2))
    row = solution.record()
    assert (solution.status, row["valid"]) == (Status.ITERATION_LIMIT, True)
    assert [level["nodes"] for level in row["cascade"]] == [25]
    assert np.min(signed_areas(solution.mesh.p, problem.triangles)) > 0
    assert solution.gain_audited > 0


@pytest.mark.slow
def test_from_its_end_newton_comes_to_a_stationary_point_in_as_few_solves() -> None:
    """A factorisation near the end: without any 8 to 19 times as many contact solves were taken."""
    problem = square(16)
    first = rm.solve(problem, "cascade")
    solution = rm.solve(problem, start=first)
    assert first.status is not solution.status is Status.CONVERGED
    assert solution.stationarity_residual <= 1e-6
    assert solution.contact_solves <= 2 * first.contact_solves
    assert solution.energy_audited < first.energy_audited


@pytest.mark.slow
def test_meshes_that_are_not_nested_gain_as_much_as_their_neighbours() -> None:
    """Error times nodes, in the mean: single ones differ by a tenth between sizes and processors."""
    products = []
    for n in range(12, 18):
        problem = square(n)
        error = rm.solve(problem, "cascade").energy_audited - problem.exact.energy
        products.append(error * problem.mesh.p.shape[1])
    assert np.mean(products[1::2]) < 1.1 * np.mean(products[::2])
