"""Repeated solves: medians of times, their range, and nothing else changed; residuals along a solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.campaign.cases import make_cases
from rmesh_nlp.campaign.repeats import joined
from rmesh_nlp.campaign.run import run, solve
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.solving.outer import Outer


def test_times_are_medians_with_their_range() -> None:
    one = {"energy": -1.0, "build_time_s": 3.0, "solve_time_s": 1.0, "wall_time_s": 4.0}
    others = [{**one, "build_time_s": 1.0, "energy": -9.0}, {**one, "build_time_s": 2.0}]
    row = joined([one, *others])
    assert (row["build_time_s"], row["build_time_range_s"]) == (2.0, [1.0, 3.0])
    assert row["energy"] == -1.0
    assert row["repeats"] == 3
    assert row["first_cost_s"] == 4.0
    assert joined([one]) is one


@pytest.mark.parametrize(
    "formulation", ["nested", *(pytest.param(name, marks=pytest.mark.slow) for name in ("joint", "mpcc"))]
)
def test_a_traced_solve_has_the_referees_residual_in_its_history(formulation: str, tmp_path: Path) -> None:
    (case,) = make_cases(["6.3"], [formulation], n=(4, 2), trace=True)
    outcome = solve(case)
    assert outcome.solution is not None
    residuals = np.array([step.stationarity for step in outcome.history])
    known = residuals[np.isfinite(residuals)]
    # the first steps are at the mesh as given, whose residual is one; the last one is the end
    assert known[0] == pytest.approx(1, rel=0.05)
    assert known[-1] <= 1e-5
    solution = outcome.solution
    outer = Outer(solution.problem)
    q = outer.relocation.freedoms.q_of(np.asarray(solution.mesh.p))
    assert known[-1] == pytest.approx(outer.residual(outer.energy(q)), abs=1e-5)
    list(run([case], Results(tmp_path)))
    (result,) = read_results(tmp_path)
    assert [step["stationarity"] for step in result.steps()] == pytest.approx(
        residuals, nan_ok=True, abs=1e-7
    )
