"""Phases of a solve, what they add up to, and guesses of the time that is left."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.solving.clock import Clock, Falling
from rmesh_nlp.solving.parts import Step
from support.formulations import auto, fixed, joint, nested
from support.problems import no_move_limits
from support.solved import example


class Time:
    """The time that the package sees."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        monkeypatch.setattr("time.perf_counter", lambda: self.now)


def test_phases_add_up_to_what_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    clock = Clock()
    time.now = 1.0
    clock.enter("solve")
    time.now = 3.0
    with clock.during("audit"):
        time.now = 7.0
    time.now = 15.0
    assert [clock.seconds(phase) for phase in ("build", "solve", "audit")] == [1.0, 10.0, 4.0]
    assert clock.elapsed == 11.0


def test_the_unit_of_cost_is_one_cold_contact_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    time, solve = Time(monkeypatch), ContactSolver.solve

    def slow(self: ContactSolver, *arguments: Any) -> Any:
        time.now += 2.0
        return solve(self, *arguments)

    monkeypatch.setattr(ContactSolver, "solve", slow)
    assert fixed.solve(example("6.2", (4, 2))).contact_time_s == 2.0


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        (joint, {}),
        (nested, {"regularisation": (0.1, 0.01)}),
        pytest.param(auto, {}, marks=pytest.mark.slow),
        pytest.param(auto, {"remesh": True}, marks=pytest.mark.slow),
    ],
    ids=["joint", "weights", "cascade", "metric start"],
)
def test_no_time_is_counted_twice_or_forgotten(
    formulation: Any, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that only looks move on, each by the same."""
    looks = itertools.count()
    monkeypatch.setattr("time.perf_counter", lambda: 1e-3 * next(looks))
    problem = example("6.1", 6 if "remesh" in options else 3, 6)
    problem = problem if formulation is joint else no_move_limits(problem)
    began = next(looks)
    record = formulation.solve(problem, **options).record()
    passed = 1e-3 * (next(looks) - began)
    # a few looks before the first and after the last clock
    assert passed - 0.02 <= record["wall_time_s"] <= passed


def left(target: float, *values: float, seconds: float = 2.0) -> float | None:
    falling = Falling(target)
    for k, value in enumerate(values):
        falling(seconds * k, value)
    return falling.seconds_left


def test_the_time_left_is_that_of_a_geometric_sequence() -> None:
    falls = [10 * 0.1**k for k in range(8)]
    assert left(1e-9, *falls) == pytest.approx(2.0 * 3)
    assert left(1e-3, *falls) == 0.0  # it was there at k = 4
    assert left(1e-9, *falls[:6]) == pytest.approx(2.0 * 5)
    # the first of many steps is no part of a guess
    assert left(1e-12, 1e6, *[0.1**k for k in range(12)]) == pytest.approx(2.0 * 1)


@pytest.mark.parametrize(
    ("values", "seconds"),
    [
        ([0.5**k for k in range(5)] + [0.0, -1.0, math.nan, math.inf], 1.0),  # five that count are too few
        ([2.0**k for k in range(10)], 1.0),  # it grows
        ([0.5**k for k in range(10)], 0.0),  # in no time
        ([1 - 1e-9 * k for k in range(10)], 1.0),  # more than a day
    ],
)
def test_nothing_is_guessed_of_few_values_or_of_what_does_not_fall(
    values: list[float], seconds: float
) -> None:
    assert left(1e-3, *values, seconds=seconds) is None


def test_a_descent_that_ends_with_little_decrease_guesses_when() -> None:
    steps: list[Step] = []
    nested.solve(EXAMPLES["6.1"](n=8), outer="newton", settings={"enough": 1e-14}, on_step=steps.append)
    guesses = [step.seconds_left for step in steps]
    assert math.isnan(guesses[0])
    assert any(math.isfinite(guess) for guess in guesses)
