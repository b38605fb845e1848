from dataclasses import replace

import numpy as np
import pytest

from support.formulations import mpcc
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.reference import reference_solution, with_reference


def test_splines_reproduce_the_fine_solution_at_its_nodes_and_the_exact_one_between() -> None:
    fine = EXAMPLES["6.1"](32)
    reference = reference_solution(replace(fine, quadrature=6))
    for x, y in [(0.3, 0.2), (0.77, 0.13), (0.5, 0.9)]:
        exact = float(fine.exact.value(x, y))
        assert float(reference.value(x, y)) == pytest.approx(exact, abs=5e-3)
    assert reference.energy > fine.exact.energy


def test_scattered_nodes_are_refused() -> None:
    problem = EXAMPLES["6.1"](4)
    p = problem.mesh.p.copy()
    p[:, 12] += 0.01
    with pytest.raises(ValueError, match="rectangular grid: 25 nodes lie on 6 x 6 grid lines"):
        reference_solution(replace(problem, mesh=replace(problem.mesh, doflocs=p)))


@pytest.mark.slow
def test_an_error_objective_goes_down_against_a_reference() -> None:
    problem = with_reference(EXAMPLES["6.3"]((4, 2)))
    record = mpcc.solve(problem, objective="error-l2").record()
    assert record["success"]
    assert record["objective_value"] < 0.9 * record["objective_initial"]
    assert np.isfinite(record["energy_audited"])


def test_exact_solutions_are_kept() -> None:
    problem = EXAMPLES["6.1"](4)
    assert with_reference(problem) is problem
