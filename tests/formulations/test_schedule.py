"""Regularised problems without move limits by every formulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem, Motion
from support.formulations import joint, mpcc, nested


def problem(delta: float | None = None, **motion: float) -> ContactProblem:
    return replace(EXAMPLES["6.1"](n=4), motion=Motion(delta, **motion), quadrature=4)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("formulation", "options"),
    [
        (joint, {}),
        pytest.param(mpcc, {}, marks=SLOW),
        pytest.param(nested, {"iterations": 60}, marks=SLOW),
    ],
)
def test_the_distortion_keeps_elements_valid(formulation: Any, options: dict[str, Any]) -> None:
    row = formulation.solve(problem(), regularisation=0.1, **options).record()
    assert row["min_area_ratio"] > 0
    assert row["gain_audited"] > 0.2 * row["gain_estimate"]
    # the distortion vanishes on the mesh as given, so that what is gained is the energy's
    assert row["regularisation_weight"] == pytest.approx(0.1 * row["gain_estimate"])
    assert row["regularisation"] == 0.1
    assert row["objective"].endswith("*shape-size")
    assert row["status"] == "converged" or formulation is nested


@SLOW
def test_joint_and_nested_are_stationary_for_the_same_program() -> None:
    one = nested.solve(problem(), regularisation=(1.0, 0.1))
    two = joint.solve(problem(), regularisation=(1.0, 0.1))
    for solution in (one, two):
        assert solution.status.value == "converged"
        assert solution.stationarity_residual < 1e-4
    gain = one.record()["gain_audited"]
    assert one.energy_audited == pytest.approx(two.energy_audited, abs=0.05 * gain)


@SLOW
def test_the_last_weight_may_be_zero_and_areas_are_then_constraints() -> None:
    solution = joint.solve(problem(), regularisation=(0.1, 0))
    assert solution.objective == "energy"
    assert solution.assessment.final.min_area_ratio >= 0.01 - 1e-8
    assert solution.energy <= joint.solve(problem(), regularisation=0.1).energy


def test_move_limits_hold_too() -> None:
    limited = problem(0.05)
    solution = nested.solve(limited, regularisation=0.01)
    assert np.max(np.abs(solution.mesh.p - limited.mesh.p)) == pytest.approx(0.05, abs=1e-3)
    assert np.max(np.abs(solution.mesh.p - limited.mesh.p)) <= 0.05 + 1e-12


def test_other_objectives_are_refused() -> None:
    with pytest.raises(BadInputError, match="error-l2"):
        nested.solve(problem(), regularisation=0.01, objective="error-l2")
    with pytest.raises(ValueError, match="mpcc or nested"):
        joint.solve(problem(), objective="error-l2 + 0.1*quality")
    with pytest.raises(ValueError, match="joint minimises the energy only"):
        mpcc.solve(problem(), start="joint", objective="error-l2")


@pytest.mark.parametrize("formulation", [joint, *(pytest.param(one, marks=SLOW) for one in (nested, mpcc))])
def test_formulations_say_an_objective_alike(formulation: Any) -> None:
    """Rows of one objective are compared with one another: its text and its values must be the same."""
    solution = formulation.solve(
        replace(EXAMPLES["6.2"]((4, 2)), quadrature=4), objective="energy+0.1*quality"
    )
    row = solution.record()
    assert row["objective"] == "energy + 0.1*quality"
    # the distortion is worth something on the relocated mesh, and nothing on the given one
    assert row["objective_initial"] == pytest.approx(row["energy_initial"], rel=1e-12)
    assert row["objective_value"] > row["energy"]
    if formulation is joint:  # its history calls only an energy an energy
        assert all(np.isnan(step.energy) and np.isfinite(step.objective) for step in solution.history)
