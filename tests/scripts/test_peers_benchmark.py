"""The benchmark of formulations on small meshes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import benchmark_peers as benchmark
from peer_solvers import nlpsol_mapped, nlpsol_written_out
from rmesh_nlp.examples import EXAMPLES


def rows(solver: str, *seconds: float | None) -> list:
    return [benchmark.Row("p", solver, "converged", -1.5, 0.25, 7, one) for one in seconds]


def test_times_are_medians_and_ratios_are_taken_run_by_run() -> None:
    text = benchmark.table([*rows("one", 1.0, 2.0, 4.0), *rows("two", 3.0, 4.0, 4.0)])
    assert "| p | one | converged | -1.5 | 0.25 | 7 | 2 (1 to 4) | 1 |" in text
    assert "| p | two | converged | -1.5 | 0.25 | 7 | 4 (3 to 4) | 2 |" in text


def test_a_run_without_a_result_is_a_row() -> None:
    failed = benchmark.Row("p", "one", "crashed: SIGKILL")
    assert "| p | one | crashed: SIGKILL | - | - | - | - | - |" in benchmark.table([failed])


@pytest.mark.slow
def test_one_program_built_three_times_has_one_energy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    solvers = {
        "joint": benchmark.FORMULATIONS["joint"],
        "mapped": nlpsol_mapped,
        "written out": nlpsol_written_out,
    }
    tasks = (benchmark.Task("6.1, n = 8", lambda: EXAMPLES["6.1"](8), solvers),)
    monkeypatch.setattr(benchmark, "GROUPS", {"one": tasks})
    arguments = ["--groups", "one", "--repeat", "1", "--out", str(tmp_path)]
    assert benchmark.main(arguments) == 0
    found = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert [row["status"] for row in found] == ["converged"] * 3
    assert [row["value"] for row in found] == pytest.approx([found[0]["value"]] * 3, rel=1e-6)
    assert (tmp_path / "formulations.md").read_text().count("| 6.1, n = 8 |") == 3


@pytest.mark.slow
def test_every_formulation_minimises_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (task, *_) = benchmark.GROUPS["objective"]
    small = benchmark.Task("6.1, n = 4", lambda: EXAMPLES["6.1"](4), task.solvers, task.objective)
    found = list(benchmark.runs(small, 1, 60.0))
    assert [row.solver for row in found] == ["nested", "mpcc"]
    assert [row.value for row in found] == pytest.approx([found[0].value] * 2, rel=0.05)
