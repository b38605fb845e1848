"""Levels of a cascade: coarser meshes, Delaunay meshes in a metric, and maps between meshes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.mapping.validity import is_valid
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.meshes.coarsening import Lines, decimated
from rmesh_nlp.meshes.delaunay import MetricNodes, delaunay
from rmesh_nlp.meshes.geometry import counter_clockwise, signed_areas
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.levels import coarsened, interpolated, located, prolonged
from rmesh_nlp.problem import PiecewiseLinear
from rmesh_nlp.problem.lines import sliding_directions
from support.curved import HOLE, plate
from support.problems import no_move_limits
from support.quality import shape_quality, sizes
from support.reduced import reduced


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
    bounded = discretise(replace(two, motion=rm.Motion(0.01)))
    assert np.max(np.abs(prolonged(one.mesh.p, one.triangles, move, bounded))) == pytest.approx(1.0)


def test_no_map_is_defined_where_an_arc_cuts_through_its_triangle() -> None:
    problem = plate({"hole": HOLE})
    energy = reduced(problem, "energy + shape-size")
    facet = int(problem.mesh.boundaries["hole"][0])
    ends, element = problem.mesh.facets[:, facet], problem.mesh.f2t[0, facet]
    inner = int(np.setdiff1d(problem.triangles[:, element], ends)[0])
    nodes = np.array(problem.mesh.p)
    nodes[:, inner] = 0.98 * nodes[:, ends].mean(axis=1) + 0.02 * nodes[:, inner]
    q = energy.relocation.parts.mesh_map.q_of(nodes)
    assert np.min(signed_areas(energy.relocation.nodes(q), problem.triangles)) > 0
    assert not is_valid(problem, energy.relocation.nodes(q), by_barrier=True)


@pytest.mark.slow
def test_coarser_meshes_have_about_a_quarter_of_the_nodes_or_are_none() -> None:
    coarse = coarsened(EXAMPLES["6.1"](16), least=20)
    assert coarse.mesh.p.shape[1] == 81
    assert coarsened(EXAMPLES["6.1"](16), least=82) is None
    problem = plate({"hole": HOLE}, h=0.8)
    fewer, n = coarsened(problem, least=20), problem.mesh.p.shape[1]
    assert n / 5 < fewer.mesh.p.shape[1] < n / 3
    assert coarsened(problem, least=fewer.mesh.p.shape[1]) is not None
    assert coarsened(problem, least=round(0.6 * n)) is None


def test_coarser_meshes_keep_nodes_at_kinks_and_under_point_loads() -> None:
    mesh, place = rm.shapes.rectangle(9, 9), np.array([0.0, 4 / 9])
    node = int(np.argmin(np.linalg.norm(mesh.p - place[:, None], axis=0)))
    problem = rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=("right",),
        obstacle=rm.Obstacle.graph("bottom", PiecewiseLinear((0.0, 5 / 9, 1.0), (-0.1, 0.0, -0.1))),
        point_loads=(rm.PointLoad(node, (1.0, 0.0)),),
        motion=rm.Motion(None),
    )
    coarse = coarsened(problem, least=10)
    np.testing.assert_allclose(coarse.mesh.p[:, coarse.point_loads[0].node], place)
    assert coarse.mesh.p[0, coarse.kink_nodes] == pytest.approx([5 / 9])


@pytest.mark.slow
def test_a_decimated_problem_keeps_domain_names_and_corners() -> None:
    problem = rm.refined(rm.refined(random_problem(1)))
    rng = np.random.default_rng(1)
    p = problem.mesh.p.copy()
    on_line, _ = sliding_directions(problem)
    inside = np.setdiff1d(problem.mesh.interior_nodes(), on_line)
    p[:, inside] += rng.uniform(-0.01, 0.01, (2, inside.size))  # no refinement any more
    problem = replace(problem, mesh=replace(problem.mesh, doflocs=p))
    coarse = coarsened(problem, least=20)
    assert coarse.mesh.p.shape[1] < problem.mesh.p.shape[1] / 2
    # mergers leave 0.2, flips improve that
    assert np.min(shape_quality(coarse.mesh.p, coarse.triangles)) > 0.35
    assert sizes(coarse.mesh) == pytest.approx(sizes(problem.mesh), rel=1e-12)
    # coarser spaces have higher energies, up to quadrature: the problem is the same one
    solved = ContactSolver(replace(coarse, quadrature=12)).solve(coarse.mesh.p)
    assert solved.status.value == "converged"


def directions(mesh: MeshTri) -> np.ndarray:
    """Directions of the edges inside as angles in [0, pi)."""
    inside = np.setdiff1d(np.arange(mesh.facets.shape[1]), mesh.boundary_facets())
    a, b = mesh.p[:, mesh.facets[:, inside]].transpose(1, 0, 2)
    return np.asarray(np.round(np.mod(np.arctan2(*(b - a)[::-1]), np.pi), 6) % np.round(np.pi, 6))


def test_edges_of_coarser_meshes_have_the_directions_of_the_given_one() -> None:
    """A map found with other directions is of little use on the given mesh."""
    mesh = rm.shapes.rectangle(31, 9, x=(0, 3), diagonal="falling")
    coarse = coarsened(rm.ContactProblem(mesh, rm.Laplace(1.0), "left", motion=rm.Motion(None)), least=20)
    assert 0.2 < coarse.mesh.p.shape[1] / mesh.p.shape[1] < 0.32
    kept = np.isin(directions(coarse.mesh), np.unique(directions(mesh)))
    assert np.mean(kept) > 0.7


def test_a_small_hole_stays_open() -> None:
    """Its nodes slide along a circle, so that any of them may be taken out, but not all."""
    grid, radius = rm.shapes.rectangle(12, 12, x=(-6, 6), y=(-6, 6)), 1.0
    p = grid.p.copy()
    t = grid.t[:, np.max(np.abs(p[:, grid.t].mean(axis=1)), axis=0) > radius]
    rim = np.isclose(np.max(np.abs(p), axis=0), radius)
    p[:, rim] *= radius / np.linalg.norm(p[:, rim], axis=0)
    used = np.unique(t)
    parts = {"left": lambda x: x[0] < -5, "hole": lambda x: np.hypot(*x) < 2}
    mesh = from_arrays(p[:, used].T, np.searchsorted(used, counter_clockwise(p, t)).T, parts)
    motion = rm.Motion(None, curves={"hole": rm.Circle((0.0, 0.0), radius)})
    coarse = coarsened(rm.ContactProblem(mesh, rm.Laplace(1.0), "left", motion=motion), least=12)
    found = coarse.mesh.facets[:, coarse.mesh.boundaries["hole"]]
    assert np.unique(found).size == found.shape[1] >= 3


def test_a_hole_of_four_edges_keeps_them_all() -> None:
    """Of its nodes every second one could go, and would leave a line there and back."""
    grid = rm.shapes.rectangle(12, 12, x=(-6, 6), y=(-6, 6))
    p = grid.p + 0.5
    outside = np.max(np.abs(p[:, grid.t].mean(axis=1)), axis=0) > 0.5
    t = counter_clockwise(p, grid.t[:, outside])
    mesh = MeshTri(p, t)
    result = decimated(p, t, Lines(np.zeros(p.shape[1], dtype=bool), mesh.facets[:, mesh.boundary_facets()]))
    rim = np.flatnonzero(np.isclose(np.max(np.abs(p), axis=0), 0.5))
    assert rim.size == 4
    assert np.unique(result.into).size < 0.5 * p.shape[1]
    assert result.into[rim].tolist() == rim.tolist()


def test_nodes_named_by_number_stay_and_are_renumbered() -> None:
    problem = replace(
        EXAMPLES["6.1"](n=16), motion=rm.Motion(None, pinned=(40,), tied=((100, 120),), slides=("contact",))
    )
    coarse = coarsened(problem)
    limited = coarsened(replace(problem, motion=rm.Motion(rm.Relative(0.2))))
    # an edge is as much longer as its move limit is a smaller part of it
    part = np.sqrt(limited.mesh.p.shape[1] / problem.mesh.p.shape[1])
    assert limited.motion.delta_record() == {"relative": pytest.approx(0.2 * part)}
    new = coarse.motion.pinned[0], *coarse.motion.tied[0]
    np.testing.assert_allclose(coarse.mesh.p[:, new], problem.mesh.p[:, [40, 100, 120]])


def test_delaunay_in_the_plane_is_scipys_and_keeps_fixed_edges() -> None:
    rng = np.random.default_rng(1)
    mesh = rm.shapes.rectangle(6, 6)
    p = mesh.p.copy()
    inside = mesh.interior_nodes()
    p[:, inside] += rng.uniform(-0.07, 0.07, (2, inside.size))
    plane = MetricNodes(p, np.tile([[1.0], [0.0], [1.0]], p.shape[1]))
    t, fixed = counter_clockwise(p, mesh.t), mesh.facets[:, [10, 20, 30]]
    found = delaunay(plane, t, np.zeros((2, 0), dtype=int))
    expected = Delaunay(p.T).simplices
    flat = signed_areas(p, expected.T)  # along the sides, whose nodes are on a line only up to rounding
    assert {frozenset(one) for one in found.T.tolist()} == {
        frozenset(one) for one in expected[np.abs(flat) > 1e-9].tolist()
    }
    held = delaunay(plane, t, fixed)
    assert signed_areas(p, held).min() > 0
    facets = {tuple(f) for f in np.sort(MeshTri(p, held).facets, axis=0).T}
    assert all(tuple(np.sort(edge)) in facets for edge in fixed.T)
    assert plane.flatness(t).sum() > plane.flatness(held).sum() > plane.flatness(found).sum()


def test_slivers_of_a_coarse_map_are_prolonged_as_they_are() -> None:
    coarse = replace(EXAMPLES["6.1"](n=4), motion=rm.Motion(None))
    flat = coarse.mesh.p.copy()
    flat[0] = np.where(flat[0] == 0.25, 1e-4, flat[0])  # the first column has 4e-4 of its width
    fine = relocation(rm.refined(coarse))
    found = fine.nodes(prolonged(coarse.mesh.p, coarse.triangles, flat - coarse.mesh.p, fine.parts))
    np.testing.assert_allclose(found[:, : flat.shape[1]], flat, atol=1e-12)
