"""Taylor tests of the reduced energy L(X) and its gradient (5.7), (5.11)."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solution.referee import Referee
from support.problems import sloped_block


def taylor_rates(problem: ContactProblem, seed: int) -> np.ndarray:
    """Orders of ``L(q + h d) - L(q) - h L'(q) d`` for halved h at a random admissible q."""
    referee = Referee(problem)
    rng = np.random.default_rng(seed)
    q = 0.6 * rng.uniform(-1, 1, referee.relocation.n_q)
    d = rng.uniform(-1, 1, q.size)
    here = referee.reduced(q)
    steps = 1e-2 * 0.5 ** np.arange(5)
    remainder = [abs(referee.reduced(q + h * d).value - here.value - h * here.gradient @ d) for h in steps]
    return np.log2(np.array(remainder[:-1]) / np.array(remainder[1:]))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["6.1", "6.2", "6.3"])
def test_gradient_is_of_second_order(name: str, seed: int) -> None:
    rates = taylor_rates(EXAMPLES[name](), seed)
    assert rates[-1] >= 1.9, rates


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_gradient_with_a_moving_sloped_contact_boundary(seed: int) -> None:
    rates = taylor_rates(sloped_block(), seed)
    assert rates[-1] >= 1.9, rates


def test_weights_that_do_not_move_would_be_noticed() -> None:
    # the derivative of omega_i is a visible part of the gradient of 6.3
    problem = EXAMPLES["6.3"]()
    referee = Referee(problem)
    moving = referee.reduced(np.zeros(referee.relocation.n_q)).gradient
    smooth = replace(problem, obstacle=replace(problem.obstacle, friction=1e-12))
    point = Referee(smooth).reduced
    (still,) = point._gradient(
        referee.reduced.point(np.zeros(moving.size), referee.initial),
        referee.initial.normal_force,
        referee.initial.tangential_force,
    )
    assert np.max(np.abs(moving - still)) > 0.1 * np.max(np.abs(moving))
