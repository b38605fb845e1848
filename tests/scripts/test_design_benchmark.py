"""The benchmark of random design problems: one problem through, and literal rows through its counts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import benchmark_designs as script


@pytest.mark.slow
def test_one_problem_by_both_from_both_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rows.jsonl"
    for _ in range(2):  # the second time nothing is left to solve
        script.main(["--seeds", "3", "4", "--out", str(out)])
        rows = [json.loads(line) for line in out.read_text().splitlines()]
        assert len(rows) == 4
    assert {(row["formulation"], row["start"]) for row in rows} == {
        (name, start) for name in ("nested", "mpcc") for start in ("given", "seed")
    }
    assert all(row["success"] and row["b_stationary"] for row in rows)
    assert "nested: 2 solves, 2 valid, 2 successes, best of all reached on 1 of 1 problems" in (
        capsys.readouterr().out
    )


def test_the_better_of_two_starts_counts_and_invalid_ends_do_not() -> None:
    ends = [("nested", 2.0, True), ("nested", 1.0, True), ("mpcc", 1.5, True), ("mpcc", 0.5, False)]
    rows = [
        {"seed": 0, "formulation": name, "value": value, "valid": valid, "first": 3.0}
        for name, value, valid in ends
    ]
    assert script.best_reached(rows) == {(0, "nested"): True, (0, "mpcc"): False}


def test_orders_of_gradients(capsys: pytest.CaptureFixture[str]) -> None:
    script.main(["--gradients", "--seeds", "2", "4"])
    assert "within 0.02 on 2" in capsys.readouterr().out
