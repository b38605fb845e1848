"""The benchmark of kinks: 68 problems, both formulations side by side with a search of their ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import benchmark_branches as script


@pytest.mark.slow
def test_ends_at_kinks_are_searched_branch_by_branch(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    every = [case.name for case in script.cases()]
    assert len(every) == len(set(every)) == 68
    rows = tmp_path / "rows.jsonl"
    assert script.main(["--only", "seal-4-2", "--out", str(rows)]) == 0
    said = capsys.readouterr().out
    found = [json.loads(line) for line in rows.read_text().splitlines()]
    assert [row["formulation"] for row in found] == ["nested", "mpcc"]
    for row in found:
        assert (row["status"], row["b_stationary"], row["searched"]) == ("converged", True, 8)
        assert row["steepest"] >= -1e-6
    assert found[0]["objective_value"] == pytest.approx(found[1]["objective_value"], rel=1e-8)
    assert script.main(["--read", str(rows)]) == 0
    assert capsys.readouterr().out == said
    assert said.count("S, 3") == 2


def test_what_raises_is_a_row() -> None:
    case = next(iter(script.cases()))
    row = script.row(script.Case(case.name, case.problem, "mean(nowhere, uy)"), "mpcc", 10.0)
    assert row["status"] != "converged"
    assert "nowhere" in row["message"]
    assert "nowhere" not in script.table([row])
