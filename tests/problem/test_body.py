"""The domain that a mesh stands for: triangles beside a curve blended to it."""

from __future__ import annotations

import numpy as np
import pytest

from rmesh_nlp.problem.body import Body, gradients
from support.curved import CURVES, plate

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
    found, det = gradients(slopes)
    np.testing.assert_allclose(np.sum(found, axis=0), 0, atol=1e-12)
    product = np.einsum("dvmk,vemk->mkde", slopes, found)  # dx/dx
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-12)
    points = body.points(elements, barycentric)
    np.testing.assert_allclose(points[0], x, atol=1e-12)
    np.testing.assert_allclose(np.broadcast_to(points[1], det.shape), det, atol=1e-12)
