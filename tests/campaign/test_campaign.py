"""A campaign leaves a row for each solve, whatever happens to it, and resumes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.planted import plant, raising

from formulations.fixed import Fixed
from formulations.joint import Joint
from rmesh_nlp.campaign import run as campaign
from rmesh_nlp.campaign.cases import Case, make_cases
from rmesh_nlp.campaign.run import run, solve
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import REQUIRED, Results, read_results, to_json
from rmesh_nlp.io.vtu import fields_of, read_vtu
from rmesh_nlp.solving.options import accepted

EXPLODE = raising(RuntimeError("the\nfactor was singular"))


def test_a_solve_that_raises_is_a_row_and_the_next_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, explode=EXPLODE)
    cases = make_cases(["6.1"], ["explode", "fixed"], n=3)
    bad, good = run(cases, Results(tmp_path))
    assert (bad["status"], bad["success"]) == ("failed", False)
    assert bad["message"] == "RuntimeError: the factor was singular"
    assert set(REQUIRED) <= set(bad)
    assert bad["delta"] == good["delta"]
    assert good["success"]
    assert [result.record for result in read_results(tmp_path)] == [bad, json.loads(to_json(good))]


@pytest.mark.slow
def test_records_are_on_the_disk_when_they_are_yielded(tmp_path: Path) -> None:
    rows = run(make_cases(["6.1"], ["fixed", "joint"], n=3), Results(tmp_path))
    for count, _ in enumerate(rows, 1):
        found = read_results(tmp_path)
        assert len(found) == count
        assert all(result.vtu.exists() and result.history.exists() for result in found)


def test_resume_solves_only_what_is_missing_or_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, flaky=EXPLODE)
    cases = make_cases(["6.1"], ["fixed", "flaky"], n=3)
    list(run(cases, Results(tmp_path)))
    plant(monkeypatch, flaky=Fixed)
    started: list[str] = []
    rows = list(
        run(cases, Results(tmp_path), resume=True, on_start=lambda case: started.append(case.formulation))
    )
    assert started == ["flaky"]
    assert [row["success"] for row in rows] == [True, True]
    assert [result.record["success"] for result in read_results(tmp_path)] == [True, True]


def test_resume_refuses_rows_of_other_settings(tmp_path: Path) -> None:
    list(run(make_cases(["6.1"], ["fixed"], n=3), Results(tmp_path)))
    other = make_cases(["6.1"], ["fixed"], n=3, delta=0.01)
    with pytest.raises(BadInputError, match=r"delta \[0\.07.*, 0\.07.*\], not \[0\.01, 0\.01\]"):
        list(run(other, Results(tmp_path), resume=True))


@pytest.mark.slow
def test_a_fresh_run_sets_the_old_one_aside_when_its_first_solve_has_ended(tmp_path: Path) -> None:
    list(run(make_cases(["6.1"], ["fixed", "joint"], n=3), Results(tmp_path)))
    old = (tmp_path / "records.jsonl").read_text()
    rows = run(
        make_cases(["6.1"], ["fixed"], n=4),
        Results(tmp_path),
        on_start=lambda case: (tmp_path / "seen").write_text((tmp_path / "records.jsonl").read_text()),
    )
    assert next(rows)["n"] == "4"
    assert (tmp_path / "seen").read_text() == old
    assert (tmp_path / "previous" / "records.jsonl").read_text() == old
    assert [result.record["n"] for result in read_results(tmp_path)] == ["4"]


def test_cases_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"6\.1-3-fixed"):
        list(run(make_cases(["6.1", "6.1"], ["fixed"], n=3), Results(tmp_path)))


def test_a_line_cut_off_by_a_power_cut_is_passed_over(tmp_path: Path) -> None:
    list(run(make_cases(["6.1"], ["fixed"], n=3), Results(tmp_path)))
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"example": "6.1", "formu')
    assert len(read_results(tmp_path)) == 1


def test_keys_tell_solves_apart_and_suit_file_names() -> None:
    (case,) = make_cases(["6.1"], ["mpcc"], options={"seed": 3, "objective": "error-l2 + 0.01*quality"})
    assert case.key == "6.1-8-mpcc-error-l2_+_0.01_quality-seed3"


def test_options_that_no_formulation_takes_are_refused() -> None:
    with pytest.raises(BadInputError, match="--relaxation scholtes: not an option of fixed, joint"):
        make_cases(["6.1"], ["fixed", "joint"], n=3, options={"relaxation": "scholtes"})


def test_which_options_a_formulation_takes() -> None:
    options = ("seed", "objective", "flips", "first_barrier", "speed")
    assert accepted("fixed", options) == {"objective"}
    assert accepted("joint", options) == {"seed", "objective", "flips", "first_barrier"}
    assert accepted(Joint(), options) == {"seed", "objective"}  # its settings are chosen


def test_json_is_strict() -> None:
    row = {"a": float("nan"), "b": [1.0, float("inf")], "c": {"d": float("nan")}}
    assert json.loads(to_json(row)) == {"a": None, "b": [1.0, None], "c": {"d": None}}


def test_fields_survive_the_file(tmp_path: Path) -> None:
    (case,) = make_cases(["6.3"], ["fixed"], n=(4, 2))
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
    (case,) = make_cases(["6.1"], ["fixed"], n=3)
    own = Case(replace(case.problem, name="own", size=""), "fixed")
    (row,) = run([own], Results(tmp_path))
    assert row["success"]
    assert row["key"] == "own-fixed"


def test_a_row_solved_with_another_rule_is_not_resumed(tmp_path: Path) -> None:
    def cases(rule: int) -> list[Case]:
        return make_cases(["6.1"], ["fixed"], n=3, quadrature=rule)

    list(run(cases(2), Results(tmp_path)))
    with pytest.raises(BadInputError, match="quadrature 2, not 6"):
        list(run(cases(6), Results(tmp_path), resume=True))


def test_what_auto_chose_is_resumed_as_it_was_asked_for(tmp_path: Path) -> None:
    (case,) = make_cases(["6.2"], ["auto"], n=(4, 2))
    (row,) = run([case], Results(tmp_path))
    assert (row["formulation"], row["asked"]) == ("joint", {"formulation": "auto"})
    list(run([case], Results(tmp_path), resume=True, on_start=lambda _: pytest.fail("solved again")))
