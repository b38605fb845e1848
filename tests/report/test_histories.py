"""Curves of histories, and costs to a level that all formulations reach."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.io.results import HISTORY_FIELDS, Result, write_history
from rmesh_nlp.report.histories import cost_of_gain, curve, with_common_costs
from rmesh_nlp.report.tables import markdown
from support.reporting import fixed_61, joint_61

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
        rows.append({**dict.fromkeys(HISTORY_FIELDS), **known, "primal_residual": sum(primal)})
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
    rows = with_common_costs([joint, nested])
    assert [row["cost_to_objective"] for row in rows] == pytest.approx([12.5, 25])
    assert [row["common_stationarity"] for row in rows] == [1e-6] * 2  # less is not told apart


def test_curve_has_costs_of_at_least_one_contact_solve(tmp_path: Path) -> None:
    assert curve(Result(fixed_61(), tmp_path, tmp_path / "no")) is None
    found = curve(result(tmp_path, "joint", -1.5, [(0.001, START, 1.0), *GOOD]))
    assert found is not None
    assert found.cost.tolist() == pytest.approx([1, 10, 20, 30, 50])
    assert found.energy[-1] == -1.0
    assert found.feasible.tolist() == [True, True, False, True, True]


def test_cost_of_a_part_of_the_gain() -> None:
    energy, cost = [0.0, -5.0, np.nan, -9.0, -10.0], [1, 2, 3, 4, 5]
    assert cost_of_gain(energy, cost, 0.0, -10.0, 0.5) == 2
    assert cost_of_gain(energy, cost, 0.0, -10.0, 0.9) == 4
    assert cost_of_gain(energy, cost, 0.0, -11.0, 0.99) == float("inf")
