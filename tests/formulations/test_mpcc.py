"""The homotopy of ``mpcc``: it is one, from the start it is given, whatever the objective."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from formulations.mpcc import OPTIONS, AllAtOnce, build
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import least_area_ratio
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Obstacle
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from support.designs import LOAD, block
from support.formulations import joint, mpcc
from support.solved import example, solved

SMALL: dict[str, Any] = {"6.1": 4, "6.2": (6, 4), "6.3": (6, 4)}


def coarse(name: str) -> ContactProblem:
    """An example on a coarse grid, with a rule that is not exploited there as the midpoint rule is on 6.1."""
    return example(name, SMALL[name], 6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6.1", "6.3"])
@pytest.mark.parametrize("relaxation", RELAXATIONS)
def test_every_relaxation_ends_near_joint_from_the_given_mesh(name: str, relaxation: str) -> None:
    record = mpcc.solve(coarse(name), relaxation=relaxation).record()
    assert (record["success"], record["start"]) == (True, "given")
    # a descent may end in another local minimum of these coarse grids, but not in a bad one
    assert record["gain"] >= 0.95 * solved("joint", name, SMALL[name], 6).gain
    # for the energy the multipliers of the equilibrium vanish
    assert record["equilibrium_multiplier"] <= 1e-6
    assert (record["stationarity"], record["b_stationary"]) == ("S", True)


@pytest.mark.parametrize("objective", ["energy", "error-l2"])
def test_the_first_stage_begins_at_the_contact_solution_on_the_given_mesh(objective: str) -> None:
    problem = example("6.1", 3)
    seen: list[Any] = []
    solution = mpcc.solve(problem, objective=objective, on_step=seen.append)
    first, record = solution.history[0], solution.record()
    assert first.t == OPTIONS["t0"]
    # Ipopt pushes forces and gaps off their bounds, by a hundredth of their unit
    assert first.objective == pytest.approx(record["objective_initial"], rel=2e-2)
    np.testing.assert_allclose(seen[0].q, 0.0, atol=1e-5)
    assert [step.iteration for step in seen] == [step.iteration for step in solution.history]
    stages = record["stages"]
    assert (record["start"], stages[0]["phase"]) == ("given", "relaxed")
    assert record["nlp_solves"] == len(stages)  # no other program was solved
    assert record["iterations"] == sum(stage["iterations"] for stage in stages)


@pytest.mark.slow
def test_t_goes_down_in_the_history_and_products_follow() -> None:
    solution = solved("mpcc", "6.1", objective="error-l2")
    t = np.array([step.t for step in solution.history])
    assert t[0] == OPTIONS["t0"]
    assert np.all(np.diff(t) <= 0)
    assert t[-1] == 0
    ends = np.append(np.flatnonzero(np.diff(t)), t.size - 1)
    for end in ends:
        step = solution.history[end]
        assert step.product <= step.t * (1 + 1e-6) + 1e-12
    assert solution.history[-1].biactive == solution.record()["biactive"]
    assert solution.history[-1].objective == pytest.approx(solution.record()["objective_value"], rel=1e-6)
    assert [step.row()["t"] for step in solution.history] == t.tolist()


@pytest.mark.parametrize("start", ["joint", "nested"])
def test_what_is_solved_first_is_named(start: str) -> None:
    solution = mpcc.solve(example("6.3", (4, 2)), start=start)
    record = solution.record()
    assert record["success"]
    assert record["start"] == start
    before = [step for step in solution.history if not 0 < step.t <= 1e-9]
    assert before[0].t == (0.0 if start == "nested" else np.inf)
    iterations = [step.iteration for step in solution.history]
    assert iterations == sorted(iterations)
    assert iterations[-1] == record["iterations"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6.1", "6.3"])
def test_a_minimum_of_another_formulation_is_certified_where_it_is(name: str) -> None:
    # from the given mesh mpcc ends in a lower minimum of 6.1: it must not leave nested's on the way there
    end = solved("nested", name)
    certified = mpcc.solve(EXAMPLES[name](), start=end)
    # other minima are a tenth of an edge away; along flat directions nested is exact to a thousandth of one
    np.testing.assert_allclose(certified.mesh.p, end.mesh.p, atol=1e-3)
    assert certified.energy == pytest.approx(end.energy, rel=1e-9)
    assert (certified.success, certified.stationarity) == (True, "S")
    assert certified.iterations < 40


def test_the_certificate_leaves_a_point_that_is_no_minimum() -> None:
    # joint stopped early: what follows must not call its end stationary
    problem = example("6.3", (4, 2))
    loose = joint.solve(problem, **{"tol": 1e-2}, tolerance=1.0)
    accurate = mpcc.solve(problem, start=loose)
    assert loose.stationarity_residual > 1e-3 > 1e-6 > accurate.stationarity_residual
    assert accurate.stationarity == "S"


def test_ipopts_barrier_is_no_relaxation_parameter() -> None:
    assert {step.t for step in solved("joint", "6.3", (4, 2)).history} == {np.inf}
    assert {step.t for step in solved("nested", "6.3", (4, 2)).history} == {0.0}


@pytest.mark.parametrize(
    ("formulation", "name", "n"),
    [(mpcc, "6.1", 3), (mpcc, "6.2", (4, 2)), (joint, "6.1", 3), (joint, "6.2", (4, 2))],
)
def test_without_move_limits_no_iterate_inverts_an_element(formulation: Any, name: str, n: Any) -> None:
    given = EXAMPLES[name](n)
    problem = replace(given, motion=replace(given.motion, delta=None))
    positions, steps = MeshMap.of(problem).positions, []
    solution = formulation.solve(problem, limits={"iterations": 250}, on_step=steps.append)
    assert solution.status.value == "converged"
    assert min(least_area_ratio(problem, positions.values(step.q)) for step in steps) > 0


@pytest.mark.parametrize("friction", [0.0, 10.0])
def test_a_flat_foundation_is_the_same_as_the_zeros_of_a_level_function(friction: float) -> None:
    problem = replace(EXAMPLES["6.3"]((4, 2)), obstacle=Obstacle("contact", friction=friction))
    level = Obstacle("contact", level=lambda x, y: y, friction=friction)  # its slope along x is no entry
    values = []
    for one in (problem, replace(problem, obstacle=level)):
        mpcc = build(one)
        x = np.random.default_rng(0).uniform(-0.5, 0.5, mpcc.x.numel())
        found = ca.Function("values", [mpcc.x], [mpcc.f, mpcc.g, mpcc.G, mpcc.H])(x)
        values.append(np.concatenate([value.full().ravel() for value in found]))
    np.testing.assert_allclose(values[1], values[0], atol=1e-12)


@pytest.mark.parametrize(("order", "kept"), [((0.9, 0.1), 1), ((0.1, 0.9), 0)])
def test_the_better_end_of_two_paths_is_kept_for_designs_and_others_have_one(
    order: tuple[float, float], kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    outer, near = Outer.of(block(LOAD), "compliance"), []
    ends = [size * np.ones(outer.n) for size in order]  # more load, more compliance

    def path(_: AllAtOnce, at: Outer, q: Any, monitor: Monitor, *most: Any) -> Outcome:
        near.append(at.is_near)
        monitor.note(Step(len(near), *6 * [1.0]))
        return Outcome(at, ends[(len(near) - 1) % 2] if at.problem.design else q, Status.CONVERGED)

    monkeypatch.setattr(AllAtOnce, "_path", path)
    monitor = Monitor()
    assert AllAtOnce().run(outer, np.zeros(outer.n), monitor).q is ends[kept]
    assert near == [False, True]
    # the history of the path that is kept; of the first one its end after the second's iterations as well
    steps = [(step.iteration, step.t) for step in monitor.steps]
    assert steps == [[(1, 1.0), (2, 0.0)], [(2, 1.0)]][kept]
    plain = Outer.of(coarse("6.3"), "mean(top, -uy)")
    for formulation, problem in ((AllAtOnce(twice=False), outer), (AllAtOnce(), plain)):
        near.clear()
        assert formulation.run(problem, np.zeros(problem.n), Monitor()).status is Status.CONVERGED
        assert near == [False]
    # ends at no mesh, where there is no contact solution to report
    ends, monitor = 2 * [np.full(outer.n, 1e3)], Monitor()
    near.clear()
    assert AllAtOnce().run(outer, np.zeros(outer.n), monitor).q is ends[0]
    assert [step.iteration for step in monitor.steps] == [1]
