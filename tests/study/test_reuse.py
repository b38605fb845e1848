"""Which rows of an earlier run are used again, and what a run leaves of it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import RECORDS, Results, read_results
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.study import comparison as campaign
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.comparison import Ended, Outcome, plan_comparison, run, solve
from rmesh_nlp.study.repeats import TIMES, joined
from support.planted import plant, raising


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    """Two solves that take some milliseconds each."""
    return plan_comparison(["6.2"], ["fixed"], n=(4, 2)) + plan_comparison(["6.2"], ["fixed"], n=(2, 2))


@pytest.fixture(scope="module")
def first_run(cases: list[Case], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which both are solved, to be copied."""
    folder = tmp_path_factory.mktemp("first-run")
    list(run(cases, Results(folder)))
    return folder


@pytest.fixture
def ran(first_run: Path, tmp_path: Path) -> Path:
    """A folder of the test's own in which both are solved."""
    shutil.copytree(first_run, tmp_path, dirs_exist_ok=True)
    return tmp_path


def resumed(cases: Sequence[Case], folder: Path) -> list[str]:
    """Keys of those that are solved again."""
    keys: list[str] = []
    rows = list(run(cases, Results(folder), resume=True, on_start=lambda case: keys.append(case.key)))
    assert sorted(row["key"] for row in rows) == sorted(case.key for case in cases)
    return keys


def changed(folder: Path, key: str, **entries: Any) -> None:
    """Change the row of a key in the file."""
    results = Results(folder)
    results.replace_all([{**row, **entries} if row["key"] == key else row for row in results.read()])


def test_successes_are_not_solved_again_whatever_their_place(cases: list[Case], ran: Path) -> None:
    assert resumed(cases, ran) == []
    assert resumed(cases[::-1], ran) == []
    assert len(Results(ran).read()) == 2


@pytest.mark.parametrize(
    "entries", [{"success": False, "status": "stalled"}, {"status": "interrupted"}, {"success": False}]
)
def test_a_failure_or_an_interrupted_solve_is_solved_again_and_its_row_replaced(
    cases: list[Case], ran: Path, entries: dict[str, Any]
) -> None:
    changed(ran, cases[0].key, **entries)
    assert resumed(cases, ran) == [cases[0].key]
    rows = Results(ran).read()
    assert sorted(row["key"] for row in rows) == sorted(case.key for case in cases)
    assert all(row["success"] and row["status"] == "converged" for row in rows)


def test_rows_of_versions_that_counted_no_nodes_are_reused(cases: list[Case], ran: Path) -> None:
    results = Results(ran)
    results.replace_all([{k: v for k, v in row.items() if k != "nodes"} for row in results.read()])
    assert resumed(cases, ran) == []


def test_more_repeats_or_a_certificate_are_a_reason_to_solve_again(cases: list[Case], tmp_path: Path) -> None:
    list(run(cases[:1], Results(tmp_path)))
    assert resumed([replace(cases[0], repeats=2)], tmp_path) == [cases[0].key]
    (row,) = Results(tmp_path).read()
    assert row["repeats"] == 2
    for name in TIMES:
        low, high = row[name.replace("_time_s", "_time_range_s")]
        assert low <= row[name] <= high
    assert resumed([replace(cases[0], repeats=2)], tmp_path) == []
    assert resumed(cases[:1], tmp_path) == []  # fewer would do
    assert resumed([replace(cases[0], certify=True)], tmp_path) == [cases[0].key]
    assert resumed([replace(cases[0], certify=True)], tmp_path) == []


@pytest.mark.parametrize("name", ["example", "n", "quadrature", "delta", "formulation"])
def test_rows_of_another_problem_under_the_same_key_are_refused(
    cases: list[Case], tmp_path: Path, name: str
) -> None:
    list(run(cases[:1], Results(tmp_path)))
    other = {"example": "6.3", "n": "9x9", "quadrature": 7, "delta": [0.1, 0.1], "formulation": "nested"}
    changed(tmp_path, cases[0].key, **{name: other[name]})
    with pytest.raises(
        BadInputError, match=rf"cannot resume .* with {name} .*{re.escape(str(other[name]))}, not "
    ):
        resumed(cases[:1], tmp_path)
    changed(tmp_path, cases[0].key, success=False)  # a failure is not resumed, whatever it was
    assert resumed(cases[:1], tmp_path) == [cases[0].key]


def test_without_resume_the_earlier_run_stays_until_a_solve_has_ended(cases: list[Case], ran: Path) -> None:
    rows = run(cases[:1], Results(ran), on_start=lambda _: seen.append(len(read_results(ran))))
    seen: list[int] = []
    next(rows)
    assert seen == [2]
    assert len(read_results(ran)) == 1
    assert len(read_results(ran / "previous")) == 2
    assert list(rows) == []
    assert not (ran / "previous-2").exists()
    list(run(cases, Results(ran)))  # set aside once, not once for each case
    assert len(read_results(ran)) == 2
    assert len(read_results(ran / "previous-2")) == 1
    assert not (ran / "previous-3").exists()


def test_an_interrupted_solve_leaves_its_row_and_is_the_last(
    cases: list[Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(case: Case, on_step: Any = None) -> Outcome:
        outcome = solve(case)
        return replace(outcome, record={**outcome.record, "status": "interrupted"})

    monkeypatch.setattr(campaign, "solve", stopped)
    rows = run(cases, Results(tmp_path))
    assert next(rows)["status"] == "interrupted"
    with pytest.raises(KeyboardInterrupt):
        next(rows)
    assert len(Results(tmp_path).read()) == 1
    monkeypatch.undo()
    assert resumed(cases, tmp_path) == [case.key for case in cases]


def test_another_solver_gets_what_is_not_done(cases: list[Case], tmp_path: Path) -> None:
    list(run(cases[:1], Results(tmp_path)))
    got: list[Case] = []

    def solver(todo: Sequence[Case]) -> Iterator[Ended]:
        got.extend(todo)
        for case in todo:
            outcome = solve(case)
            yield Ended(case, outcome.record, lambda places, o=outcome: campaign.save(o, places))

    rows = list(run(cases, Results(tmp_path), resume=True, solver=solver))
    assert got == [cases[1]]
    assert [row["key"] for row in rows] == [case.key for case in cases]


class TestSolve:
    """One case, as often as it asks for."""

    @pytest.fixture
    def calls(self, monkeypatch: pytest.MonkeyPatch) -> list[Case]:
        calls: list[Case] = []
        self.statuses: list[str] = []

        def once(case: Case, on_step: Any) -> Outcome:
            calls.append(case)
            status = self.statuses.pop(0) if self.statuses else "converged"
            record = {"status": status, "build_time_s": 1.0 * len(calls), "solve_time_s": 1.0}
            return Outcome(record, None if status == "failed" else object())  # type: ignore[arg-type]

        monkeypatch.setattr(campaign, "_solve", once)
        return calls

    def case(self, cases: list[Case], **changes: Any) -> Case:
        return replace(cases[0], certify=True, trace=True, **changes)

    def test_repeats_are_bare_and_joined(self, calls: list[Case], cases: list[Case]) -> None:
        outcome = solve(self.case(cases, repeats=3))
        assert [(case.certify, case.trace) for case in calls] == [
            (True, True),
            (False, False),
            (False, False),
        ]
        assert outcome.record["build_time_s"] == 2.0
        assert outcome.record["repeats"] == 3

    def test_one_is_as_it_is(self, calls: list[Case], cases: list[Case]) -> None:
        assert "repeats" not in solve(self.case(cases)).record
        assert len(calls) == 1

    @pytest.mark.parametrize("status", ["failed", "interrupted"])
    def test_a_failure_or_an_interrupted_solve_is_not_repeated(
        self, calls: list[Case], cases: list[Case], status: str
    ) -> None:
        self.statuses = [status]
        outcome = solve(self.case(cases, repeats=3))
        assert (len(calls), outcome.record["status"]) == (1, status)

    def test_an_interrupted_repetition_is_the_row(self, calls: list[Case], cases: list[Case]) -> None:
        self.statuses = ["converged", "interrupted"]
        outcome = solve(self.case(cases, repeats=3))
        assert (len(calls), outcome.record["status"]) == (2, "interrupted")


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (ValueError("not\n this"), "refused", "not this"),
        (ValueError(), "refused", "ValueError"),
        (ZeroDivisionError("by zero"), "failed", "ZeroDivisionError: by zero"),
    ],
)
def test_an_exception_is_a_row(
    cases: list[Case], error: Exception, status: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, fixed=raising(error))
    case = replace(cases[0], options={"seed": 3, "objective": "error-l2"}, repeats=2)
    outcome = solve(case)
    row = outcome.record
    assert outcome.solution is None
    assert (row["status"], row["success"], row["message"]) == (status, False, message)
    assert (row["seed"], row["objective"], row["stationarity"], row["energy"]) == (3, "error-l2", "", None)
    assert 0 <= row["wall_time_s"] < 60
    assert row["versions"]["python"]
    assert {name: row[name] for name in case.identity} == case.identity


def test_a_solve_that_raised_leaves_no_files_of_an_earlier_one(cases: list[Case], tmp_path: Path) -> None:
    (row,) = run(cases[:1], Results(tmp_path))
    places = Results(tmp_path).result(row)
    assert places.vtu.exists()
    assert places.history.exists()
    campaign.save(Outcome(row, None), places)
    assert not places.vtu.exists()
    assert not places.history.exists()
    campaign.save(Outcome(row, None), places)  # nothing to remove is no error


def test_theorem_41_is_not_asked_of_a_broken_mesh(cases: list[Case], monkeypatch: pytest.MonkeyPatch) -> None:
    good = solve(cases[0]).solution
    assert good is not None
    broken = replace(good, audit=replace(good.audit, min_area_ratio=0.0), status=Status.INVALID_MESH)
    monkeypatch.setattr(campaign, "solve_by_options", lambda *_, **__: broken)
    monkeypatch.setattr(campaign, "error_terms", lambda _: pytest.fail("it was asked"))
    assert solve(cases[0]).record["status"] == "invalid_mesh"


def test_records_are_claimed_before_they_are_written(cases: list[Case], tmp_path: Path) -> None:
    list(run(cases[:1], Results(tmp_path)))
    names = Results(tmp_path).manifest.names()
    stem = f"solutions/{cases[0].key}"
    assert {RECORDS, f"{stem}.vtu", f"{stem}.csv"} <= set(names)


def test_times_are_medians_with_their_range() -> None:
    one = {"energy": -1.0, "build_time_s": 3.0, "solve_time_s": 1.0, "wall_time_s": 4.0}
    others = [{**one, "build_time_s": 1.0, "energy": -9.0}, {**one, "build_time_s": 2.0}]
    row = joined([one, *others])
    assert (row["build_time_s"], row["build_time_range_s"]) == (2.0, [1.0, 3.0])
    assert row["energy"] == -1.0
    assert row["repeats"] == 3
    assert row["first_cost_s"] == 4.0
    assert joined([one]) is one
