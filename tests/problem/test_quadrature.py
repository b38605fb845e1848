"""The quadrature rule that a load gets."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace
from rmesh_nlp.problem.coefficients import polynomial_degree
from support.formulations import fixed


@pytest.mark.parametrize(
    ("load", "degree"),
    [
        (3.0, 0),
        (lambda x, y: 2 + 0 * x, 0),
        (lambda x, y: x * y - y, 2),
        (lambda x, y: x**2 * y**3, 5),
        (lambda x, y: ca.sin(x), None),
        (lambda x, y: ca.if_else(x > 0, x, 1.0), None),
        (lambda x, y: ca.if_else(x > 0, 2.0, 1.0), None),
        (lambda x, y: ca.fabs(y), None),
        (lambda x, y: 1 / (1 + x**2), None),
    ],
)
def test_the_degree_of_a_load(load: Any, degree: int | None) -> None:
    assert polynomial_degree(load) == degree


def test_a_problem_of_ones_own_gets_a_rule_that_is_exact_for_its_load() -> None:
    problem = ContactProblem(rectangle(3, 3), Laplace(lambda x, y: 10 * x * x * y), ("left",))
    assert problem.rule == 4
    solution = fixed.solve(problem)
    assert solution.energy == pytest.approx(solution.audit.energy_audited, rel=1e-13)
    assert EXAMPLES["6.1"](2).rule == "midpoint"
