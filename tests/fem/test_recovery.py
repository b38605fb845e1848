"""Derivatives recovered from nodal values: exact for polynomials wherever a fit is determined."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.fem import recovery
from rmesh_nlp.fem.recovery import RINGS
from rmesh_nlp.fem.recovery import recovered as recovered_in
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes import from_arrays, named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import NO_CONTACT, ContactProblem, Laplace, PlaneStrain
from support.certificates import distorted

SECOND = np.array([[1.7, -0.6, 0.4], [-2.0, 0.9, 3.1]])
"""Derivatives xx, xy, yy of two components."""


def quadratic(p: np.ndarray, second: np.ndarray = SECOND) -> np.ndarray:
    """(components, nodes) values with these second derivatives, and some of lower degree."""
    x, y = p
    a, b, c = second.T[..., None]
    return a * x**2 / 2 + b * x * y + c * y**2 / 2 + 0.3 * x - 1.1 * y + 4.0


def on(mesh: MeshTri, law: Any = None) -> ContactProblem:
    return ContactProblem(mesh, law or PlaneStrain(1.0, 1.0), ("left",), NO_CONTACT)


def recovered(mesh: MeshTri, values: np.ndarray, law: Any = None) -> np.ndarray:
    """(components, 3, nodes) on a mesh of one region."""
    (region,) = recovered_in(DisplacementSpace(on(mesh, law)), mesh.p, values)
    np.testing.assert_array_equal(region.nodes, np.arange(mesh.p.shape[1]))
    return region.derivatives


def with_tail(cells: int) -> MeshTri:
    """A block of 3 x 3 squares, and a row of squares that runs from its upper right end to the right."""
    squares = [(i, j) for i in range(3) for j in range(3)] + [(3 + k, 2) for k in range(cells)]
    number: dict[tuple[int, int], int] = {}
    corners = [
        [number.setdefault((i + a, j + b), len(number)) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        for i, j in squares
    ]
    triangles = [(s[k], s[k + 1], s[(k + 2) % 4]) for s in corners for k in (0, 2) if k == 0] + [
        (s[0], s[2], s[3]) for s in corners
    ]
    return from_arrays(np.array(list(number), dtype=float), triangles, {"left": lambda x: x[0] < 1e-9})


class TestQuadratics:
    def test_flat_triangles_do_as_well_as_round_ones(self) -> None:
        """Turned, so that neither coordinate is the long one."""
        mesh, flat = distorted(rectangle(6, 6), 0.2, 1), 1e-4
        turn = np.array([[0.8, -0.6], [0.6, 0.8]])
        thin = MeshTri(turn @ np.diag([1.0, flat]) @ mesh.p, mesh.t).with_boundaries(
            {"left": mesh.boundaries["left"]}
        )
        x, y = turn.T @ thin.p / np.array([[1.0], [flat]])
        found = recovered(thin, (x**2 / 2 - 2 * x * y + 3 * y**2 / 2)[None], Laplace(1.0))[0]
        (a, b), (_, c) = expected = turn @ np.array([[1, -2 / flat], [-2 / flat, 3 / flat**2]]) @ turn.T
        size = np.abs(expected).max()
        np.testing.assert_allclose(found, np.broadcast_to([[a], [b], [c]], found.shape), atol=1e-6 * size)

    def test_six_nodes_are_enough_and_four_or_two_rows_say_nothing(self) -> None:
        corners = [[0, 0], [2, 0], [0.3, 2], [1, 0], [1.15, 1], [0.15, 1]]
        triangles = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
        mesh = from_arrays(corners, triangles, {"left": lambda x: x[0] < 0.3})
        found = recovered(mesh, quadratic(mesh.p))
        np.testing.assert_allclose(found, np.broadcast_to(SECOND[..., None], found.shape), atol=1e-10)
        for mesh in (rectangle(1, 1), rectangle(12, 1, x=(0, 12))):
            assert not np.any(recovered(mesh, quadratic(mesh.p)))

    @pytest.mark.parametrize(("cells", "reaches"), [(2, True), (RINGS - 1, True), (RINGS, False)])
    def test_patches_grow_until_the_fit_is_determined(self, cells: int, reaches: bool) -> None:
        """At the end of a row of squares, which alone does not tell the second derivatives across it."""
        mesh = with_tail(cells)
        found = recovered(mesh, quadratic(mesh.p))
        end = mesh.p[0] == mesh.p[0].max()
        assert end.sum() == 2
        expected = SECOND[..., None] if reaches else 0.0
        np.testing.assert_allclose(found[:, :, end], np.broadcast_to(expected, (2, 3, 2)), atol=1e-7)
        np.testing.assert_allclose(found[:, :, mesh.p[0] < 4].transpose(2, 0, 1) - SECOND, 0.0, atol=1e-7)

    def test_many_nodes_are_fitted_in_chunks(self, monkeypatch: pytest.MonkeyPatch) -> None:
        mesh = with_tail(3)
        values = np.vstack([np.sin(mesh.p[0] + 2 * mesh.p[1]), np.exp(-mesh.p[0])])
        whole = recovered(mesh, values)
        monkeypatch.setattr(recovery, "CHUNK", 4)
        np.testing.assert_allclose(recovered(mesh, values), whole, rtol=1e-12, atol=1e-14)

    def test_near_nodes_count_more_than_far_ones(self) -> None:
        """The second derivative of x^4 is 0 at 0; the fit without weights is further off."""
        mesh = rectangle(6, 6, x=(-3, 3), y=(-3, 3))
        x, y = mesh.p
        node = int(np.argmin(np.abs(x) + np.abs(y)))
        found = recovered(mesh, (x**4)[None], Laplace(1.0))[0, 0, node]
        near = np.isin(np.arange(x.size), mesh.t[:, np.any(mesh.t == node, axis=0)])
        patch = np.isin(np.arange(x.size), mesh.t[:, np.any(near[mesh.t], axis=0)])
        x, y = mesh.p[:, patch]
        terms = np.stack([np.ones_like(x), x, y, x**2 / 2, x * y, y**2 / 2], axis=1)
        unweighted = np.linalg.lstsq(terms, x**4, rcond=None)[0][3]
        assert 0 < found < 0.95 * unweighted


class TestCubics:
    """Third derivatives of quadratic displacements."""

    THIRD = np.array([[1.7, -0.6, 0.4, 2.0], [-2.0, 0.9, 3.1, 0.5]])

    def found(self, mesh: MeshTri, function: Any) -> np.ndarray:
        space = DisplacementSpace(replace(on(mesh), order=2))
        values = function(space.points(np.asarray(mesh.p)))
        (region,) = recovered_in(space, mesh.p, space.coefficients(values))
        return region.derivatives

    def cubic(self, p: np.ndarray) -> np.ndarray:
        x, y = p
        a, b, c, d = self.THIRD.T[..., None]
        return a * x**3 / 6 + b * x * x * y / 2 + c * x * y * y / 2 + d * y**3 / 6 + quadratic(p)

    def test_are_exact_at_all_vertices_also_on_the_boundary(self) -> None:
        mesh = distorted(rectangle(5, 4, x=(0, 2)), 0.3, 0)
        found = self.found(mesh, self.cubic)
        np.testing.assert_allclose(found, np.broadcast_to(self.THIRD[..., None], found.shape), atol=1e-7)

    def test_a_quadratic_displacement_has_none(self) -> None:
        assert not np.any(self.found(distorted(rectangle(5, 5), 0.2, 3), quadratic))


class TestRegions:
    def test_jumps_of_the_material_are_recovered_on_each_side(self) -> None:
        mesh = named(rectangle(8, 4, x=(-1, 1)), {}, {"a": lambda x: x[0] < 0, "b": lambda x: x[0] > 0})
        x, y = mesh.p
        values = (np.where(x < 0, x, 5 * x) * y + np.where(x < 0, 2.0, -3.0) * x**2 / 2)[None]
        problem = on(mesh, {"a": Laplace(1.0), "b": Laplace(1.0, 5.0)})
        left, right = recovered_in(DisplacementSpace(problem), mesh.p, values)
        assert (left.law.conductivity, right.law.conductivity) == (1.0, 5.0)
        assert np.intersect1d(left.nodes, right.nodes).size == 5
        for region, expected in ((left, (2.0, 1.0, 0.0)), (right, (-3.0, 5.0, 0.0))):
            assert region.derivatives.shape == (1, 3, 25)
            np.testing.assert_allclose(region.derivatives[0].T - expected, 0.0, atol=1e-9)
            np.testing.assert_array_equal(
                region.nodes[region.triangles], problem.triangles[:, region.elements]
            )
        np.testing.assert_array_equal(np.sort(np.hstack([left.elements, right.elements])), np.arange(64))


class TestRounding:
    def test_a_linear_displacement_has_no_second_derivatives(self) -> None:
        mesh = distorted(rectangle(9, 7), 0.3, 2)
        noise = 1e-14 * np.random.default_rng(0).standard_normal((2, mesh.p.shape[1]))
        values = np.array([[3.0, -1.0], [0.5, 2.0]]) @ mesh.p + 1.0
        assert not np.any(recovered(mesh, values + noise))
        assert not np.any(recovered(mesh, np.zeros_like(values)))

    @pytest.mark.parametrize("scale", [1e-12, 1e12])
    def test_small_second_derivatives_are_none_of_it_in_any_unit(self, scale: float) -> None:
        mesh = rectangle(8, 8)
        found = recovered(mesh, scale * (mesh.p[:1] + 1e-5 * mesh.p[1:] ** 2), Laplace(1.0))[0]
        np.testing.assert_allclose(found[2], 2e-5 * scale, rtol=1e-4)
        np.testing.assert_allclose(found[:2], 0.0, atol=1e-9 * scale)
