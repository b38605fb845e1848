"""Phases of a solve, and what they add up to."""

import itertools
from typing import Any

import pytest

from rmesh_nlp.contact import active_set
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError, checked
from rmesh_nlp.optimize.process import Process
from rmesh_nlp.optimize.status import Status
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
    clock = Budget()
    time.now = 1.0
    clock.enter("solve")
    time.now = 3.0
    with clock.during("audit"):
        time.now = 7.0
    time.now = 15.0
    assert [clock.seconds(phase) for phase in ("build", "solve", "audit")] == [1.0, 10.0, 4.0]
    assert clock.elapsed == 11.0


def test_what_remains_is_without_audits_and_no_more_than_is_left_of_the_whole(monkeypatch):
    time = Time(monkeypatch)
    whole = Budget(Limits(seconds=10.0))
    part = Budget(Limits(seconds=100.0), whole)
    with whole.during("audit"):
        time.now = 4.0
    whole.kept = 1.0
    assert whole.remaining == part.remaining == 5.0
    assert Budget(Limits(seconds=2.0), whole).remaining == 2.0


def test_a_process_is_ended_at_a_checkpoint() -> None:
    whole, process = Budget(), Process("rmesh_nlp.meshes.mmg")
    whole.stopped = Status.INTERRUPTED
    with pytest.raises(StoppedError):
        checked(whole.check, lambda: process.ask(b""))
    assert process.megabytes == 0


def test_the_unit_of_cost_is_one_cold_contact_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)

    def slow(*arguments: Any) -> Any:
        time.now += 2.0
        return active_set.solve(*arguments)

    monkeypatch.setattr("rmesh_nlp.contact.solver.solve", slow)
    assert fixed.solve(example("6.2", (4, 2))).trace.contact_time_s == 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formulation", "options"),
    [(joint, {}), (nested, {"regularisation": (0.1, 0.01)}), (auto, {}), (auto, {"remesh": True})],
    ids=["joint", "weights", "cascade", "metric start"],
)
def test_no_time_is_counted_twice_or_forgotten(formulation, options, monkeypatch) -> None:
    """By a clock that only looks move on, each by the same."""
    looks = itertools.count()
    monkeypatch.setattr("time.perf_counter", lambda: 1e-3 * next(looks))
    problem = example("6.1", 6 if "remesh" in options else 2, 6)
    problem = problem if formulation is joint else no_move_limits(problem)
    began = next(looks)
    record = formulation.solve(problem, **options).record()
    passed = 1e-3 * (next(looks) - began)
    # a few looks before the first and after the last clock
    assert passed - 0.02 <= record["wall_time_s"] <= passed
