from dataclasses import replace

import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.reference import reference_solution, with_reference


@pytest.mark.parametrize("order", [1, 2])
def test_splines_reproduce_the_fine_solution_at_its_nodes_and_the_exact_one_between(order: int) -> None:
    fine = EXAMPLES["6.1"](32 // order, order=order)
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


def test_exact_solutions_are_kept() -> None:
    problem = EXAMPLES["6.1"](4)
    assert with_reference(problem) is problem
