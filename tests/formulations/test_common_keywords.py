"""What all formulations share: keywords, clock, starts, limits."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Motion
from rmesh_nlp.solving.clock import Clock
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.solving.parts import Step
from support.formulations import auto, fixed, joint, mpcc, nested
from support.problems import no_boxes
from support.solved import example, solved

FORMULATIONS = [fixed, nested, joint, mpcc]
COMMON = {"settings", "tolerance", "max_iterations", "time_limit_s", "start", "seed", "on_step", "objective"}
SMALL = example("6.2", (4, 2))
UNLIMITED = replace(SMALL, motion=replace(SMALL.motion, delta=None))


def name_of(formulation: Any) -> str:
    return formulation.__name__.removeprefix("formulations.")


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_same_keywords_and_one_clock(formulation: Any) -> None:
    record = solved(name_of(formulation), "6.2", (4, 2)).record()
    parts = [record[f"{name}_time_s"] for name in ("build", "solve", "audit")]
    assert min(parts) > 0
    assert record["wall_time_s"] == pytest.approx(sum(parts))
    assert record["contact_time_s"] > 0
    assert record["start"] == "given"
    assert record["settings"] == {}
    assert record["gain_audited"] == record["energy_initial_audited"] - record["energy_audited"]


@pytest.mark.parametrize("name", ["fixed", "nested", "joint", "mpcc", "auto"])
def test_every_formulation_has_the_common_keywords(name: str) -> None:
    heeded = {"settings", "on_step", "objective"} if name == "fixed" else COMMON
    assert accepted(name, {*COMMON, "sede"}) == heeded


@pytest.mark.parametrize(
    ("formulation", "problem"),
    [(nested, SMALL), (joint, SMALL), (mpcc, SMALL), (auto, SMALL), (auto, UNLIMITED)],
    ids=["nested", "joint", "mpcc", "auto-joint", "auto-cascade"],
)
def test_a_limit_of_iterations_holds_and_is_said(formulation: Any, problem: Any) -> None:
    steps: list[Step] = []
    solution = formulation.solve(problem, max_iterations=2, tolerance=1e-5, on_step=steps.append)
    assert solution.status is Status.ITERATION_LIMIT
    assert solution.iterations == 2
    assert solution.valid
    assert solution.energy < solution.energy_initial
    assert steps[-1].iteration == 2
    record = solution.record()
    assert record["tolerance"] == 1e-5
    assert record["settings"] == {}
    assert record["limits"] == {"iterations": 2}


def test_limits_of_no_sense_are_refused() -> None:
    for name, field in (
        ("tolerance", "tolerance"),
        ("max_iterations", "iterations"),
        ("time_limit_s", "seconds"),
    ):
        for value in (-1, float("nan"), "1"):
            with pytest.raises(BadInputError, match=f"{field} must be .*, got {value!r}"):
                joint.solve(SMALL, **{name: value})
    for name, field in (("tolerance", "tolerance"), ("time_limit_s", "seconds")):
        with pytest.raises(BadInputError, match=f"{field} must be positive and finite, got 0"):
            joint.solve(SMALL, **{name: 0})
    with pytest.raises(BadInputError, match=r"iterations must be a whole number, got 1\.5"):
        joint.solve(SMALL, max_iterations=1.5)


def test_phases_add_up_to_what_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    clock = Clock()
    now[0] = 1.0
    clock.enter("solve")
    now[0] = 3.0
    with clock.during("audit"):
        now[0] = 7.0
    now[0] = 15.0
    assert [clock.seconds(phase) for phase in ("build", "solve", "audit")] == [1.0, 10.0, 4.0]
    assert clock.elapsed == 11.0


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        (joint, {}),
        (nested, {"regularisation": (0.1, 0.01)}),
        pytest.param(nested, {"regularisation": 0.01, "flips": True}, marks=pytest.mark.slow),
        pytest.param(auto, {}, marks=pytest.mark.slow),
        pytest.param(auto, {"flips": True}, marks=pytest.mark.slow),
    ],
    ids=["joint", "weights", "weights and flips", "cascade", "cascade and flips"],
)
def test_no_time_is_counted_twice_or_forgotten(
    formulation: Any, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that only looks move on, each by the same."""
    looks = itertools.count()
    monkeypatch.setattr("time.perf_counter", lambda: 1e-3 * next(looks))
    problem = example("6.1", 3, 6)
    problem = problem if formulation is joint else no_boxes(problem)
    began = next(looks)
    record = formulation.solve(problem, **options).record()
    passed = 1e-3 * (next(looks) - began)
    assert record["wall_time_s"] <= passed
    assert record["wall_time_s"] >= passed - 0.02  # a few looks before the first and after the last clock


def test_the_unit_of_cost_is_one_cold_contact_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    from rmesh_nlp.contact.solver import ContactSolver

    real = ContactSolver.solve

    def solve(self: ContactSolver, *arguments: Any) -> Any:
        now[0] += 2.0
        return real(self, *arguments)

    monkeypatch.setattr(ContactSolver, "solve", solve)
    assert fixed.solve(SMALL).contact_time_s == 2.0


@pytest.mark.parametrize("formulation", [nested, joint, mpcc])
def test_a_time_limit_keeps_a_valid_mesh(formulation: Any) -> None:
    solution = formulation.solve(SMALL, time_limit_s=1e-6)
    assert solution.status is Status.TIME_LIMIT
    assert solution.valid
    assert solution.success
    assert solution.energy <= solution.energy_initial + 1e-9


@pytest.mark.parametrize("formulation", [nested, joint, mpcc])
def test_an_interruption_keeps_the_best_valid_mesh(formulation: Any) -> None:
    seen: list[Step] = []

    def interrupt(step: Step) -> None:
        seen.append(step)
        if len(seen) == 3:
            raise KeyboardInterrupt

    solution = formulation.solve(SMALL, on_step=interrupt)
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    assert len(seen) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("formulation", [nested, joint])
def test_starts_are_positions_names_and_solutions(formulation: Any) -> None:
    end = solved(name_of(formulation), "6.2", (4, 2))
    for start, name in (
        (np.asarray(end.mesh.p), "positions"),
        (end, f"solution of {end.formulation}"),
        ("fixed", "fixed"),
        ("given", "given"),
    ):
        solution = formulation.solve(SMALL, start=start)
        assert solution.start == name
        assert solution.success
    assert formulation.solve(SMALL, start=end).iterations <= end.iterations + 20
    with pytest.raises(BadInputError, match="unknown start 'jiont': did you mean joint"):
        formulation.solve(SMALL, start="jiont")
    with pytest.raises(BadInputError, match="the start has 3 nodes, the problem 15"):
        formulation.solve(SMALL, start=np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("formulation", "settings"),
    [
        (nested, {"newton": {"forcing": 0.2}}),
        (joint, {"tol": 1e-8}),
        (mpcc, {"options": {"crossover": 1e-3}}),
    ],
)
def test_settings_that_differ_from_the_defaults_are_in_the_record(formulation: Any, settings: Any) -> None:
    assert formulation.solve(SMALL, settings=settings).record()["settings"] == settings


@pytest.mark.parametrize("outer", ["newton", "newton-cg", "ipopt"])
def test_nothing_to_move_is_no_crash(outer: str) -> None:
    still = replace(SMALL, motion=Motion(0.1, pinned=tuple(range(SMALL.mesh.p.shape[1]))))
    solution = nested.solve(still, outer=outer)
    assert solution.status is Status.CONVERGED
    assert solution.energy == solution.energy_initial


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_one_contact_node_and_no_load_are_solved(formulation: Any) -> None:
    assert np.isfinite(formulation.solve(EXAMPLES["6.1"](2)).energy)
    unloaded = formulation.solve(replace(SMALL, tractions=()))
    assert unloaded.status is Status.CONVERGED
    assert unloaded.success
