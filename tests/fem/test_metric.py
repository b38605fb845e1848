"""The metric of the best mesh: shapes, density, interfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.interpolation_error import best_shapes, errors, stretched
from rmesh_nlp.fem.metric import FLOOR, Metric, best_metric, nodal_areas
from rmesh_nlp.fem.recovery import Recovered
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import Laplace
from rmesh_nlp.problem.laws import Law

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
    second = np.vstack([1 + 5 * P[0] ** 2, 0 * P[0], -0.5 - P[0]])
    metric = best_metric(P, [region(second)])
    stretch, angle, _ = best_shapes(LAW, second[None])
    mean = metric.triangles / 2.0 / (1 + FLOOR)  # per area, without the floor
    area = 1 / (metric.density - FLOOR * mean)
    found = [
        errors(LAW, np.sqrt(area) * stretched(stretch, angle, turn), second[None])
        for turn in (0.1, 0.1 + np.pi / 6)
    ]
    np.testing.assert_allclose(np.mean(found, axis=0), 1.0, rtol=1e-9)
    assert np.ptp(area) > 0.5 * area.max()


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


def test_density_jumps_with_the_material() -> None:
    second = np.array([1.0, 0.0, 1.0])
    stiff = region(second, RIGHT, Laplace(conductivity=2.0 * 9))
    metric = best_metric(P, [region(second, LEFT), stiff])
    floor = FLOOR / (1 + FLOOR) * metric.triangles / 2.0
    left, right = (metric.density[side][0] - floor for side in (P[0] < 1, P[0] > 1))
    assert right / left == pytest.approx(3.0)


def test_evened_keeps_a_part_of_the_differences() -> None:
    metric = best_metric(P, [region(np.vstack([1 + P[0], 0 * P[0], -4.0 - P[1]]))])
    for part in (1.0, 0.5, 0.0):
        found = metric.evened(part).with_triangles(100.0)
        np.testing.assert_allclose(found.logarithm, part * metric.logarithm)
        rise = np.log(metric.density[-1] / metric.density[0])
        assert np.log(found.density[-1] / found.density[0]) == pytest.approx(part * rise)
        assert found.triangles == pytest.approx(100.0)
    np.testing.assert_allclose(
        np.ptp(metric.evened(0.0).with_triangles(100.0).tensors, axis=1), 0.0, atol=1e-9
    )


def test_without_second_derivatives_it_is_uniform_and_round() -> None:
    metric = best_metric(P, [region(np.zeros(3))]).with_triangles(200.0)
    np.testing.assert_allclose(metric.density, 100.0)
    np.testing.assert_allclose(metric.tensors[1], 0.0)
    np.testing.assert_allclose(metric.tensors[[0, 2]], np.sqrt(3) / 4 * 100.0)


def test_a_node_of_no_triangle_does_no_harm() -> None:
    more = np.hstack([P, [[9.0], [9.0]]])
    metric = best_metric(more, [region(SECONDS[0])])
    assert np.all(np.isfinite(metric.tensors))
    assert metric.weights[-1] == 0
    same = best_metric(P, [region(SECONDS[0])])
    np.testing.assert_allclose(metric.tensors[:, :-1], same.tensors)


def test_tensors_of_a_round_metric_are_multiples_of_the_identity() -> None:
    one = Metric(np.zeros((3, 2)), np.array([1.0, 4.0]), np.ones(2))
    np.testing.assert_allclose(one.tensors, np.sqrt(3) / 4 * np.array([[1, 4], [0, 0], [1, 4]]))
    tall = replace(one, logarithm=np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]))
    expected = np.array([[np.e, 4 * np.cosh(1)], [0, 4 * np.sinh(1)], [1 / np.e, 4 * np.cosh(1)]])
    np.testing.assert_allclose(tall.tensors, np.sqrt(3) / 4 * expected)
