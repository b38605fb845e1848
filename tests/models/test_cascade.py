"""The cascade of meshes: maps between its levels, which end of several counts, and what it notes."""

from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from formulations.cascade import Cascade
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models import cascade as module
from rmesh_nlp.models.cascade import CascadeSettings, cascade
from rmesh_nlp.models.levels import accepted, coarsened, interpolated, located, prolonged
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.models.regularised_descent import descend
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    PointLoad,
    Traction,
)
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from support.curved import HOLE, plate
from support.problems import no_move_limits
from support.reduced import reduced, with_distortion


def square(n: int) -> ContactProblem:
    return replace(no_move_limits(EXAMPLES["6.1"](n=n)), quadrature=4)


@pytest.mark.parametrize("schedules", [((3.0,), (0.01,)), ((0.01,), (3.0,))])
def test_of_several_schedules_the_best_end_counts_and_weights_are_continued(
    schedules: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CHEAP", 1.0)
    seen: list[tuple] = []
    settings = CascadeSettings(schedules=schedules, iterations=4)
    result = cascade(square(3), settings, lambda iteration, *step: seen.append(step))
    descents = [list(steps) for _, steps in groupby(seen, key=lambda step: id(step[0]))]
    final = result.energy.objective.text
    ends = [steps[-1][2] for steps in descents if steps[0][0].objective.text == final]
    assert len(ends) >= 2
    assert result.energy(result.q).value <= min(ends)
    for heavier, lighter in ((0, 1), (2, 3)):
        np.testing.assert_array_equal(descents[lighter][0][1], descents[heavier][-1][1])


def test_levels_have_the_weight_of_their_error_and_add_up() -> None:
    problem, seen = square(8), []
    result = cascade(problem, CascadeSettings(coarsest=20, iterations=6), lambda i, *_: seen.append(i))
    coarse, fine = result.levels
    assert (coarse.nodes, fine.nodes, coarse.triangles, fine.triangles) == (25, 81, 32, 128)
    # the error falls like the number of nodes
    error = gain_estimate(module.coarsened(problem, 20)).value
    assert coarse.weight == pytest.approx(0.003 * error)
    assert fine.weight == pytest.approx(0.003 * error * 25 / 81)
    assert result.gain_estimate == pytest.approx(error * 25 / 81)
    assert np.isnan([coarse.prolonged, coarse.taken]).all()
    assert fine.taken == 1
    assert fine.energy == result.energy(result.q).equilibrium.energy < fine.prolonged
    assert fine.prolonged < result.energy(0 * result.q).equilibrium.energy
    # the last iterate of each descent is reported with the number of those before it
    assert seen == sorted(seen)
    assert seen[-1] == coarse.iterations + fine.iterations
    assert min(coarse.contact_solves, fine.contact_solves, coarse.products, fine.products) > 0
    assert result.energy.contact_solves >= fine.contact_solves > 0
    assert result.record()[1]["nodes"] == 81


def test_a_map_that_folds_triangles_is_not_evaluated(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(*given: Any) -> np.ndarray:
        return np.random.default_rng(0).uniform(-9, 9, given[-1].n_q)

    monkeypatch.setattr(module, "prolonged", folded)
    level = cascade(square(8), CascadeSettings(coarsest=20, iterations=2)).levels[-1]
    assert np.isnan(level.prolonged)
    assert level.taken == 0


def test_descents_are_brief_on_the_finest_mesh_and_longer_where_it_is_not_nested() -> None:
    settings = CascadeSettings(iterations=60, brief=10, brief_unnested=20)
    assert [settings.limit(True, nested) for nested in (True, False)] == [10, 20]
    assert [settings.limit(False, nested) for nested in (True, False)] == [60, 60]
    # on meshes made for the solution, shorter at order 2, and without coarser ones
    assert [CascadeSettings().near(order) for order in (1, 2)] == [20, 6]
    near, monitor = Outer.of(square(6)).near(), Monitor()
    Cascade(brief_unnested=3).run(near, near.variables(), monitor)
    assert (monitor.iterations, len(monitor.steps)) == (3, 4)
    assert settings.starts(60, 9000) == settings.schedules
    assert settings.starts(60, 8999) == settings.schedules[:1]


def test_it_stops_when_asked_to_and_when_the_time_is_up() -> None:
    with pytest.raises(StoppedError):
        cascade(square(8), CascadeSettings(coarsest=20), budget=Budget(Limits(1e-9)))
    late, seen = Budget(), []
    late.is_over = lambda: len(seen) > 1  # type: ignore[method-assign]
    for ask, budget in ((lambda iteration, *_: iteration == 2, None), (lambda i, *_: seen.append(i), late)):
        found = cascade(square(8), CascadeSettings(coarsest=20), ask, budget)
        assert (found.status, len(found.levels), found.built) == (Status.INTERRUPTED, 1, None)
        # the map so far is taken to the given mesh, and lowers the energy there
        assert found.q.size == found.energy.relocation.n_q
        assert found.energy.is_defined(found.q)
        assert found.energy(found.q).value < found.energy(0 * found.q).value


@pytest.mark.slow
def test_meshes_that_are_not_nested_gain_as_much_as_their_neighbours() -> None:
    products = []
    for n in (12, 13, 16, 17):
        found = cascade(replace(square(n), quadrature=8))
        relocated = admissible(found.problem, found.energy.relocation.nodes(found.q))
        products.append((relocated.energy - found.problem.exact.energy) * found.problem.mesh.p.shape[1])
    assert max(products) < 1.15 * min(products)


def free_square(n: int, shake: float = 0.0) -> ContactProblem:
    """A square whose nodes move in both directions, those of its sides too."""
    mesh = rectangle(n, n)
    p = np.array(mesh.p)
    inside = mesh.interior_nodes()
    p[:, inside] += shake / n * np.random.default_rng(n).uniform(-1, 1, (2, inside.size))
    motion = Motion(None, free=("left", "right", "bottom", "top"))
    return ContactProblem(replace(mesh, doflocs=p), Laplace(1.0), ("left",), motion=motion)


def linear(p: Array) -> Array:
    return np.array([[0.1, -0.05], [0.02, 0.2]]) @ p + np.array([[0.01], [-0.02]])


def test_interpolation_is_exact_for_linear_functions_and_continued_from_the_nearest_place() -> None:
    problem = random_problem(1)
    mesh, points = problem.mesh, np.random.default_rng(0).uniform(0.2, 0.8, (2, 30))
    lower, upper = mesh.p.min(axis=1, keepdims=True), mesh.p.max(axis=1, keepdims=True)
    points = np.hstack([lower + points * (upper - lower), upper + 0.3 * (upper - lower)])
    vertices, weights = located(mesh.p, problem.triangles, points)
    there = np.einsum("cvk,vk->ck", mesh.p[:, vertices], weights)
    inside = np.all(np.isclose(there, points, atol=1e-12), axis=0)
    assert inside.sum() > 15
    np.testing.assert_allclose(weights.sum(axis=0), 1)
    assert weights.min() >= 0
    found = interpolated(mesh.p, problem.triangles, linear(mesh.p), points)
    np.testing.assert_allclose(found, linear(there), atol=1e-12)


@pytest.mark.parametrize(("coarse", "fine"), [(3, 6), (4, 7)])
def test_linear_maps_are_prolonged_exactly(coarse: int, fine: int) -> None:
    one, two = free_square(coarse, 0.2), free_square(fine, 0.2)
    parts = discretise(two)
    q = prolonged(one.mesh.p, one.triangles, linear(one.mesh.p), parts)
    expected = two.mesh.p + linear(two.mesh.p)
    moves = np.all(parts.mesh_map.positions.index >= 0, axis=0)
    assert moves.sum() > fine**2
    np.testing.assert_allclose(parts.mesh_map.positions.values(q)[:, moves], expected[:, moves], atol=1e-12)


def test_a_map_that_would_invert_elements_of_the_finer_mesh_is_smoothed_or_damped() -> None:
    one, two = no_move_limits(EXAMPLES["6.1"](4)), no_move_limits(EXAMPLES["6.1"](7))
    rng, move = np.random.default_rng(0), np.zeros((2, 25))
    inside = one.mesh.interior_nodes()
    move[:, inside] = 0.12 * rng.uniform(-1, 1, (2, inside.size))
    parts = discretise(two)
    q = prolonged(one.mesh.p, one.triangles, move, parts)
    before, after = (signed_areas(p, two.triangles) for p in (two.mesh.p, parts.mesh_map.positions.values(q)))
    assert np.min(after / before) > 1e-9
    assert np.any(q)
    bounded = discretise(replace(two, motion=Motion(0.01)))
    assert np.max(np.abs(prolonged(one.mesh.p, one.triangles, move, bounded))) == pytest.approx(1.0)


def continuous(energy: ReducedEnergy, q: Array) -> float:
    rel = energy.relocation
    return admissible(rel.problem, rel.nodes(q), energy(q).equilibrium.active).energy


def test_a_map_is_halved_until_it_lowers_the_energy() -> None:
    energy = with_distortion(replace(no_move_limits(EXAMPLES["6.1"](n=3)), quadrature=4))
    zero = np.zeros(energy.relocation.n_q)
    slope = energy(zero).gradient
    far = downhill = -1e-2 / np.max(np.abs(slope)) * slope
    for q, expected in ((downhill, 1), (-downhill, 0)):
        taken, part = accepted(energy, q)
        assert part == expected
        np.testing.assert_array_equal(taken, expected * q)
    while energy.is_defined(far) and continuous(energy, far) < continuous(energy, zero):
        far = 2 * far
    taken, part = accepted(energy, far)
    assert part in (0.5, 0.25, 0.125)
    np.testing.assert_array_equal(taken, part * far)
    assert continuous(energy, taken) < continuous(energy, zero)
    assert not energy.is_defined(2 * taken) or continuous(energy, 2 * taken) >= continuous(energy, zero)


def test_a_map_that_gains_by_penetration_is_not_taken() -> None:
    """Gaps hold at nodes, so a descent draws them apart and lets the foundation pass in between."""
    problem = ContactProblem(
        rectangle(4, 2, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("left", (0.0, None)),),
        tractions=(Traction("top", (0.0, -20.0)),),
        obstacle=Obstacle.curve("bottom", lambda x, y: y + 0.05 * (x - 1) ** 2),
        motion=Motion(None),
    )
    energy = with_distortion(problem)
    zero = np.zeros(energy.relocation.n_q)
    found = descend(energy, zero, gain_tolerance=0, max_iterations=4).x
    assert energy(found).equilibrium.energy < energy(zero).equilibrium.energy
    assert accepted(energy, found)[1] == 0


def test_no_map_is_taken_where_an_arc_cuts_through_its_triangle() -> None:
    problem = plate({"hole": HOLE})
    energy = reduced(problem, "energy + shape-size")
    facet = int(problem.mesh.boundaries["hole"][0])
    ends, element = problem.mesh.facets[:, facet], problem.mesh.f2t[0, facet]
    inner = int(np.setdiff1d(problem.triangles[:, element], ends)[0])
    nodes = np.array(problem.mesh.p)
    nodes[:, inner] = 0.98 * nodes[:, ends].mean(axis=1) + 0.02 * nodes[:, inner]
    q = energy.relocation.mesh_map.q_of(nodes)
    assert np.min(signed_areas(energy.relocation.nodes(q), problem.triangles)) > 0
    assert not energy.is_defined(q)
    assert energy.is_defined(accepted(energy, q)[0])


def test_coarser_meshes_have_about_a_quarter_of_the_nodes_or_are_none() -> None:
    coarse = coarsened(EXAMPLES["6.1"](16), least=20)
    assert coarse is not None
    assert coarse.mesh.p.shape[1] == 81
    assert coarsened(EXAMPLES["6.1"](16), least=82) is None
    problem = plate({"hole": HOLE}, h=0.8)
    fewer, n = coarsened(problem, least=20), problem.mesh.p.shape[1]
    assert fewer is not None
    assert n / 5 < fewer.mesh.p.shape[1] < n / 3
    assert coarsened(problem, least=fewer.mesh.p.shape[1]) is not None
    assert coarsened(problem, least=round(0.6 * n)) is None


def test_coarser_meshes_keep_nodes_at_kinks_and_under_point_loads() -> None:
    mesh, place = rectangle(9, 9), np.array([0.0, 4 / 9])
    node = int(np.argmin(np.linalg.norm(mesh.p - place[:, None], axis=0)))
    problem = ContactProblem(
        mesh,
        PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=("right",),
        obstacle=Obstacle.graph("bottom", PiecewiseLinear((0.0, 5 / 9, 1.0), (-0.1, 0.0, -0.1))),
        point_loads=(PointLoad(node, (1.0, 0.0)),),
        motion=Motion(None),
    )
    coarse = coarsened(problem, least=10)
    assert coarse is not None
    np.testing.assert_allclose(coarse.mesh.p[:, coarse.point_loads[0].node], place)
    assert coarse.mesh.p[0, coarse.kink_nodes] == pytest.approx([5 / 9])
