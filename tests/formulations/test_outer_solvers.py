"""Joint, nested and mpcc: where they end, by which method, at what cost."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import outer_solvers
from formulations.finish import finished
from formulations.joint import Joint
from formulations.mpcc import OPTIONS, AllAtOnce
from formulations.nested import Nested
from formulations.outer_solvers import INTERIOR, NEWTON, NestedSettings
from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import is_valid, least_angles, least_area_ratio
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain, Relative, Traction
from rmesh_nlp.solving.outer import TOLERANCE, Outer
from rmesh_nlp.solving.parts import Step
from support.designs import LOAD, block
from support.formulations import joint, mpcc, nested
from support.reduced import bumpy
from support.solved import example, solved


@pytest.mark.parametrize(
    ("example", "arguments", "tol"),
    [("6.1", (4,), 1e-3), ("6.3", ((4, 2),), 1e-3), ("6.2", ((6, 3), (1.0, 0.5)), 1e-4)],
    ids=["move limits", "friction", "areas"],
)
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(example, arguments, tol):
    """With such a tolerance (a hundredth with areas) Ipopt stops near a stationary point, not at one."""
    steps: list[Step] = []
    solution = joint.solve(rm.EXAMPLES[example](*arguments), tol=tol, on_step=steps.append)
    record = solution.record()
    newton = record["newton_steps"]
    ipopt = record["iterations"] - newton
    assert newton > 0
    assert solution.status is rm.Status.CONVERGED
    assert solution.history[-1].iteration == record["iterations"]
    assert record["kkt_factorisations"] in (ipopt, record["iterations"])  # with areas the steps are Ipopt's
    assert record["contact_solves"] > 2
    assert sum(step.t == 0.0 for step in solution.history) == newton + 1  # after Ipopt's iterates
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


@pytest.mark.slow
def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(rm.EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 2  # at its start and at its end


def test_an_end_above_where_it_began_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither of the finish, nor of an interior point, whatever the solver says."""
    outer = Outer.of(rm.EXAMPLES["6.2"]((4, 2), 0.6))
    least = Nested().run(outer, np.zeros(outer.n), rm.Monitor()).q
    monkeypatch.setattr("formulations.finish._newton", lambda *_: (higher, "steps that lead up"))
    higher, near = least / 2, least * (1 - 1e-4)
    assert outer.energy(higher).value > outer.energy(near).value
    np.testing.assert_array_equal(finished(outer, near, rm.Monitor()).q, near)
    end = SimpleNamespace(x=higher, f=0.0, converged=True, status=rm.Status.CONVERGED, iterations=1)
    monkeypatch.setattr(outer_solvers, "Solver", lambda *_, **__: lambda *_, **__: end)
    found = outer_solvers.interior(outer, near, lambda *_: False, NestedSettings())
    assert (found.is_lower, found.status) == (False, rm.Status.STALLED)
    np.testing.assert_array_equal(found.q, near)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("formulation", "n", "delta", "seed"),
    [
        (Joint(), 3, 0.15, 3),
        (AllAtOnce(), 4, 0.05, 1),
        (Nested(ipopt={"mu_init": 10.0, "bound_push": 0.1, "max_iter": 3}), 3, 0.3, 3),
    ],
)
def test_from_a_minimiser_the_barrier_leads_to_none_above_it(formulation, n, delta, seed):
    outer = Outer.of(rm.EXAMPLES["6.1"](n, delta))
    least = Nested().run(outer, outer.variables(seed=seed), rm.Monitor()).q
    found = formulation.run(outer, least, rm.Monitor())
    assert outer.energy(found.q).value <= outer.energy(least).value * (1 - 1e-9)  # both are negative


def block_of_length(length: float) -> ContactProblem:
    """The block of the README, 6 x 2 squares, at a size of ``length``, under the same strains."""
    return ContactProblem(
        mesh=rm.shapes.rectangle(6, 2, x=(0, 4 * length), y=(0, length)),
        law=PlaneStrain.from_young(young=21600, poisson=0.3),
        dirichlet=("left",),
        obstacle=Obstacle.graph("bottom", lambda x, y: -0.02 * length - 0.01 * x**2 / length, friction=10.0),
        motion=Motion(delta=Relative(0.3), pinned=("top",)),
        tractions=(Traction("top", (0.0, lambda x, y: -20 * x / length)),),
    )


@pytest.fixture(scope="module")
def usual() -> float:
    return joint.solve(block_of_length(1.0)).assessment.gain


@pytest.mark.parametrize("length", [1e-9, 1e6])
def test_joint_ends_as_well_in_any_unit_of_length(usual: float, length: float) -> None:
    solution = joint.solve(block_of_length(length))
    assert solution.success, solution.status
    assert solution.assessment.first_order.residual <= 1e-6
    assert is_valid(solution.problem, solution.mesh.p)
    assert solution.assessment.gain / length**2 >= 0.9 * usual  # it may be another local minimum
    residuals = [step.dual_residual for step in solution.history if np.isfinite(step.dual_residual)]
    assert residuals[-1] <= 1e-6 < residuals[0]


def with_areas(name: str) -> ContactProblem:
    return rm.EXAMPLES[name]((6, 3), (1.0, 0.5))


def settled(problem: ContactProblem, **options: Any) -> rm.Solution:
    """Converged to a stationary point, its iterations numbered in order."""
    solution = nested.solve(problem, **options)
    assert solution.status is rm.Status.CONVERGED
    numbers = [step.iteration for step in solution.history]
    assert numbers == sorted(numbers)
    return solution


@pytest.mark.slow
@pytest.mark.parametrize("name", ["6.2", "6.3"])
def test_few_contact_solves_lead_to_a_stationary_point_within_area_constraints(name: str) -> None:
    solution = settled(with_areas(name))
    residual = solution.assessment.first_order.residual
    assert residual == pytest.approx(solution.history[-1].dual_residual, rel=1e-6)
    assert residual <= TOLERANCE
    assert np.any(solution.multipliers.area > 0) == (name == "6.2")
    assert solution.trace.work.contact_solves <= 2 * solution.trace.iterations < 120
    assert solution.record()["outer"] == INTERIOR
    # one that went on below the tolerance would spend dozens of solves on rounding
    assert all(step.stationarity > TOLERANCE for step in solution.history[:-1])


@pytest.mark.slow
def test_another_objective_of_many_variables_takes_newton_along_areas(monkeypatch):
    problem, sag = rm.EXAMPLES["6.2"]((4, 2), 0.4), "mean(top, -uy)"
    best = settled(problem, objective=sag).record()
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
    assert settled(bumpy(friction)).trace.iterations <= 100


@pytest.mark.slow
def test_thousands_of_variables_without_move_limits_take_a_contact_solve_per_iteration() -> None:
    problem = rm.EXAMPLES["6.1"](40)
    problem = replace(problem, motion=replace(problem.motion, delta=None), quadrature=8)
    solution = nested.solve(problem, limits={"iterations": 6})
    assert solution.multipliers.area.size > 3000
    assert (solution.status, solution.success) == (rm.Status.ITERATION_LIMIT, True)
    assert solution.trace.iterations <= 6
    assert solution.trace.work.contact_solves <= 20
    assert solution.energy < solution.energy_initial


@pytest.mark.slow
def test_newton_converges_where_angles_are_at_their_bounds() -> None:
    problem = replace(rm.EXAMPLES["6.1"](6, 0.08), motion=Motion(0.08, min_angle=30.0))
    solution = nested.solve(problem)
    assert solution.success
    assert solution.assessment.first_order.residual <= TOLERANCE
    angle = np.min(least_angles(solution.mesh.p, problem.triangles))
    assert 30 - np.rad2deg(ROUNDING) <= angle < 30 + 1e-4
    assert solution.energy <= joint.solve(problem).energy * (1 - 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", [joint, nested])
def test_where_the_interior_point_leaves_the_valley_of_the_start_newton_lowers_the_energy(formulation):
    """The load jumps within triangles, so the energy of the rule jumps with the positions."""
    problem = ContactProblem(
        rm.shapes.rectangle(3, 3, x=(0, 2)),
        Laplace(lambda x, y: rm.where(x > 1.21, -2.0, -3.0)),
        ("left",),
        Obstacle("right", (1.0,), 0.05),
        Motion(None),
        (Traction("top", (lambda x, y: 1 - x,)),),
        quadrature=8,
    )
    solution = formulation.solve(problem)
    assert solution.success
    assert solution.assessment.gain_audited > 0.01


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
    assert record["gain"] >= 0.95 * solved("joint", name, SMALL[name], 6).assessment.gain
    # for the energy the multipliers of the equilibrium vanish
    assert record["equilibrium_multiplier"] <= 1e-6
    assert (record["stationarity"], record["b_stationary"]) == ("S", True)


@pytest.mark.slow
def test_the_first_stage_begins_at_the_contact_solution_on_the_given_mesh() -> None:
    problem = example("6.1", 2)
    seen: list[Any] = []
    solution = mpcc.solve(problem, objective="error-l2", on_step=seen.append)
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
    certified = mpcc.solve(rm.EXAMPLES[name](), start=end)
    # other minima are a tenth of an edge away; along flat directions nested is exact to a thousandth of one
    np.testing.assert_allclose(certified.mesh.p, end.mesh.p, atol=1e-3)
    assert certified.energy == pytest.approx(end.energy, rel=1e-9)
    assert (certified.success, certified.assessment.first_order.stationarity) == (True, "S")
    assert certified.trace.iterations < 40


@pytest.mark.slow
def test_the_certificate_leaves_a_point_that_is_no_minimum() -> None:
    # joint stopped early: what follows must not call its end stationary
    problem = example("6.3", (4, 2))
    loose = joint.solve(problem, **{"tol": 1e-2}, tolerance=0.5)
    accurate = mpcc.solve(problem, start=loose)
    assert loose.assessment.first_order.residual > 1e-3 > 1e-6 > accurate.assessment.first_order.residual
    assert accurate.assessment.first_order.stationarity == "S"


@pytest.mark.slow
def test_ipopts_barrier_is_no_relaxation_parameter() -> None:
    assert {step.t for step in solved("joint", "6.3", (4, 2)).history} == {np.inf}
    assert {step.t for step in solved("nested", "6.3", (4, 2)).history} == {0.0}


@pytest.mark.slow
@pytest.mark.parametrize(("formulation", "name", "n"), [(mpcc, "6.1", 3), (joint, "6.2", (4, 2))])
def test_without_move_limits_no_iterate_inverts_an_element(formulation: Any, name: str, n: Any) -> None:
    given = rm.EXAMPLES[name](n)
    problem = replace(given, motion=replace(given.motion, delta=None))
    positions, steps = MeshMap.of(problem).positions, []
    solution = formulation.solve(problem, limits={"iterations": 250}, on_step=steps.append)
    assert solution.status.value == "converged"
    assert min(least_area_ratio(problem, positions.values(step.q)) for step in steps) > 0


@pytest.mark.slow
@pytest.mark.parametrize(("order", "kept"), [((0.9, 0.1), 1), ((0.1, 0.9), 0)])
def test_the_better_end_of_two_paths_is_kept_for_designs_and_others_have_one(order, kept, monkeypatch):
    outer, near = Outer.of(block(LOAD), "compliance"), []
    ends = [size * np.ones(outer.n) for size in order]  # more load, more compliance

    def path(_: AllAtOnce, at: Outer, q: Any, monitor: rm.Monitor, *most: Any) -> rm.Outcome:
        near.append(at.is_near)
        monitor.note(Step(len(near), *6 * [1.0]))
        return rm.Outcome(at, ends[(len(near) - 1) % 2] if at.problem.design else q, rm.Status.CONVERGED)

    monkeypatch.setattr(AllAtOnce, "_path", path)
    monitor = rm.Monitor()
    assert AllAtOnce().run(outer, np.zeros(outer.n), monitor).q is ends[kept]
    assert near == [False, True]
    # the history of the path that is kept; of the first one its end after the second's iterations as well
    steps = [(step.iteration, step.t) for step in monitor.steps]
    assert steps == [[(1, 1.0), (2, 0.0)], [(2, 1.0)]][kept]
    plain = Outer.of(coarse("6.3"), "mean(top, -uy)")
    for formulation, problem in ((AllAtOnce(twice=False), outer), (AllAtOnce(), plain)):
        near.clear()
        assert formulation.run(problem, np.zeros(problem.n), rm.Monitor()).status is rm.Status.CONVERGED
        assert near == [False]
    # ends at no mesh, where there is no contact solution to report
    ends, monitor = 2 * [np.full(outer.n, 1e3)], rm.Monitor()
    near.clear()
    assert AllAtOnce().run(outer, np.zeros(outer.n), monitor).q is ends[0]
    assert [step.iteration for step in monitor.steps] == [1]
