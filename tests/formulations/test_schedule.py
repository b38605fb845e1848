"""Regularised problems without move limits by every formulation and outer solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.problem import ContactProblem, Motion
from support.formulations import joint, mpcc, nested


def problem(n: int = 4, **motion: float) -> ContactProblem:
    return replace(EXAMPLES["6.1"](n=n), motion=Motion(None, **motion), quadrature=4)


def check(solution) -> None:
    row = solution.record()
    assert row["min_area_ratio"] > 0
    assert row["gain_audited"] > 0.2 * row["gain_estimate"]
    # the distortion vanishes on the mesh as given, so that what is gained is the energy's
    assert row["regularisation_weight"] == pytest.approx(row["regularisation"] * row["gain_estimate"])
    assert row["objective"].endswith("*shape-size")


@pytest.mark.parametrize(
    "solve", [joint.solve, pytest.param(mpcc.solve, marks=pytest.mark.slow)], ids=["joint", "mpcc"]
)
def test_all_at_once(solve) -> None:
    solution = solve(problem(), regularisation=0.1)
    check(solution)
    assert solution.status.value == "converged"


@pytest.mark.slow
@pytest.mark.parametrize("outer", ["newton", "ipopt"])
def test_every_outer_solver_takes_the_barrier(outer: str) -> None:
    check(nested.solve(problem(), regularisation=0.1, outer=outer, max_iterations=60))


@pytest.mark.slow
def test_joint_and_nested_are_stationary_for_the_same_program() -> None:
    one = nested.solve(problem(), regularisation=(1.0, 0.1), outer="newton")
    two = joint.solve(problem(), regularisation=(1.0, 0.1))
    for solution in (one, two):
        assert solution.status.value == "converged"
        assert solution.stationarity_residual < 1e-4
    gain = one.record()["gain_audited"]
    assert one.audit.energy_audited == pytest.approx(two.audit.energy_audited, abs=0.05 * gain)


@pytest.mark.slow
def test_the_last_weight_may_be_zero_and_areas_are_then_constraints() -> None:
    solution = joint.solve(problem(), regularisation=(0.1, 0))
    assert solution.objective == "energy"
    assert solution.audit.min_area_ratio >= 0.01 - 1e-8
    assert solution.energy <= joint.solve(problem(), regularisation=0.1).energy


@pytest.mark.slow
def test_a_least_angle_holds_as_a_constraint() -> None:
    solution = joint.solve(problem(min_angle=15.0), regularisation=0.01)
    assert np.min(least_angles(solution.mesh.p, solution.problem.triangles)) >= 15 - 1e-6
    assert solution.record()["gain_audited"] > 0.2 * gain_estimate(problem()).value


def test_move_limits_hold_too() -> None:
    limited = replace(problem(), motion=Motion(0.05))
    solution = nested.solve(limited, regularisation=0.01, outer="newton")
    assert np.max(np.abs(solution.mesh.p - limited.mesh.p)) <= 0.05 + 1e-12
    assert np.max(np.abs(solution.mesh.p - limited.mesh.p)) > 0.049


def test_other_objectives_are_refused() -> None:
    with pytest.raises(BadInputError, match="error-l2"):
        nested.solve(problem(), regularisation=0.01, objective="error-l2")
    with pytest.raises(ValueError, match="mpcc or nested"):
        joint.solve(problem(), objective="error-l2 + 0.1*quality")


@pytest.mark.slow
def test_formulations_say_an_objective_alike() -> None:
    """Rows of one objective are compared with one another: its text and its values must be the same."""
    given = replace(EXAMPLES["6.2"]((4, 2)), quadrature=4)
    rows = [one.solve(given, objective="energy+0.1*quality").record() for one in (joint, nested, mpcc)]
    assert {row["objective"] for row in rows} == {"energy + 0.1*quality"}
    start = rows[0]["objective_initial"]
    for row in rows:
        assert row["objective_initial"] == pytest.approx(start, rel=1e-12)
        # the distortion is worth something on the relocated mesh, and nothing on the given one
        assert row["objective_value"] - row["energy"] > row["objective_initial"] - row["energy_initial"]


def test_the_history_of_joint_calls_only_an_energy_an_energy() -> None:
    given = replace(EXAMPLES["6.2"]((4, 2)), quadrature=4)
    steps = joint.solve(given, objective="energy+0.1*quality").history
    assert all(np.isnan(step.energy) and np.isfinite(step.objective) for step in steps)
