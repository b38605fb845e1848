"""Curves along which nodes slide."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.meshes.curves import (
    Circle,
    Curve,
    Parametrised,
    Spline,
    fitted_circle,
    on_values,
    spline_through,
)
from support.curved import HOLE, spline_of_the_hole

ELLIPSE = Parametrised(lambda t: 2 * ca.cos(t), lambda t: ca.sin(t), (0.0, 2 * np.pi), closed=True)
ARCH = Spline(((0.0, 0.0), (1.0, 0.5), (2.0, 0.6), (3.0, 0.1)))


@pytest.mark.parametrize("curve", [HOLE, ELLIPSE, ARCH, spline_of_the_hole()])
def test_the_nearest_point_is_nearer_than_any_sample_and_at_a_right_angle(curve: Curve) -> None:
    rng = np.random.default_rng(0)
    low, high = curve.interval
    t0 = rng.uniform(low + 0.1, high - 0.1, 30)
    points = curve.at(t0) + 0.05 * rng.standard_normal((2, 30))
    t = curve.nearest(points)
    off = curve.at(t) - points
    samples = curve.at(np.linspace(low, high, 500))
    nearest = np.min(np.linalg.norm(samples[:, :, None] - points[:, None, :], axis=0), axis=0)
    assert np.all(np.linalg.norm(off, axis=0) <= nearest + 1e-12)
    inside = curve.closed | ((t > low) & (t < high))
    cosine = np.sum(off * curve.velocity(t), axis=0) / np.linalg.norm(curve.velocity(t), axis=0)
    assert np.max(np.abs(cosine[inside])) < 1e-10
    np.testing.assert_allclose(curve.at(curve.nearest(curve.at(t0))), curve.at(t0), atol=1e-13)
    step = 1e-5
    slope = (curve.at(t0 + step) - curve.at(t0 - step)) / (2 * step)
    np.testing.assert_allclose(curve.velocity(t0), slope, rtol=1e-6, atol=1e-8)


def test_near_crosses_the_place_where_a_closed_curve_begins() -> None:
    before, beyond = np.array([np.pi - 0.1]), np.array([np.pi + 0.1])
    np.testing.assert_allclose(HOLE.near(HOLE.at(beyond), before), beyond)


def test_a_spline_passes_through_its_points_at_about_unit_speed() -> None:
    for spline in (ARCH, spline_of_the_hole()):
        points = np.array(spline.points).T
        np.testing.assert_allclose(spline.at(spline.nearest(points)), points, atol=1e-13)
        speed = np.linalg.norm(spline.velocity(np.linspace(*spline.interval, 100)), axis=0)
        assert speed.min() > 0.9
        assert speed.max() < 1.1


def test_a_closed_spline_goes_on_smoothly_where_it_begins() -> None:
    spline = spline_of_the_hole()
    low, high = spline.interval
    ends = np.array([low, high])
    for function in (spline.at, spline.velocity):
        value = function(ends)
        np.testing.assert_allclose(value[:, 0], value[:, 1], atol=1e-9)
        beyond = function(np.array([high + 0.3, low + 0.3]))
        np.testing.assert_allclose(beyond[:, 0], beyond[:, 1], atol=1e-9)


def test_a_circle_is_fitted_to_nodes_of_an_arc() -> None:
    circle = Circle((1.0, -2.0), 3.0)
    found = fitted_circle(circle.at(np.linspace(0.2, 0.9, 8)))
    np.testing.assert_allclose([*found.centre, found.radius], [1, -2, 3], atol=1e-10)


def test_a_spline_is_laid_through_the_nodes_of_a_boundary_in_their_order() -> None:
    points = np.array([[0.0, 3, 1, 2], [0, 0, 1, 1]])
    spline = spline_through(points, np.array([[1, 0, 2], [3, 2, 3]]))
    assert not spline.closed
    assert spline.points == ((0, 0), (1, 1), (2, 1), (3, 0))
    around = spline_through(points, np.array([[1, 0, 2, 0], [3, 2, 3, 1]]))
    assert around.closed
    assert around.points == ((0, 0), (1, 1), (2, 1), (3, 0))


TWO_LINES, TWO_LOOPS = [[0, 1, 4, 5], [1, 2, 5, 6]], [[0, 1, 2, 4, 5, 6], [1, 2, 0, 5, 6, 4]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Circle((0.0, 0.0), 0.0), "positive radius"),
        (lambda: Circle((0.0, np.inf), 1.0), "finite centre"),
        (lambda: Spline(((0.0, 0.0), (1.0, 1.0), (2.0, 0.0))), "four or more"),
        (lambda: Spline(((0.0, 0.0), (1.0, 1.0), (1.0, 1.0), (2.0, 0.0))), "follow each other are the same"),
        (lambda: Spline(((0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (0.0, 0.0)), closed=True), "are the same"),
        (lambda: Parametrised(lambda t: t, lambda t: t, (1.0, 1.0)), "must increase"),
        (lambda: Parametrised(ca.sqrt, lambda t: t, (-1.0, 1.0)), "must be finite over its interval"),
        (lambda: Parametrised(lambda t: t, lambda t: t, (0.0, 1.0), closed=True), "where it begins"),
        (lambda: fitted_circle(np.array([[0.0, 1, 2, 3], [0, 1, 2, 3]])), "straight line"),
        (lambda: fitted_circle(np.zeros((2, 2))), "to 2 nodes"),
        (lambda: spline_through(np.zeros((2, 8)), np.array(TWO_LINES)), "one piece"),
        (lambda: spline_through(np.zeros((2, 8)), np.array(TWO_LOOPS)), "one piece"),
        (lambda: spline_through(np.zeros((2, 8)), np.array([[0, 1, 1], [1, 2, 3]])), "without branches"),
    ],
)
def test_bad_curves_are_refused(make: Callable[[], Curve], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("n", [0, 1, 7, 3000])
def test_values_of_a_function_are_those_one_by_one(kind: type, n: int) -> None:
    t, at = kind.sym("t"), np.linspace(-2, 3, n)
    function = ca.Function("f", [t], [ca.cos(t) + ca.if_else(t > 1, t**2, 1)])
    np.testing.assert_allclose(on_values(function, at), [float(function(one)) for one in at], rtol=1e-14)
