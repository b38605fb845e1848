"""Fields by values at nodes, cut into straight pieces: what is drawn is what was computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem import sampling
from rmesh_nlp.fem.sampling import along, centres, edges_of, pieces, points_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem import ContactProblem
from support.curved import HOLE, plate
from support.problems import renumbered

ORDERS = pytest.mark.parametrize("order", [1, 2])


def space_of(problem: ContactProblem, order: int) -> DisplacementSpace:
    """A space whose nodes are numbered at random."""
    return renumbered(replace(problem, order=order)).space


def polynomial(order: int, x: np.ndarray) -> np.ndarray:
    """One of that degree."""
    return np.asarray(2 * x[0] - x[1] + 0.5 + (order - 1) * (3 * x[0] * x[1] - x[1] ** 2))


@ORDERS
@pytest.mark.parametrize("most", [4, 16, 64])
def test_a_polynomial_has_its_values_at_the_points_of_the_pieces(
    order: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampling, "MOST", 18 * most)
    space = space_of(EXAMPLES["6.1"](3), order)
    nodes = points_of(space, space.problem.mesh.p)
    cut = pieces(space.elements, space.n_nodes)
    each = {1: 1, 2: most}[order]
    assert cut.triangles.shape == (3, each * space.elements.shape[1])
    points = cut(nodes)
    np.testing.assert_allclose(cut(polynomial(order, nodes)), polynomial(order, points), atol=1e-14)
    areas = signed_areas(points, cut.triangles)
    np.testing.assert_allclose(areas, 1 / areas.size, rtol=1e-10)  # all alike, and the square is covered
    # no two points at one place, where the pieces would not be joined
    assert np.unique(np.round(points, 9), axis=1).shape == points.shape
    where = np.einsum("cve,vp->cep", nodes[:, space.elements[:3]], centres(space.elements))
    middles = points[:, cut.triangles].mean(axis=1)
    np.testing.assert_allclose(where.reshape(2, -1), middles, atol=1e-14)


def test_linear_cells_are_their_own_pieces() -> None:
    cells = EXAMPLES["6.1"](3).mesh.t
    values = np.random.default_rng(0).normal(size=(2, 20))
    cut = pieces(cells, 20)
    np.testing.assert_array_equal(cut.triangles, cells)
    np.testing.assert_array_equal(cut(values), values)


@ORDERS
def test_edges_are_those_of_the_mesh_with_their_middles(order: int) -> None:
    space = space_of(EXAMPLES["6.3"]((4, 2)), order)
    mesh, nodes = space.problem.mesh, points_of(space, space.problem.mesh.p)
    for edges, facets in (
        (edges_of(space.elements), np.arange(mesh.facets.shape[1])),
        (edges_of(space.elements, outer=True), mesh.boundary_facets()),
    ):
        expected = space.nodes_of(mesh.facets[:, facets])
        assert {frozenset(one) for one in edges.T.tolist()} == {frozenset(one) for one in expected.T.tolist()}
        assert edges.shape == expected.shape
        np.testing.assert_allclose(
            nodes[:, edges[2:]] - nodes[:, edges[:2]].mean(axis=1)[:, None], 0, atol=1e-15
        )
        values = along(edges, polynomial(order, nodes), 4)
        np.testing.assert_allclose(values, polynomial(order, along(edges, nodes, 4)), atol=1e-14)


def test_middles_of_edges_on_a_curve_are_on_it() -> None:
    space = space_of(plate({"hole": HOLE}), 2)
    mesh = space.problem.mesh
    nodes = points_of(space, np.asarray(mesh.p))
    assert isinstance(HOLE, Circle)
    on_hole = space.nodes_of(mesh.facets[:, mesh.boundaries["hole"]])
    np.testing.assert_allclose(np.linalg.norm(nodes[:, on_hole] - 5.0, axis=0), 2.5, rtol=1e-12)
    others = np.setdiff1d(np.arange(space.n_nodes), on_hole)
    np.testing.assert_array_equal(nodes[:, others], space.points(mesh.p)[:, others])
    chords = np.linalg.norm(space.points(mesh.p)[:, on_hole[2]] - 5.0, axis=0)
    assert np.all(chords < 2.49)
    # the parabola through the middle leaves the arc by far less than the chord
    bent = np.linalg.norm(along(on_hole, nodes) - 5.0, axis=0)
    assert np.max(np.abs(bent - 2.5)) < 0.02 * np.max(2.5 - chords)
