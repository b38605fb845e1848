"""Guesses of the time that is left."""

from __future__ import annotations

import math

import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.solving.clock import Falling
from rmesh_nlp.solving.parts import Step
from support.formulations import nested


def test_a_geometric_sequence_ends_where_it_meets_its_target() -> None:
    falling = Falling(1e-3)
    for k in range(8):
        falling(2.0 * k, 0.1**k * 10)
    # it is at 1e-6 after 7 steps; before that, at 10 * 0.1**k, k = 4 is the target
    assert falling.seconds_left == 0.0
    falling = Falling(1e-9)
    for k in range(8):
        falling(2.0 * k, 0.1**k * 10)
    assert falling.seconds_left == pytest.approx(2.0 * 3)


def test_nothing_is_guessed_of_few_values_or_of_what_does_not_fall() -> None:
    falling = Falling(1e-3)
    for k in range(5):
        falling(float(k), 0.5**k)
    for bad in (0.0, -1.0, math.nan, math.inf):
        falling(9.0, bad)
    assert falling.seconds_left is None  # the five that count are too few
    growing = Falling(1e-3)
    for k in range(10):
        growing(float(k), 2.0**k)
    assert growing.seconds_left is None
    at_once = Falling(1e-3)
    for k in range(10):
        at_once(1.0, 0.5**k)
    assert at_once.seconds_left is None


def test_a_descent_that_ends_with_little_decrease_guesses_when() -> None:
    steps: list[Step] = []
    nested.solve(EXAMPLES["6.1"](n=8), outer="newton", settings={"enough": 1e-14}, on_step=steps.append)
    guesses = [step.seconds_left for step in steps]
    assert math.isnan(guesses[0])
    assert any(math.isfinite(guess) for guess in guesses)
