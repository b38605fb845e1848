"""Costs to a common level are read off histories; several starts are joined to best, median and failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.io.results import HISTORY_FIELDS, Result, write_history
from rmesh_nlp.report.histories import with_common_costs
from rmesh_nlp.report.joined import multistart_rows
from rmesh_nlp.report.tables import markdown
from support.reporting import failed_61, fixed_61, joint_61

START = -1.1172085
"""Audited energy on the given mesh of the records made by hand."""


def result(folder: Path, name: str, steps: list[dict[str, float]], **changes: Any) -> Result:
    """A record with a history: seconds, own energy, residuals."""
    end = changes.pop("end")
    common = {
        "energy_initial_audited": START,
        "build_time_s": 0.1,
        "solve_time_s": 0.4,
        "contact_time_s": 0.01,
    }
    record = joint_61(formulation=name, energy=end + 0.5, energy_audited=end, **{**common, **changes})
    path = folder / f"{name}.csv"
    empty: dict[str, Any] = dict.fromkeys(HISTORY_FIELDS)
    write_history(path, [{**empty, "iteration": i, **step} for i, step in enumerate(steps)])
    return Result(record, folder / "none.vtu", path)


def step(seconds: float, audited: float, residual: float, primal: float = 0.0) -> dict[str, float]:
    return {
        "seconds": seconds,
        "energy": audited + 0.5,
        "primal_residual": primal,
        "stationarity": residual,
    }


def test_the_level_is_what_all_reach_and_infeasible_iterates_do_not_count(tmp_path: Path) -> None:
    good = [
        step(0.1, -1.2, 0.5),
        step(0.2, -1.41, 1e-2, primal=1e-3),
        step(0.3, -1.42, 1e-3),
        step(0.5, -1.5, 1e-7),
    ]
    poor = [step(0.2, -1.2, 0.5), step(0.4, -1.4, 2e-3)]
    results = [
        Result(fixed_61(), tmp_path / "no", tmp_path / "no"),
        result(tmp_path, "joint", good, end=-1.5, stationarity_residual=1e-7),
        result(tmp_path, "nested", poor, end=-1.4, stationarity_residual=2e-3),
    ]
    fixed, joint, nested = with_common_costs(results)
    assert "cost_to_objective" not in fixed
    assert joint["common_objective"] == nested["common_objective"]
    # the worst end, less a thousandth of its gain
    assert joint["common_objective"] == pytest.approx(-1.4 + 1e-3 * (START + 1.4))
    assert joint["common_stationarity"] == 2e-3
    assert joint["cost_to_objective"] == pytest.approx(30)
    assert joint["cost_to_stationarity"] == pytest.approx(30)
    assert nested["cost_to_objective"] == pytest.approx(40)
    text = markdown([fixed, joint, nested])
    assert "cost to that J" in text
    assert "cost to that J" not in markdown([one.record for one in results])


def test_costs_are_in_the_units_and_at_the_pace_of_the_medians(tmp_path: Path) -> None:
    steps = [step(0.5, -1.4, 1e-6)]
    results = [
        result(tmp_path, "joint", steps, end=-1.4, contact_time_s=0.01, first_cost_s=1.0),
        result(tmp_path, "nested", steps, end=-1.4, contact_time_s=0.03),
    ]
    joint, nested = with_common_costs(results)
    # the unit is 0.02 s; the first run of joint took twice its median
    assert joint["cost_to_objective"] == pytest.approx(12.5)
    assert nested["cost_to_objective"] == pytest.approx(25)


def test_several_starts_are_joined() -> None:
    ends = {None: -1.47, 1: -1.48, 2: -1.46}
    rows = [joint_61(seed=seed, energy_audited=end) for seed, end in ends.items()]
    rows.append(failed_61(formulation="joint", seed=3))
    ((title, ((name, starts, best, middle, worst, failures, cost),)),) = multistart_rows(rows)
    assert title.startswith("Example 6.1")
    assert (name, starts, failures) == ("joint", "4", "1")
    assert (best, middle, worst) == ("-1.48", "-1.47", "-1.46")
    assert float(cost) == pytest.approx(50)
    assert "Several starts" in markdown(rows)
    assert not multistart_rows(rows[:1])


def test_the_starts_of_one_solve_are_joined_as_well() -> None:
    record = joint_61(start_energies=[-1.4, None, -1.5])
    other = joint_61(start_energies=[-1.4, -1.5], start_values=[0.25, 0.5], objective="error-l2")
    ((_, ((*_, least, middle, largest, _, _),)),) = multistart_rows([other])
    assert (least, middle, largest) == ("0.25", "0.375", "0.5")
    ((_, ((_, starts, best, _, worst, failures, cost),)),) = multistart_rows([record])
    assert (starts, best, worst, failures, cost) == ("3", "-1.5", "-1.4", "1", "-")
