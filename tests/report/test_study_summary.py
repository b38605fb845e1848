"""Profiles against ones computed by hand, and what a study counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Results
from rmesh_nlp.report.study_summary import (
    charts,
    data_profiles,
    performance_profiles,
    quality_profiles,
    summary_rows,
)
from support.reporting import failed, fixed_61, joint_61

INF = float("inf")


def test_performance_profile_computed_by_hand() -> None:
    # ratios of a: 1, 2, 1, inf, fails; of b: 2, 1, 3, 1, fails
    profiles = performance_profiles({"a": [10, 40, 5, INF, INF], "b": [20, 20, 15, 7, INF]})
    assert profiles["a"]([0.99, 1, 1.9, 2, 100]).tolist() == [0, 0.4, 0.4, 0.6, 0.6]
    assert profiles["b"]([1, 2, 2.9, 3, 100]).tolist() == [0.4, 0.6, 0.6, 0.8, 0.8]


def test_cost_of_zero_is_the_cheapest_and_no_division() -> None:
    profiles = performance_profiles({"a": [0.0, 0.0], "b": [0.0, 3.0]})
    assert profiles["a"](1) == 1.0
    assert profiles["b"]([1, 1e9]).tolist() == [0.5, 0.5]


def test_formulation_that_always_fails_never_rises() -> None:
    profile = performance_profiles({"a": [INF, INF], "b": [1.0, 2.0]})["a"]
    assert profile([1, 1e300]).tolist() == [0, 0]
    assert profile.at.shape == profile.share.shape


def test_data_profile_computed_by_hand() -> None:
    profile = data_profiles({"a": [1, 10, 100, INF]})["a"]
    assert profile([0, 1, 9, 10, 99, 100, 1e9]).tolist() == [0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75]


def test_quality_profile_computed_by_hand() -> None:
    # best gains 10 and 4; b misses 10 % of the first and fails the second; c gains nothing
    profiles = quality_profiles({"a": [-10.0, -4.0], "b": [-9.0, INF], "c": [0.0, 0.0]}, [0.0, 0.0])
    assert profiles["a"](0) == 1.0
    assert profiles["b"]([0.09, 0.1, 1]).tolist() == [0, 0.5, 0.5]
    assert profiles["c"]([0.99, 1.0]).tolist() == [0, 1]


@pytest.mark.parametrize("costs", [{"a": [1.0], "b": [1.0, 2.0]}, {"a": [-1.0]}, {"a": [np.nan]}])
def test_what_is_no_table_of_costs_is_refused(costs: dict[str, list[float]]) -> None:
    with pytest.raises(ValueError, match=r"every formulation|negative|inhomogeneous"):
        performance_profiles(costs)


def drawn(rows: list[Record]) -> dict[str, dict]:
    return {chart.name: chart.profiles for chart in charts([Results(Path()).result(row) for row in rows])}


def test_failure_is_a_failure_in_table_and_profiles() -> None:
    rows = [fixed_61(), joint_61(variant="a"), failed(fixed_61(), variant="a", example="other")]
    rows += [joint_61(variant="b"), joint_61(variant="b", example="other")]
    _, table = summary_rows(rows)
    assert [row[1:4] for row in table if row[1] == "a"] == [["a", "1", "1"], ["a", "1", "0"]]
    for name, profiles in drawn(rows).items():
        assert (profiles["a"](1e9), profiles["b"](1e9)) == (0.5, 1.0), name


def test_success_that_stopped_early_does_not_count_as_converged() -> None:
    rows = [joint_61(variant="a"), joint_61(variant="a"), joint_61(variant="a", status="iteration_limit")]
    head, (row,) = summary_rows([*rows, failed(joint_61(), variant="a", formulation="joint")])
    counts = {name: row[head.index(name)] for name in ("solves", "success", "converged")}
    assert counts == {"solves": "4", "success": "3", "converged": "2"}


def test_assessment_is_no_cost_in_tables_and_profiles() -> None:
    # a's assessment takes long, but it builds and solves in half of b's time
    names = ("build_time_s", "solve_time_s", "audit_time_s", "wall_time_s")
    quick, slow = (dict(zip(names, times, strict=True)) for times in ((1, 2, 50, 53), (2, 4, 0, 6)))
    rows = [joint_61(variant="a", **quick), joint_61(variant="b", **slow)]
    head, table = summary_rows(rows)
    assert [row[head.index("build + solve [s]")] for row in table] == ["3", "6"]
    profiles = drawn(rows)["build_and_solve"]
    assert (profiles["a"](1.0), profiles["b"](1.9), profiles["b"](2.0)) == (1.0, 0.0, 1.0)


def test_gains_are_of_the_given_energy_and_of_the_best_gain() -> None:
    ends = {"a": (-1.5, -1.7), "b": (-2.0, -2.0)}
    rows = [
        joint_61(variant=name, example=example, energy_initial_audited=-1.0, energy_audited=end)
        for name, pair in ends.items()
        for example, end in zip(("x", "y"), pair, strict=True)
    ]
    head, table = summary_rows([{**row, "family": "f"} for row in rows])
    gain, part = head.index("gain [%]"), head.index("of best [%]")
    assert [row[gain] for row in table] == ["60 [50, 70]", "100"]
    assert [row[part] for row in table] == ["60 [50, 70]", "100"]
    profiles = drawn(rows)
    assert profiles["quality"]["a"]([0.29, 0.3, 0.5]).tolist() == [0, 0.5, 1.0]
    assert profiles["data-90"]["a"](1e9) == 0.0
