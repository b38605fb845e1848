"""Taylor tests of outer objectives differentiated through the contact solve."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem, ExactSolution
from rmesh_nlp.programs.reduced import ReducedObjective
from rmesh_nlp.solution.referee import Referee
from support.problems import sloped_block


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
}


OBJECTIVES = ("error-l2", "error-energy", "contact", "energy", "energy + 0.1*quality")

QUICK = {
    ("6.1", "error-energy"),
    ("6.1", "contact"),
    ("6.3", "energy"),
    ("sloped, stick and slip", "error-l2"),
}
"""Each objective and each kind of contact once; the other combinations are slow."""


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        pytest.param(name, objective, marks=() if (name, objective) in QUICK else pytest.mark.slow)
        for name in PROBLEMS
        for objective in OBJECTIVES
    ],
)
def test_adjoint_gradient_is_of_second_order(name: str, objective: str) -> None:
    referee = Referee(PROBLEMS[name]())
    function = ReducedObjective(referee.reduced, parse_objective(objective))
    rng = np.random.default_rng(1)
    q = 0.5 * rng.uniform(-1, 1, referee.relocation.n_q)
    d = rng.uniform(-1, 1, q.size)
    here = function(q)
    assert not np.any(here.weak)
    steps = 1e-2 * 0.5 ** np.arange(5)
    remainder = np.array([abs(function(q + h * d).value - here.value - h * here.gradient @ d) for h in steps])
    rates = np.log2(remainder[:-1] / remainder[1:])
    assert rates[-1] >= 1.9, rates


def test_the_energy_gradient_is_the_adjoint_gradient_of_the_energy() -> None:
    referee = Referee(EXAMPLES["6.3"]())
    q = 0.5 * np.random.default_rng(2).uniform(-1, 1, referee.relocation.n_q)
    envelope = referee.reduced(q).gradient
    adjoint = ReducedObjective(referee.reduced, parse_objective("energy"))(q).gradient
    np.testing.assert_allclose(adjoint, envelope, atol=1e-10 * np.max(np.abs(envelope)))
