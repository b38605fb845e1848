"""A campaign leaves a row for each solve, whatever happens to it, and resumes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from formulations.joint import Joint
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.records import REQUIRED, to_json
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.io.vtu import fields_of, read_vtu
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.study import comparison as campaign
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.comparison import plan_comparison, run, solve
from support.planted import plant, raising


def test_a_solve_that_raises_is_a_row_and_the_next_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, explode=raising(RuntimeError("the\nfactor was singular")))
    cases = plan_comparison(["6.1"], ["explode", "fixed"], n=3)
    bad, good = run(cases, Results(tmp_path))
    assert (bad["status"], bad["success"]) == ("failed", False)
    assert bad["message"] == "RuntimeError: the factor was singular"
    assert set(REQUIRED) <= set(bad)
    assert bad["delta"] == good["delta"]
    assert good["success"]
    assert [result.record for result in read_results(tmp_path)] == [bad, json.loads(to_json(good))]


@pytest.mark.slow
def test_records_are_on_the_disk_when_they_are_yielded(tmp_path: Path) -> None:
    rows = run(plan_comparison(["6.1"], ["fixed", "joint"], n=3), Results(tmp_path))
    for count, _ in enumerate(rows, 1):
        found = read_results(tmp_path)
        assert len(found) == count
        assert all(result.vtu.exists() and result.history.exists() for result in found)


def test_cases_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"6\.1-3-fixed"):
        list(run(plan_comparison(["6.1", "6.1"], ["fixed"], n=3), Results(tmp_path)))


def test_which_options_a_formulation_takes() -> None:
    options = ("seed", "objective", "flips", "first_barrier", "speed")
    assert accepted("fixed", options) == {"objective"}
    assert accepted("joint", options) == {"seed", "objective", "flips", "first_barrier"}
    assert accepted(Joint(), options) == {"seed", "objective"}  # its settings are chosen


def test_fields_survive_the_file(tmp_path: Path) -> None:
    (case,) = plan_comparison(["6.3"], ["fixed"], n=(4, 2))
    outcome = solve(case)
    assert outcome.solution is not None
    places = Results(tmp_path).result(outcome.record)
    campaign.save(outcome, places)
    written, read = fields_of(outcome.solution), read_vtu(places.vtu)
    for name in ("nodes", "initial", "triangles", "displacement", "pressure", "friction_bound", "contact"):
        assert (getattr(read, name) == getattr(written, name)).all(), name
    assert read.friction_bound[read.contact].min() == 10
    assert (read.foundation[1, read.contact] == 0).all()
    assert len(places.steps()) == 1


def test_a_problem_of_one_s_own(tmp_path: Path) -> None:
    (case,) = plan_comparison(["6.1"], ["fixed"], n=3)
    own = Case(replace(case.problem, name="own", size=""), "fixed")
    (row,) = run([own], Results(tmp_path))
    assert row["success"]
    assert row["key"] == "own-fixed"


def test_what_auto_chose_is_resumed_as_it_was_asked_for(tmp_path: Path) -> None:
    (case,) = plan_comparison(["6.2"], ["auto"], n=(4, 2))
    (row,) = run([case], Results(tmp_path))
    assert (row["formulation"], row["asked"]) == ("joint", {"formulation": "auto"})
    list(run([case], Results(tmp_path), resume=True, on_start=lambda _: pytest.fail("solved again")))


@pytest.mark.parametrize(
    "formulation", ["nested", *(pytest.param(name, marks=pytest.mark.slow) for name in ("joint", "mpcc"))]
)
def test_a_traced_solve_has_the_referees_residual_in_its_history(formulation: str, tmp_path: Path) -> None:
    (case,) = plan_comparison(["6.3"], [formulation], n=(4, 2), trace=True)
    outcome = solve(case)
    assert outcome.solution is not None
    residuals = np.array([step.stationarity for step in outcome.history])
    known = residuals[np.isfinite(residuals)]
    # the first steps are at the mesh as given, whose residual is one; the last one is the end
    assert known[0] == pytest.approx(1, rel=0.05)
    assert known[-1] <= 1e-5
    solution = outcome.solution
    outer = Outer(solution.problem)
    q = outer.relocation.mesh_map.q_of(np.asarray(solution.mesh.p))
    assert known[-1] == pytest.approx(outer.residual(outer.energy(q)), abs=1e-5)
    list(run([case], Results(tmp_path)))
    (result,) = read_results(tmp_path)
    assert [step["stationarity"] for step in result.steps()] == pytest.approx(
        residuals, nan_ok=True, abs=1e-7
    )
