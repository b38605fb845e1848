"""Joint and the outer solvers of nested: where they end, by which method, at what cost."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from formulations import outer_solvers
from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.nested import Nested
from formulations.outer_solvers import INTERIOR, NEWTON, OuterResult
from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import is_valid, least_angles
from rmesh_nlp.meshes import shapes
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.problem.coefficients import where
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import TOLERANCE, Outer
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution
from support.formulations import joint, nested
from support.reduced import bumpy


@pytest.mark.parametrize(
    ("example", "arguments", "tol"),
    [("6.1", (4,), 1e-3), ("6.3", ((4, 2),), 1e-3), ("6.2", ((6, 3), (1.0, 0.5)), 1e-4)],
    ids=["move limits", "friction", "areas"],
)
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(
    example: str, arguments: tuple[Any, ...], tol: float
) -> None:
    """With such a tolerance (a hundredth with areas) Ipopt stops near a stationary point, not at one."""
    steps: list[Step] = []
    solution = joint.solve(EXAMPLES[example](*arguments), tol=tol, on_step=steps.append)
    record = solution.record()
    newton = record["newton_steps"]
    ipopt = record["iterations"] - newton
    assert newton > 0
    assert solution.status is Status.CONVERGED
    assert solution.history[-1].iteration == record["iterations"]
    assert record["kkt_factorisations"] in (ipopt, record["iterations"])  # with areas the steps are Ipopt's
    assert record["contact_solves"] > 2
    assert sum(step.t == 0.0 for step in solution.history) == newton + 1  # after Ipopt's iterates
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 2  # at its start and at its end


def test_newton_steps_that_lead_up_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    outer = Outer.of(EXAMPLES["6.1"](4))
    zero, asked = np.zeros(outer.n), []
    back = OuterResult(zero, Status.CONVERGED, 0)
    monkeypatch.setattr("formulations.finish.solved", lambda *_: asked.append(1) or back)
    found = Joint(tol=1e-3).run(outer, zero, Monitor())
    assert asked
    assert outer.energy(found.q).value < outer.energy(zero).value


@pytest.mark.parametrize(
    ("formulation", "n", "delta", "seed"),
    [
        (Joint(), 3, 0.15, 3),
        (AllAtOnce(), 4, 0.05, 1),
        (Nested(ipopt={"mu_init": 10.0, "bound_push": 0.1, "max_iter": 3}), 3, 0.3, 3),
    ],
)
def test_from_a_minimiser_the_barrier_leads_to_none_above_it(
    formulation: Joint | AllAtOnce, n: int, delta: float, seed: int
) -> None:
    outer = Outer.of(EXAMPLES["6.1"](n, delta))
    least = Nested().run(outer, outer.variables(seed=seed), Monitor()).q
    found = formulation.run(outer, least, Monitor())
    assert outer.energy(found.q).value <= outer.energy(least).value * (1 - 1e-9)  # both are negative


def block(length: float) -> ContactProblem:
    """The block of the README, 6 x 2 squares, at a size of ``length``, under the same strains."""
    return ContactProblem(
        mesh=shapes.rectangle(6, 2, x=(0, 4 * length), y=(0, length)),
        law=PlaneStrain.from_young(young=21600, poisson=0.3),
        dirichlet=("left",),
        obstacle=Obstacle.graph("bottom", lambda x, y: -0.02 * length - 0.01 * x**2 / length, friction=10.0),
        motion=Motion(delta=Relative(0.3), pinned=("top",)),
        tractions=(Traction("top", (0.0, lambda x, y: -20 * x / length)),),
    )


@pytest.fixture(scope="module")
def usual() -> float:
    return joint.solve(block(1.0)).gain


@pytest.mark.parametrize("length", [1e-9, 1e6])
def test_joint_ends_as_well_in_any_unit_of_length(usual: float, length: float) -> None:
    solution = joint.solve(block(length))
    assert solution.success, solution.status
    assert solution.stationarity_residual <= 1e-6
    assert is_valid(solution.problem, solution.mesh.p)
    assert solution.gain / length**2 >= 0.9 * usual  # it may be another local minimum
    residuals = [step.dual_residual for step in solution.history if np.isfinite(step.dual_residual)]
    assert residuals[-1] <= 1e-6 < residuals[0]


def with_areas(name: str) -> ContactProblem:
    return EXAMPLES[name]((6, 3), (1.0, 0.5))


def solved(problem: ContactProblem, **options: Any) -> Solution:
    """Converged to a stationary point, its iterations numbered in order."""
    solution = nested.solve(problem, **options)
    assert solution.status is Status.CONVERGED
    numbers = [step.iteration for step in solution.history]
    assert numbers == sorted(numbers)
    return solution


@pytest.mark.parametrize("name", ["6.2", "6.3"])
def test_few_contact_solves_lead_to_a_stationary_point_within_area_constraints(name: str) -> None:
    solution = solved(with_areas(name))
    assert solution.stationarity_residual <= TOLERANCE
    assert np.any(solution.multipliers.area > 0) == (name == "6.2")
    assert solution.contact_solves <= 2 * solution.iterations < 120
    assert solution.history[-1].dual_residual == pytest.approx(solution.stationarity_residual, rel=1e-6)
    assert solution.record()["outer"] == INTERIOR
    # one that went on below the tolerance would spend dozens of solves on rounding
    assert all(step.stationarity > TOLERANCE for step in solution.history[:-1])


def test_another_objective_of_many_variables_takes_newton_along_areas(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, sag = EXAMPLES["6.2"]((4, 2), 0.4), "mean(top, -uy)"
    best = solved(problem, objective=sag).record()
    monkeypatch.setattr(outer_solvers, "LARGEST_DENSE", 1)
    row = nested.solve(problem, objective=sag).record()
    assert best["outer"].startswith(INTERIOR)
    assert row["outer"].startswith(NEWTON)
    assert row["objective_value"] <= 1.1 * best["objective_value"]
    assert row["min_area_ratio"] >= problem.motion.min_area_fraction * (1 - 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_newton_converges_with_gaps_along_edges(friction: float) -> None:
    """Without some entries of the matrix Ipopt's steps are not Newton's, and it meets its limit of 500."""
    assert solved(bumpy(friction)).iterations <= 100


@pytest.mark.slow
def test_thousands_of_variables_without_move_limits_take_a_contact_solve_per_iteration() -> None:
    problem = EXAMPLES["6.1"](40)
    problem = replace(problem, motion=replace(problem.motion, delta=None), quadrature=8)
    solution = nested.solve(problem, limits={"iterations": 6})
    assert solution.multipliers.area.size > 3000
    assert (solution.status, solution.success) == (Status.ITERATION_LIMIT, True)
    assert solution.iterations <= 6
    assert solution.contact_solves <= 20
    assert solution.energy < solution.energy_initial


@pytest.mark.slow
def test_newton_converges_where_angles_are_at_their_bounds() -> None:
    problem = replace(EXAMPLES["6.1"](6, 0.08), motion=Motion(0.08, min_angle=30.0))
    solution = nested.solve(problem)
    assert solution.success
    assert solution.stationarity_residual <= TOLERANCE
    angle = np.min(least_angles(solution.mesh.p, problem.triangles))
    assert 30 - np.rad2deg(ROUNDING) <= angle < 30 + 1e-4
    assert solution.energy <= joint.solve(problem).energy * (1 - 0.01)


@pytest.mark.parametrize("formulation", [joint, nested])
def test_where_the_interior_point_leaves_the_valley_of_the_start_newton_lowers_the_energy(
    formulation: Any,
) -> None:
    """The load jumps within triangles, so the energy of the rule jumps with the positions."""
    problem = ContactProblem(
        rectangle(3, 3, x=(0, 2)),
        Laplace(lambda x, y: where(x > 1.21, -2.0, -3.0)),
        ("left",),
        Obstacle("right", (1.0,), 0.05),
        Motion(None),
        (Traction("top", (lambda x, y: 1 - x,)),),
        quadrature=8,
    )
    solution = formulation.solve(problem)
    assert solution.success
    assert solution.gain_audited > 0.01
