"""The benchmark of one's own part, on a small one."""

import json
from pathlib import Path
from typing import Any

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def benchmark_own(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    pytest.importorskip("gmsh")
    import benchmark_own

    return benchmark_own


def test_a_part_has_about_as_many_nodes_as_are_asked_for(benchmark_own: Any, tmp_path: Path) -> None:
    path = benchmark_own.part(tmp_path, 200, "none")
    assert 120 <= benchmark_own._nodes(tmp_path / "two_holes.msh") <= 300
    assert "delta" not in path.read_text()
    assert "delta = { relative = 0.3 }" in benchmark_own.part(tmp_path, 200, "boxes").read_text()


@pytest.mark.slow
def test_rows_are_solved_once_and_kept_with_how_they_ended(
    benchmark_own: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = benchmark_own.main(tmp_path, [100], ["boxes"], longest=30.0)
    (row,) = rows
    assert row["success"]
    assert row["gain_audited"] > 0
    assert row["cpu"] > 0
    assert json.loads((tmp_path / "own.json").read_text()) == rows
    assert "| 0.3 of an edge | joint | converged |" in (tmp_path / "own.md").read_text()
    monkeypatch.setattr(benchmark_own, "solve", lambda *_: pytest.fail("solved again"))
    assert benchmark_own.main(tmp_path, [100], ["boxes"]) == rows


def test_a_solve_that_leaves_no_record_is_a_row(
    benchmark_own: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark_own, "RMESH", "raise SystemExit(3)")
    row = benchmark_own.solve(tmp_path, 100, "boxes", 5.0)
    assert row["status"] == "exit code 3"
    assert row["gain_audited"] is None
    assert "| - |" in benchmark_own.table([{**row, "nodes": 100}])
