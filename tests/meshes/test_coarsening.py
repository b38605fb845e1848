"""Coarser meshes, Delaunay meshes in a metric, and maps between meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.meshes.coarsening import Lines, decimated
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.delaunay import Measured, delaunay
from rmesh_nlp.meshes.geometry import counter_clockwise, signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.levels import coarsened, prolonged
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Relative
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.problem.lines import sliding_directions
from support.quality import shape_quality, sizes


@pytest.mark.parametrize("seed", range(2))
def test_a_decimated_problem_keeps_domain_names_and_corners(seed: int) -> None:
    problem = refined(refined(random_problem(seed)))
    rng = np.random.default_rng(seed)
    p = problem.mesh.p.copy()
    on_line, _ = sliding_directions(problem)
    inside = np.setdiff1d(problem.mesh.interior_nodes(), on_line)
    p[:, inside] += rng.uniform(-0.01, 0.01, (2, inside.size))  # no refinement any more
    problem = replace(problem, mesh=replace(problem.mesh, doflocs=p))
    coarse = coarsened(problem, least=20)
    assert coarse is not None
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


@pytest.mark.parametrize(("size", "diagonal"), [((17, 17), "rising"), ((31, 9), "falling")])
def test_edges_of_coarser_meshes_have_the_directions_of_the_given_one(
    size: tuple[int, int], diagonal: str
) -> None:
    """A map found with other directions is of little use on the given mesh."""
    mesh = rectangle(*size, x=(0, 3), diagonal=diagonal)
    coarse = coarsened(ContactProblem(mesh, Laplace(1.0), "left", motion=Motion(None)), least=20)
    assert coarse is not None
    assert 0.2 < coarse.mesh.p.shape[1] / mesh.p.shape[1] < 0.32
    kept = np.isin(directions(coarse.mesh), np.unique(directions(mesh)))
    assert np.mean(kept) > 0.7


def test_coarsening_does_not_depend_on_how_much_a_mesh_is_stretched() -> None:
    """Its metric is its own: layers stay layers."""
    mesh, stretch = rectangle(13, 11), 20.0
    found = []
    for wide in (1, stretch):
        scaled = replace(mesh, doflocs=mesh.p * [[wide], [1]])
        problem = ContactProblem(scaled, Laplace(1.0), "left", motion=Motion(None))
        found.append(coarsened(problem, least=20).mesh)
    np.testing.assert_allclose(found[1].p, found[0].p * [[stretch], [1]], rtol=1e-12)
    one, other = ({frozenset(t) for t in coarse.t.T.tolist()} for coarse in found)
    assert len(one & other) > 0.9 * len(one)  # merges between equals are decided by rounding


@pytest.mark.parametrize("edges", [4, 8])
def test_a_small_hole_stays_open(edges: int) -> None:
    """Its nodes slide along a circle, so that any of them may be taken out, but not all."""
    grid, radius = rectangle(12, 12, x=(-6, 6), y=(-6, 6)), edges / 8
    p = grid.p + (0.5 if edges == 4 else 0.0)  # one square, or two by two
    t = grid.t[:, np.max(np.abs(p[:, grid.t].mean(axis=1)), axis=0) > radius]
    rim = np.isclose(np.max(np.abs(p), axis=0), radius)
    p[:, rim] *= radius / np.linalg.norm(p[:, rim], axis=0)
    used = np.unique(t)
    parts = {"left": lambda x: x[0] < -5, "hole": lambda x: np.hypot(*x) < 2}
    mesh = from_arrays(p[:, used].T, np.searchsorted(used, counter_clockwise(p, t)).T, parts)
    motion = Motion(None, curves={"hole": Circle((0.0, 0.0), radius)})
    coarse = coarsened(ContactProblem(mesh, Laplace(1.0), "left", motion=motion), least=12)
    assert coarse is not None
    found = coarse.mesh.facets[:, coarse.mesh.boundaries["hole"]]
    assert np.unique(found).size == found.shape[1] >= 3


def test_a_hole_of_four_edges_keeps_them_all() -> None:
    """Of its nodes every second one could go, and would leave a line there and back."""
    grid = rectangle(12, 12, x=(-6, 6), y=(-6, 6))
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
        EXAMPLES["6.1"](n=16), motion=Motion(None, pinned=(40,), tied=((100, 120),), slides=("contact",))
    )
    coarse = coarsened(problem)
    assert coarse is not None
    limited = coarsened(replace(problem, motion=Motion(Relative(0.2))))
    assert limited is not None
    # an edge is as much longer as its move limit is a smaller part of it
    part = np.sqrt(limited.mesh.p.shape[1] / problem.mesh.p.shape[1])
    assert limited.motion.delta_record() == {"relative": pytest.approx(0.2 * part)}
    new = coarse.motion.pinned[0], *coarse.motion.tied[0]
    np.testing.assert_allclose(coarse.mesh.p[:, new], problem.mesh.p[:, [40, 100, 120]])


def test_delaunay_in_the_plane_is_scipys_and_keeps_fixed_edges() -> None:
    rng = np.random.default_rng(1)
    mesh = rectangle(6, 6)
    p = mesh.p.copy()
    inside = mesh.interior_nodes()
    p[:, inside] += rng.uniform(-0.07, 0.07, (2, inside.size))
    plane = Measured(p, np.tile([[1.0], [0.0], [1.0]], p.shape[1]))
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
    coarse = replace(EXAMPLES["6.1"](n=4), motion=Motion(None))
    flat = coarse.mesh.p.copy()
    flat[0] = np.where(flat[0] == 0.25, 1e-4, flat[0])  # the first column has 4e-4 of its width
    fine = relocation(refined(coarse))
    found = fine.nodes(prolonged(coarse.mesh.p, coarse.triangles, flat - coarse.mesh.p, fine))
    np.testing.assert_allclose(found[:, : flat.shape[1]], flat, atol=1e-12)
