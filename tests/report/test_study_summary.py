"""Profiles against ones computed by hand, what a study counts, and costs to a level that all reach."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import HISTORY, Result, Results, write_history
from rmesh_nlp.report.blocks import in_common_units
from rmesh_nlp.report.histories import cost_to, curve, with_common_costs
from rmesh_nlp.report.study_summary import (
    charts,
    data_profiles,
    performance_profiles,
    quality_profiles,
    summary_table,
)
from rmesh_nlp.report.tables import markdown
from support.reporting import designed, failed, fixed_61, joint_61

INF = float("inf")
# ratios of a: 1, 2, 1, inf, fails; of b: 2, 1, 3, 1, fails
COSTS = performance_profiles(pd.DataFrame({"a": [10, 40, 5, INF, INF], "b": [20, 20, 15, 7, INF]}))
FREE = performance_profiles(pd.DataFrame({"a": [0.0, 0.0], "b": [0.0, 3.0], "c": [INF, INF]}))
DATA = data_profiles(pd.DataFrame({"a": [1, 10, 100, INF]}))
# best gains 10 and 4; b misses 10 % of the first and fails the second; c gains nothing
QUALITY = quality_profiles(pd.DataFrame({"a": [-10.0, -4.0], "b": [-9.0, INF], "c": [0.0, 0.0]}), [0.0, 0.0])
# no formulation gains on the first, all fail the second
USELESS = quality_profiles(pd.DataFrame({"a": [1.0, INF], "b": [2.0, INF]}), [0.0, 0.0])
ROUNDED = quality_profiles(pd.DataFrame({"a": [1.0 - 1e-15], "b": [1.0]}), [1.0])


@pytest.mark.parametrize(
    ("profile", "at", "shares"),
    [
        (COSTS["a"], [0.99, 1, 1.9, 2, 100], [0, 0.4, 0.4, 0.6, 0.6]),
        (COSTS["b"], [1, 2, 2.9, 3, 100], [0.4, 0.6, 0.6, 0.8, 0.8]),
        (performance_profiles(pd.DataFrame({"a": [1.0], "b": [1 + 1e-10]}))["b"], [1], [1]),  # a tie
        (FREE["b"], [1, 1e9], [0.5, 0.5]),
        (FREE["c"], [1, 1e300], [0, 0]),
        (DATA["a"], [0, 1, 9, 10, 99, 100, 1e9], [0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75]),
        (QUALITY["b"], [0.09, 0.1, 1], [0, 0.5, 0.5]),
        (QUALITY["c"], [0.99, 1], [0, 1]),
        (USELESS["a"], [0, 1e9], [0.5, 0.5]),
        (USELESS["b"], [0, 1e9], [0, 0]),
        (ROUNDED["b"], [0, 1e9], [0, 0]),
    ],
)
def test_profiles_computed_by_hand(profile: Any, at: list[float], shares: list[float]) -> None:
    assert profile(at).tolist() == shares
    assert profile.at.shape == profile.share.shape


def drawn(rows: list[Record]) -> dict[str, dict]:
    return {chart.name: chart.profiles for chart in charts([Results(Path()).result(row) for row in rows])}


def columns(rows: list[Record], *names: str) -> list[list[str]]:
    """Columns of the table of a study."""
    summary = summary_table(rows)
    head, table = summary.headings, summary.rows
    return [[row[head.index(name)] for row in table] for name in names]


@pytest.mark.slow
def test_failure_is_a_failure_in_table_and_profiles() -> None:
    rows = [fixed_61(), joint_61(variant="a"), failed(fixed_61(), variant="a", example="other")]
    rows += [joint_61(variant="b"), joint_61(variant="b", example="other")]
    rows.append(failed(joint_61(), variant="b", status="refused"))  # which is no failure
    names, solves, success = columns(rows, "formulation", "solves", "success")
    assert (names, solves) == (["fixed", "a", "b", "a", "b"], ["1"] * 5)
    assert success == ["1", "1", "1", "0", "1"]
    costs = {"iterations", "contact_solves", "build_and_solve"}
    assert set(drawn(rows)) == {*costs, "quality", "data-90", "data-99", "data-99.9"}
    for name, profiles in drawn(rows).items():
        assert (profiles["a"](1e9), profiles["b"](1e9)) == (0.5, 1.0), name
    assert not drawn(rows[:3])  # one formulation has nothing to be compared with
    good, early = joint_61(variant="a"), joint_61(variant="a", status="iteration_limit")
    bad = failed(joint_61(), variant="a", formulation="joint")
    counts = columns([good, good, early, bad], "solves", "success", "converged")
    assert counts == [["4"], ["3"], ["2"]]


def test_assessment_is_no_cost_in_tables_and_profiles() -> None:
    # a's assessment takes long, but it builds and solves in half of b's time
    names = ("build_time_s", "solve_time_s", "audit_time_s", "wall_time_s")
    quick, slow = (dict(zip(names, times, strict=True)) for times in ((1, 2, 50, 53), (2, 4, 0, 6)))
    rows = [joint_61(variant="a", **quick), joint_61(variant="b", **slow)]
    assert columns(rows, "build + solve [s]") == [["3", "6"]]
    profiles = drawn(rows)["build_and_solve"]
    assert (profiles["a"](1.0), profiles["b"](1.9), profiles["b"](2.0)) == (1.0, 0.0, 1.0)


def test_gains_are_of_the_given_value_and_of_the_best_gain() -> None:
    ends = {"a": (-1.5, -1.7), "b": (-2.0, -2.0)}
    rows = [
        joint_61(variant=name, example=example, energy_initial_audited=-1.0, energy_audited=end, family="f")
        for name, pair in ends.items()
        for example, end in zip(("x", "y"), pair, strict=True)
    ]
    assert columns(rows, "gain [%]", "of best [%]") == [["60 [50, 70]", "100"]] * 2
    profiles = drawn(rows)
    assert profiles["quality"]["a"]([0.29, 0.3, 0.5]).tolist() == [0, 0.5, 1.0]
    assert profiles["data-90"]["a"](1e9) == 0.0
    rows = [designed(family="f", variant="a"), designed(family="f", variant="b", objective_value=2.0)]
    assert columns(rows, "gain [%]", "of best [%]") == [["100", "20"], ["100", "20.01"]]


def test_orders_are_families_and_instances_of_their_own() -> None:
    rows = [
        joint_61(variant="joint", family="f", order=order, energy_initial_audited=-1.0, energy_audited=end)
        for order, end in ((1, -1.1), (2, -1.4))
    ]
    table = summary_table(rows).rows
    assert [row[0] for row in table] == ["f", "f, order 2"]
    assert [row[6] for row in table] == ["100", "100"]  # each is the best of its order


START = -1.1172085
"""Audited energy on the given mesh of the records made by hand."""

Steps = list[tuple[float, ...]]


def result(folder: Path, name: str, end: float, steps: Steps, **changes: Any) -> Result:
    """A record and its history of (seconds, audited energy, residual, primal residual)."""
    record = joint_61(formulation=name, energy=end + 0.5, energy_audited=end, energy_initial_audited=START)
    record |= {"build_time_s": 0.1, "solve_time_s": 0.4, "contact_time_s": 0.01, **changes}
    rows = []
    for i, (seconds, energy, residual, *primal) in enumerate(steps):
        known = {"iteration": i, "seconds": seconds, "energy": energy + 0.5, "stationarity": residual}
        rows.append({**dict.fromkeys(HISTORY), **known, "primal_residual": sum(primal)})
    write_history(folder / f"{name}.csv", rows)
    return Result(record, folder / "none.vtu", folder / f"{name}.csv")


GOOD = [(0.1, -1.2, 0.5), (0.2, -1.41, 1e-2, 1e-3), (0.3, -1.42, 1e-3), (0.5, -1.5, 1e-7)]


def test_common_level_is_reached_by_all_and_infeasible_iterates_do_not_count(tmp_path: Path) -> None:
    results = [
        Result(fixed_61(), tmp_path / "no", tmp_path / "no"),
        result(tmp_path, "joint", -1.5, GOOD, stationarity_residual=1e-7),
        result(tmp_path, "nested", -1.4, [(0.2, -1.2, 0.5), (0.4, -1.4, 2e-3)], stationarity_residual=2e-3),
    ]
    fixed, joint, nested = with_common_costs(results)
    assert "cost_to_objective" not in fixed
    # the worst end, less a thousandth of its gain
    for row in (joint, nested):
        assert row["common_objective"] == pytest.approx(-1.4 + 1e-3 * (START + 1.4))
        assert row["common_stationarity"] == 2e-3
    assert joint["cost_to_objective"] == joint["cost_to_stationarity"] == pytest.approx(30)
    assert nested["cost_to_objective"] == pytest.approx(40)
    assert "cost to that J" in markdown([fixed, joint, nested])
    assert "cost to that J" not in markdown([one.record for one in results])


def test_costs_are_in_the_median_unit_and_scaled_to_the_median_time(tmp_path: Path) -> None:
    steps: Steps = [(0.5, -1.4, 1e-6)]
    exact = {"stationarity_residual": 1e-9}
    joint = result(tmp_path, "joint", -1.4, steps, contact_time_s=0.01, first_cost_s=1.0, **exact)
    nested = result(tmp_path, "nested", -1.4, steps, contact_time_s=0.03, **exact)
    # the unit is 0.02 s; the first run of joint took twice its median
    records = in_common_units([joint.record, nested.record])
    common = [replace(one, record=row) for one, row in zip((joint, nested), records, strict=True)]
    rows = with_common_costs(common)
    assert [row["cost_to_objective"] for row in rows] == pytest.approx([12.5, 25])
    assert [row["common_stationarity"] for row in rows] == [1e-6] * 2  # less is not told apart


def test_curve_has_costs_of_at_least_one_contact_solve_and_the_first_of_each_level(tmp_path: Path) -> None:
    assert curve(Result(fixed_61(), tmp_path, tmp_path / "no")) is None
    found = curve(result(tmp_path, "joint", -1.5, [(0.001, START, 1.0), *GOOD]))
    assert found["cost"].tolist() == pytest.approx([1, 10, 20, 30, 50])
    assert found["value"].iloc[-1] == -1.0
    assert found["feasible"].tolist() == [True, True, False, True, True]
    longer = result(tmp_path, "joint", -1.6, GOOD)
    costs = [cost_to(longer, level) for level in (-1.2, -1.41, -1.5, -1.55, -1.6, -1.61)]
    # the second iterate is not feasible; below the last one only the end, after 0.5 s, is so low
    assert costs == pytest.approx([10, 30, 50, 50, 50, INF])
    assert cost_to(Result(longer.record, tmp_path, tmp_path / "no"), -1.6) == pytest.approx(50)
