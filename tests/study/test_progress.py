"""Progress of a solve: gain, residual, limits; and lines about many solves."""

import math
from typing import Any

import pytest

from rmesh_nlp.optimize.budget import Limits
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.study import progress
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.progress import SolvesProgress, pace


def test_a_step_has_gain_or_another_objective_residual_and_limits():
    step = Step(9, -1.9, float("nan"), 0.0, 0.5**9, 0, 180.0, energy_given=-1.0)
    said = "iteration 9 of 50 at most, J = -1.9, gain 0.9, residual 2.0e-03, 3 min of 10 min at most"
    assert pace(step, Limits(600.0, 50)) == said
    step = Step(2, 7.0, 0.0, 0.0, float("nan"), 0, 1.0, objective=0.01, objective_given=0.02)
    said = "iteration 2, objective 0.02 -> 0.01, residual 0.0e+00, 1 s of 10 min at most"
    assert pace(step, Limits(), of_energy=False) == said


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


def test_a_study_has_lines_for_failures_and_every_so_many_seconds(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    row: dict[str, Any] = {"example": "6.1", "variant": "a", "status": "converged", "success": True}
    bad = {**row, "success": False, "status": "died", "message": "[gone]", "wall_time_s": 1.0}
    with SolvesProgress(8, 1, each=False) as shown:
        for one in (bad, {**bad, "status": "refused"}, {"key": "k", "found": True}, *[row] * 4):
            now[0] += 3.0
            shown.finish(one)
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert lines == [
        "1 of 8 solves have a row already",
        "6.1 a: died, 1.00 s: [gone]",
        "5 of 8 solves",
        "8 of 8 solves",
    ]
    with SolvesProgress(1, quiet=True) as shown:
        shown.finish(bad)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("options", "limited"), [({}, False), ({"seed": 1}, True)])
def test_a_solve_that_goes_on_has_a_line_every_so_many_seconds(options, limited, capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    limit = {"limits": {"seconds": 60.0 if limited else math.inf}}
    solve = PlannedSolve({}, "6.1", "6.1", "8", "", "joint", options | limit)
    with SolvesProgress(1) as shown:
        shown.start(solve)
        for seconds in (9.0, 10.5, 19.0, 21.0):
            now[0] = 100.0 + seconds
            shown.step(Step(int(seconds), -1.0, 0.0, 0.0, 0.0, 0, seconds))
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert [line.partition(",")[0] for line in lines] == [f"6.1 joint: iteration {k}" for k in (10, 21)]
    assert [line.endswith("21 s of 60 s at most") for line in lines] == [False, limited]
