"""Maps between the levels of a cascade: prolongation exact on linear maps, and whether a map helps."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.levels import coarsened, interpolated, located, prolonged
from rmesh_nlp.problem import (
    ContactProblem,
    Laplace,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    PointLoad,
)
from support.curved import HOLE, plate
from support.problems import no_move_limits
from support.reduced import reduced


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


def test_no_map_is_defined_where_an_arc_cuts_through_its_triangle() -> None:
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
