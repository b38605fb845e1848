"""Curves, nodes that slide along them, and triangles blended to arcs."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.cells import Blended
from rmesh_nlp.fem.energy import strain_energy
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline, fitted_circle, spline_through
from rmesh_nlp.models.levels import coarsened
from rmesh_nlp.problem.body import Body, determinants, gradients
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from support.curved import CURVES, HOLE, disc, plate, spline_of_the_hole
from support.formulations import auto, joint, mpcc, nested

ARC = Circle((0.0, 1.0), 1.0)


def off(problem: rm.ContactProblem, mesh: Any, name: str, circle: Circle) -> float:
    """Largest distance of a boundary's nodes from a circle."""
    away = mesh.p[:, problem.boundary_nodes(name)] - np.array(circle.centre)[:, None]
    return float(np.max(np.abs(np.hypot(*away) - circle.radius)))


def moved(problem: rm.ContactProblem, solution: rm.Solution, name: str) -> float:
    nodes = problem.boundary_nodes(name)
    return float(np.max(np.abs(solution.mesh.p[:, nodes] - problem.mesh.p[:, nodes])))


def test_outer_variables_are_found_again_and_limits_are_lengths_of_the_curve() -> None:
    problem = plate({"hole": HOLE}, delta=0.3)
    free, hole = MeshMap.of(problem), problem.boundary_nodes("hole")
    q = np.random.default_rng(0).uniform(-1, 1, free.n)
    np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)
    assert np.all(free.mobility[hole] == Mobility.SLIDING)
    there, here = (
        np.arctan2(*(p[:, hole] - 5)[::-1]) for p in (free.positions.values(np.ones(free.n)), problem.mesh.p)
    )
    np.testing.assert_allclose(2.5 * np.angle(np.exp(1j * (there - here))), 0.3)


def test_refined_and_coarsened_meshes_have_their_nodes_on_the_curve() -> None:
    problem = plate({"hole": HOLE}, h=0.6)
    fine, local, coarse = refined(problem), locally_refined(problem, np.arange(40)), coarsened(problem, 30)
    assert max(off(other, other.mesh, "hole", HOLE) for other in (fine, local, coarse)) < 1e-12
    assert coarse.boundary_nodes("hole").size < problem.boundary_nodes("hole").size
    assert set(fine.motion.curves) == {"hole"}


@pytest.mark.slow
def test_formulations_agree_on_the_circle_and_gain_more_than_with_the_hole_fixed() -> None:
    problem, still = plate({"hole": HOLE}, delta=0.15), plate(delta=0.15)
    found, without = [one.solve(problem) for one in (joint, nested, mpcc)], joint.solve(still)
    for solution in found:
        assert solution.status.value == "converged"
        assert off(problem, solution.mesh, "hole", HOLE) < 1e-12
        assert solution.energy_initial - solution.energy > 1.1 * (without.energy_initial - without.energy)
        np.testing.assert_allclose(solution.energy, found[0].energy, rtol=1e-8)
    assert moved(problem, found[0], "hole") > 0.05
    assert moved(still, without, "hole") == 0


@pytest.mark.slow
def test_auto_slides_along_the_arc_of_a_disc() -> None:
    problem = disc({"arc": ARC})
    solution = auto.solve(problem)
    assert solution.success
    assert off(problem, solution.mesh, "arc", ARC) < 1e-12
    assert moved(problem, solution, "arc") > 1e-3
    assert solution.record()["error_reduction"]["factor"] > 1.35


HALF = 0.5
"""Half the angle of an arc of the unit circle. The tangents at its ends meet at the distance 1.14."""


@pytest.mark.parametrize("order", [1, 2])
def test_a_triangle_that_its_arc_folds_has_no_energy(order: int) -> None:
    """So a solver shortens its steps to there, and does not find the minus infinity behind."""
    energy = strain_energy(rm.Laplace(), Blended(Circle((0.0, 0.0), 1.0), 1, order))
    u = np.arange(float(energy.size1_in(2)))
    for apex, upright in ((1.3, True), (1.7, True), (1.1, False), (0.9, False)):
        found = float(energy([HALF, -HALF], [apex, 0.0], u)[0])
        assert bool(np.isfinite(found)) is upright


@pytest.mark.slow
def test_relocation_of_order_2_beside_a_hole_is_not_lost_in_folded_triangles() -> None:
    solution = joint.solve(replace(plate({"hole": HOLE}), order=2))
    assert solution.status is rm.Status.CONVERGED
    assert solution.assessment.gain_audited > 0.03


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
    ends = np.array([low, high - 1e-7])  # the end itself is taken for the beginning
    for function in (spline.at, spline.velocity):
        value = function(ends)
        np.testing.assert_allclose(value[:, 0], value[:, 1], atol=1e-6)
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
    assert around.points == ((0, 0), (3, 0), (2, 1), (1, 1))


TWO_LINES, TWO_LOOPS = [[0, 1, 4, 5], [1, 2, 5, 6]], [[0, 1, 2, 4, 5, 6], [1, 2, 0, 5, 6, 4]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Circle((0.0, 0.0), 0.0), "radius must be positive"),
        (lambda: Circle((0.0, np.inf), 1.0), "centre must be two finite numbers"),
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
def test_bad_curves_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


RADIUS, CENTRE = 2.5, np.array([[5.0], [5.0]])


@pytest.fixture(scope="module", params=CURVES)
def body(request: pytest.FixtureRequest) -> Body:
    problem = plate({"hole": CURVES[request.param]})
    return Body(problem, problem.mesh.p)


def everywhere(body: Body, n: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """All elements, and barycentric coordinates (3, elements, n) of random points."""
    elements = np.arange(body.triangles.shape[1])
    points = np.random.default_rng(0).dirichlet([1, 1, 1], (elements.size, n))
    return elements, points.transpose(2, 0, 1)


def test_blended_triangles_end_on_the_curve(body: Body) -> None:
    assert body.is_upright()
    edges, s = body.edges("hole"), np.linspace(0, 1, 7)
    x, speed = edges.at(np.arange(edges.size), np.broadcast_to(s, (edges.size, s.size)))
    np.testing.assert_allclose(np.linalg.norm(x - CENTRE[..., None], axis=0), RADIUS, rtol=1e-12)
    assert np.mean(speed, axis=1).sum() == pytest.approx(2 * np.pi * RADIUS, rel=1e-12)
    curved = np.flatnonzero(body.is_curved)
    assert curved.size == edges.size
    side = np.zeros((3, curved.size, 7))  # from the vertex after the apex to the next one
    for turn, part in ((1, 1 - s), (2, s)):
        side[(body.apex[curved] + turn) % 3, np.arange(curved.size)] = part
    there = body.at(curved, side)[0]
    np.testing.assert_allclose(np.linalg.norm(there - CENTRE[..., None], axis=0), RADIUS, rtol=1e-12)


def test_slopes_are_derivatives_and_gradients_their_inverse(body: Body) -> None:
    elements, barycentric = everywhere(body)
    x, slopes = body.at(elements, barycentric)
    step = np.array([1.0, -0.4, -0.6])[:, None, None] * 1e-6
    difference = (body.at(elements, barycentric + step)[0] - body.at(elements, barycentric - step)[0]) / 2
    np.testing.assert_allclose(np.sum(slopes * step, axis=1), difference, atol=1e-11)
    found = gradients(slopes)
    np.testing.assert_allclose(np.sum(found, axis=1), 0, atol=1e-12)
    product = np.einsum("dvmk,evmk->mkde", slopes, found)  # dx/dx
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-12)
    points, det = body.points(elements, barycentric)
    np.testing.assert_allclose(points, x, atol=1e-12)
    expected = determinants(slopes)
    np.testing.assert_allclose(np.broadcast_to(det, expected.shape), expected, atol=1e-12)
