"""Progress of a solve: gain, residual, a guess of the time left."""

import pytest

from rmesh_nlp.campaign.pace import TOLERANCE, Pace
from rmesh_nlp.solution.solution import Step


def steps(count: int, factor: float) -> Pace:
    """A residual that falls by ``factor`` in every step of a second."""
    pace = Pace()
    for k in range(count):
        pace(Step(k, -1.0 - 0.1 * k, float("nan"), 0.0, factor**k, 0, float(k)))
    return pace


def test_the_time_left_follows_the_fall_of_the_residual() -> None:
    pace = steps(10, 0.5)
    assert pace.gain == pytest.approx(0.9)
    assert pace.residual == pytest.approx(0.5**9)
    # seconds until 0.5**k is the tolerance, less those that have passed
    import math

    assert pace.seconds_left == pytest.approx(math.log(TOLERANCE) / math.log(0.5) - 9, rel=1e-6)
    assert pace.text() == "iteration 9, J = -1.9, gain 0.9, residual 2.0e-03, perhaps 11 s left"


def test_nothing_is_guessed_of_a_residual_that_does_not_fall() -> None:
    assert steps(10, 1.0).seconds_left is None
    assert steps(3, 0.5).seconds_left is None
    assert Pace().text() == ""
