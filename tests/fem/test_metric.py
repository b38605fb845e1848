"""Recovered derivatives, errors of interpolation, and the metric of the best mesh."""

from dataclasses import replace
from math import factorial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import MeshTri
from skfem.quadrature import get_quadrature_tri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem import recovery
from rmesh_nlp.fem.interpolation_error import best_shapes, errors, isotropic_errors, least_errors, stretched
from rmesh_nlp.fem.metric import FLOOR, best_metric, nodal_areas
from rmesh_nlp.fem.recovery import RINGS, Recovered
from rmesh_nlp.fem.recovery import recovered as recovered_in
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes import from_arrays, named
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import NO_CONTACT, ContactProblem, Laplace, PlaneStrain, PlaneStress
from rmesh_nlp.problem.laws import Law
from support.certificates import distorted

MESH = rectangle(4, 2, x=(0, 2))
P, T = np.asarray(MESH.p), counter_clockwise(MESH.p, MESH.t)
LEFT, RIGHT = (np.flatnonzero((P[0, T].mean(axis=0) < 1) == side) for side in (True, False))
LAW = Laplace(conductivity=2.0)


def region(second: Array, elements: Array | None = None, law: Law = LAW) -> Recovered:
    """With the same second derivatives (3,) at all nodes, or given ones (3, nodes)."""
    chosen = np.arange(T.shape[1]) if elements is None else elements
    nodes, flat = np.unique(T[:, chosen], return_inverse=True)
    values = np.broadcast_to(second[:, None] if second.ndim == 1 else second[:, nodes], (3, nodes.size))
    return Recovered(law, chosen, nodes, flat.reshape(3, -1), np.array(values[None]))


def lengths(tensor: Array, edges: Array) -> Array:
    a, b, c = tensor
    return np.asarray(np.sqrt(a * edges[0] ** 2 + 2 * b * edges[0] * edges[1] + c * edges[1] ** 2))


SECONDS = [np.array([1.0, 0.4, -0.5]), np.array([2.0, -1.0, 3.0]), np.array([0.0, 0.0, 5.0])]


@pytest.mark.parametrize("second", SECONDS)
def test_a_triangle_of_the_best_shape_and_of_its_area_is_equilateral_with_edges_of_one(second: Array) -> None:
    metric = best_metric(P, [region(second)]).with_triangles(321.0)
    (stretch,), (angle,), _ = best_shapes(LAW, second[None, :, None])
    for turn in (0.0, 0.3, 1.0):
        corners = stretched(np.array([stretch]), np.array([angle]), turn)[..., 0]
        for tensor, density in zip(metric.tensors.T, metric.density, strict=True):
            edges = (corners - np.roll(corners, 1, axis=1)) / np.sqrt(density)
            np.testing.assert_allclose(lengths(tensor, edges), 1.0, rtol=1e-9)


@pytest.mark.parametrize("number", [1.0, 50.0, 1e6])
def test_number_of_triangles_is_density_times_area(number: float) -> None:
    given = best_metric(P, [region(np.vstack([P[0] ** 2, P[1], 1 + P[0]]))])
    metric = given.with_triangles(number)
    corner = np.flatnonzero((P[0] == 0) & (P[1] == 0))[0]
    assert metric.weights[corner] == pytest.approx(np.count_nonzero(corner == T) * 0.125 / 3)
    assert metric.triangles == pytest.approx(number)
    assert metric.weights @ metric.density == pytest.approx(number)
    assert metric.weights.sum() == pytest.approx(2.0)
    np.testing.assert_allclose(metric.density / metric.density[0], given.density / given.density[0])
    np.testing.assert_array_equal(metric.logarithm, given.logarithm)


def test_all_triangles_have_the_same_error_but_for_the_floor() -> None:
    """On either side of a jump of the material."""
    second, stiff = np.vstack([1 + 5 * P[0] ** 2, 0 * P[0], -0.5 - P[0]]), Laplace(conductivity=2.0 * 9)
    metric = best_metric(P, [region(second, LEFT), region(second, RIGHT, stiff)])
    mean = metric.triangles / 2.0 / (1 + FLOOR)  # per area, without the floor
    for law, side in ((LAW, P[0] < 1), (stiff, P[0] > 1)):
        of_side = second[None][..., side]
        stretch, angle, _ = best_shapes(law, of_side)
        area = 1 / (metric.density[side] - FLOOR * mean)
        found = [
            errors(law, np.sqrt(area) * stretched(stretch, angle, turn), of_side)
            for turn in (0.1, 0.1 + np.pi / 6)
        ]
        np.testing.assert_allclose(np.mean(found, axis=0), 1.0, rtol=1e-9)
        assert np.ptp(area) > 0.3 * area.max()


def test_where_the_displacement_is_linear_there_are_few_but_some() -> None:
    second = np.where(P[0] < 1, 1.0, 0.0) * np.array([[1.0], [0.0], [1.0]])
    metric = best_metric(P, [region(second)])
    mean = metric.triangles / 2.0
    np.testing.assert_allclose(metric.density[P[0] >= 1], FLOOR / (1 + FLOOR) * mean, rtol=1e-9)
    assert np.all(metric.density[P[0] < 1] > mean)


def test_at_an_interface_it_is_the_mean_of_both_sides_by_area() -> None:
    """Of the logarithms: long across and long along give round."""
    one, two = np.array([4.0, 0.0, 1.0]), np.array([1.0, 0.0, 4.0])
    metric = best_metric(P, [region(one, LEFT), region(two, RIGHT)])
    a, b = best_metric(P, [region(one)]), best_metric(P, [region(two)])
    left, right = P[0] < 1, P[0] > 1
    np.testing.assert_allclose(metric.logarithm[:, left], a.logarithm[:, left])
    np.testing.assert_allclose(metric.logarithm[:, right], b.logarithm[:, right])
    share = np.zeros(P.shape[1])
    np.add.at(share, T[:, LEFT], np.full((3, LEFT.size), 1 / 24))
    part = share[P[0] == 1] / nodal_areas(P, T)[P[0] == 1]
    assert np.ptp(part) > 0.1  # not a half everywhere
    mean = part * a.logarithm[:, P[0] == 1] + (1 - part) * b.logarithm[:, P[0] == 1]
    np.testing.assert_allclose(metric.logarithm[:, P[0] == 1], mean, atol=1e-12)
    np.testing.assert_allclose(metric.logarithm[0], -metric.logarithm[2])
    half = np.isclose(part, 0.5)
    assert np.any(half)
    np.testing.assert_allclose(metric.logarithm[:, P[0] == 1][:, half], 0.0, atol=1e-12)


def test_evened_keeps_a_part_of_the_differences() -> None:
    metric = best_metric(P, [region(np.vstack([1 + P[0], 0 * P[0], -4.0 - P[1]]))])
    for part in (1.0, 0.5, 0.0):
        found = metric.evened(part).with_triangles(100.0)
        np.testing.assert_allclose(found.logarithm, part * metric.logarithm)
        rise = np.log(metric.density[-1] / metric.density[0])
        assert np.log(found.density[-1] / found.density[0]) == pytest.approx(part * rise)
        assert found.triangles == pytest.approx(100.0)
    np.testing.assert_allclose(np.ptp(found.tensors, axis=1), 0.0, atol=1e-9)  # of the last part, zero


LAWS: dict[str, Law] = {
    "laplace": Laplace(conductivity=2.5),
    "plane strain": PlaneStrain(1.3, 0.7),
    "negative lambda": PlaneStrain(-0.3, 0.7),
    "plane stress": PlaneStress.from_young(2.0, 0.3),
}


def drawn(n: int, components: int, seed: int = 0, degree: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Upright triangles (2, 3, n) and derivatives (components, degree + 1, n)."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (2, 3, n))
    (ax, ay), (bx, by) = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    wrong = ax * by < ay * bx
    corners[:, :, wrong] = corners[:, ::-1, wrong]
    return corners, rng.standard_normal((components, degree + 1, n))


def diagonal(ratio: float, size: float = 1.0) -> np.ndarray:
    return size * np.array([[[1.0], [0.0], [ratio]]])


def on_grid(law: Law, second: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """(shapes, turns, n) errors on triangles of many stretches and angles."""
    n, stretch, angle = second.shape[2], np.linspace(0, np.log(64) / 2, 40), np.arange(40) * np.pi / 40
    point = np.meshgrid(stretch, angle, turns, np.arange(n), indexing="ij")
    s, a, t, which = (one.ravel() for one in point)
    found = errors(law, stretched(s, a, t), second[:, :, which])
    return found.reshape(-1, turns.size, n)


def energy_of_interpolation_error(law: Law, corners: np.ndarray, derivatives: np.ndarray) -> float:
    """Of one triangle (2, 3): a polynomial less its interpolant through vertices, and middles of edges."""
    degree = derivatives.shape[1] - 1
    x, y, s, t = (ca.SX.sym(name) for name in ("x", "y", "s", "t"))
    u = [
        sum(
            D[j] * x ** (degree - j) * y**j / (factorial(degree - j) * factorial(j))
            for j in range(degree + 1)
        )
        for D in derivatives
    ]
    exact = ca.Function("u", [x, y], [ca.vertcat(*u)])
    places = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    terms = [ca.SX(1), s, t]
    if degree == 3:
        places += [(0.5, 0.0), (0.5, 0.5), (0.0, 0.5)]
        terms += [s * s, s * t, t * t]
    basis = ca.Function("basis", [s, t], [ca.horzcat(*terms)])
    edges = corners[:, 1:] - corners[:, :1]
    values = ca.vertcat(*[exact(*(corners[:, 0] + edges @ place)).T for place in places])
    weights = ca.solve(ca.vertcat(*[basis(*place) for place in places]), values)
    point = corners[:, 0] + ca.DM(edges) @ ca.vertcat(s, t)
    error = exact(point[0], point[1]) - (basis(s, t) @ weights).T
    slope = ca.jacobian(error, ca.vertcat(s, t)) @ ca.DM(np.linalg.inv(edges))
    density = ca.Function("density", [s, t], [law.energy_density(slope)])
    rule = get_quadrature_tri(6)
    total = sum(weight * float(density(*place)) for place, weight in zip(rule[0].T, rule[1], strict=True))
    return total * abs(np.linalg.det(edges))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("degree", [2, 3])
def test_errors_are_the_energy_of_what_interpolation_leaves(name: str, degree: int) -> None:
    law = LAWS[name]
    corners, D = drawn(6, law.components, degree=degree)
    expected = [energy_of_interpolation_error(law, corners[:, :, i], D[:, :, i]) for i in range(6)]
    np.testing.assert_allclose(errors(law, corners, D), expected, rtol=1e-9)


class TestBestShapes:
    @pytest.mark.parametrize("name", LAWS)
    def test_nothing_on_a_fine_grid_of_shapes_is_better(self, name: str) -> None:
        law = LAWS[name]
        second = drawn(10, law.components, 3)[1]
        second[..., 0] = diagonal(0.001)[0, :, 0]  # one direction only
        stretch, angle, found = best_shapes(law, second)
        means = np.mean(
            [
                errors(law, stretched(stretch, angle, turn), second)
                for turn in np.linspace(0, 2 * np.pi / 3, 7)[:-1]
            ],
            axis=0,
        )
        np.testing.assert_allclose(found, means, rtol=1e-10)  # over all turns
        least = on_grid(law, second, np.array([0.2, 0.2 + np.pi / 6])).mean(axis=1).min(axis=0)
        assert np.all(found <= 1.005 * least)

    def test_aspect_ratio_is_limited(self) -> None:
        second = drawn(6, 1, 4)[1]
        second[..., 0] = diagonal(0.0)[0, :, 0]
        free = best_shapes(Laplace(), second)
        stretch, _, found = best_shapes(Laplace(), second, 1.5)
        assert np.exp(2 * stretch).max() <= 1.5 * (1 + 1e-12)
        assert np.exp(2 * stretch[0]) == pytest.approx(1.5)
        assert np.exp(2 * free[0][0]) == pytest.approx(64.0)
        assert np.all(found >= free[2] * (1 - 1e-9))
        stretch, _, found = best_shapes(Laplace(), second, 1.0)
        assert not np.any(stretch)
        np.testing.assert_allclose(found, isotropic_errors(Laplace(), second), rtol=1e-12)


class TestLeastErrors:
    @pytest.mark.parametrize("name", LAWS)
    def test_are_ordered_and_no_triangle_is_better(self, name: str) -> None:
        law = LAWS[name]
        second = drawn(6, law.components, 5)[1]
        stretch, angle, mean = best_shapes(law, second)
        least = least_errors(law, second, stretch, angle)
        assert np.all(least <= mean * (1 + 1e-12))
        assert np.all(mean <= isotropic_errors(law, second) * (1 + 1e-12))
        grid = on_grid(law, second, np.arange(8) * np.pi / 24).min(axis=(0, 1))
        assert np.all(least <= 1.03 * grid)


@pytest.mark.parametrize("degree", [2, 3])
def test_density_follows_the_root_of_the_error_of_its_degree(degree: int) -> None:
    """Errors are quadratic in the derivatives, and fall like the size of triangles to twice the degree."""
    values = np.linspace(1.0, 2.0, degree + 1)

    def density(factor: float) -> Array:
        nodes = np.arange(P.shape[1])
        derivatives = np.broadcast_to(factor * values[:, None], (degree + 1, nodes.size))
        part = Recovered(LAW, np.arange(T.shape[1]), nodes, T, np.array(derivatives[None]))
        return best_metric(P, [part]).density

    np.testing.assert_allclose(density(8.0), 8.0 ** (2 / degree) * density(1.0), rtol=1e-9)


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
