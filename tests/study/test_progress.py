"""Progress of a solve: gain, residual, an estimate of the time left; and lines about many solves."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from rmesh_nlp.solving.clock import TOLERANCE
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.study import progress
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.progress import EVERY, Pace, SolvesProgress


def steps(count: int, factor: float) -> Pace:
    """A residual that falls by ``factor`` in every step of a second."""
    pace = Pace()
    for k in range(count):
        pace(Step(k, -1.0 - 0.1 * k, float("nan"), 0.0, factor**k, 0, float(k)))
    return pace


def test_the_time_left_follows_the_fall_of_the_residual():
    # seconds until 0.5**k is the tolerance, less those that have passed
    assert math.log(TOLERANCE) / math.log(0.5) - 9 == pytest.approx(10.93, abs=0.01)
    said = "iteration 9, J = -1.9, gain 0.9, residual 2.0e-03, perhaps 11 s left"
    assert steps(10, 0.5).text() == said


def test_nothing_is_estimated_of_a_residual_that_does_not_fall():
    assert "left" not in steps(10, 1.0).text()
    assert "left" not in steps(3, 0.5).text()
    assert Pace().text() == ""


def test_the_estimate_of_a_formulation_goes_first_and_the_time_limit_bounds_it():
    pace = Pace(limit=100.0)
    for k in range(10):
        pace(Step(k, -1.0, 0.0, 0.0, 0.5**k, 0, 10.0 * k, seconds_left=40.0 - 3 * k))
    # 60 iterations of this residual would follow, the formulation knows of fewer, the limit leaves less
    assert pace.text().endswith("perhaps 10 s left")


def test_where_nothing_can_be_estimated_the_time_limit_is_shown():
    pace = Pace(limit=600.0)
    pace(Step(0, -1.0, 0.0, 0.0, float("nan"), 0, 60.0))
    assert pace.text() == "iteration 0, J = -1, gain 0, residual 0.0e+00, at most 9 min left"


def test_a_gain_counts_from_the_mesh_that_the_step_is_on():
    pace = Pace()
    for given, energy, gain in ((-0.9, -1.0, "0.1"), (-4.8, -5.0, "0.2")):  # a finer mesh has a lower energy
        pace(Step(0, energy, 0.0, 0.0, 1.0, 0, 0.0, energy_given=given))
        assert f"gain {gain}," in pace.text()


def test_another_objective_is_shown_in_the_place_of_the_energy():
    pace = Pace(of_energy=False)
    for k in range(3):
        pace(Step(k, 5.0 + k, 0.0, 0.0, float("nan"), 0, 1.0, objective=0.02 - 0.005 * k))
    assert pace.text() == "iteration 2, objective 0.02 -> 0.01, residual 0.0e+00"


DESIGNED: dict[str, Any] = {
    **{"example": "seal", "formulation": "mpcc", "objective": "resultant(bottom)", "status": "converged"},
    **{"success": True, "energy_audited": 7.0, "energy_initial_audited": 6.0, "iterations": 12},
    **{"objective_initial": 4.0, "objective_value": 1.0, "wall_time_s": 0.5},
    "design": {"E": 1.25, "h0": -0.5},
}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "objective = 4 -> 1 (gain 3, 75 %), E = 1.25, h0 = -0.5, 12 iterations"),
        ({"objective_initial": None, "design": None}, "objective = 1, 12 iterations"),
        ({"objective_initial": 0.0, "design": {}}, "objective = 0 -> 1, 12 iterations"),
        ({"design": {f"v{k}": 1.0 for k in range(8)}}, "v4 = 1, v5 = 1 and 2 more, 12 iterations"),
        ({"objective": "energy"}, "converged, E = 1.25, h0 = -0.5, 12 iterations"),
        ({"objective": "energy", "design": None}, "J = 6.000000 -> 7.000000 (gain -1, -16.7 %), 12"),
    ],
)
def test_the_line_about_a_design_has_its_objective_and_its_variables(changes, said):
    assert said in progress.summary(DESIGNED | changes)


def test_a_study_has_lines_for_failures_and_for_every_so_many(capsys):
    row: dict[str, Any] = {"example": "6.1", "variant": "a", "status": "converged", "success": True}
    bad = {**row, "success": False, "status": "died", "message": "[gone]", "wall_time_s": 1.0}
    with SolvesProgress(EVERY + 3, 1, each=False) as shown:
        for one in (bad, {**bad, "status": "refused"}, {"key": "k", "found": True}, *[row] * (EVERY - 1)):
            shown.finish(one)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"1 of {EVERY + 3} solves have a row already"
    assert lines[1:] == [
        "6.1 a: died, 1.00 s: [gone]", f"{EVERY} of {EVERY + 3} solves", f"{EVERY + 3} of {EVERY + 3} solves"
    ]  # fmt: skip
    with SolvesProgress(1, quiet=True) as shown:
        shown.finish(bad)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("options", "limited"), [({}, False), ({"starts": 2}, False), ({"seed": 1}, True)])
def test_a_solve_that_goes_on_has_a_line_every_so_many_seconds(options, limited, capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    limit = {"time_limit_s": 60.0} if options else {}
    solve = PlannedSolve({}, "6.1", "6.1", "8", "", "joint", options | limit)
    with SolvesProgress(1) as shown:
        shown.start(solve)
        for seconds in (9.0, 10.5, 19.0, 21.0):
            now[0] = 100.0 + seconds
            shown.step(Step(int(seconds), -1.0, 0.0, 0.0, 0.0, 0, seconds))
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert [line.partition(",")[0] for line in lines] == [f"6.1 joint: iteration {k}" for k in (10, 21)]
    assert [line.endswith("at most 39 s left") for line in lines] == [False, limited]
