"""Projections on boxes cut by linear rows, their faces, and multipliers by least squares."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize

from rmesh_nlp.optimize import constraints
from rmesh_nlp.optimize.constraints import Linearised, Polyhedron, nonnegative_fit


def random_polyhedron(rng: np.random.Generator, n: int = 30, rows: int = 25) -> Polyhedron:
    """Rows with six entries each, as of triangles, through or near 0."""
    jacobian = np.zeros((rows, n))
    for row in jacobian:
        row[rng.choice(n, 6, replace=False)] = rng.standard_normal(6)
    slack = np.maximum(rng.uniform(-0.3, 0.5, rows), 0.0)
    return Polyhedron(-rng.random(n), rng.random(n), slack, sp.csr_array(jacobian), rng.uniform(0.1, 10, n))


@pytest.mark.parametrize("seed", range(3))
def test_a_projection_is_that_of_another_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = random_polyhedron(rng)
    d = 2 * rng.standard_normal(steps.scale.size)
    near = steps.nearest(d)
    other = minimize(
        lambda y: 0.5 * (y - d) @ (steps.scale * (y - d)),
        np.zeros(d.size),
        jac=lambda y: steps.scale * (y - d),
        bounds=list(zip(steps.lower, steps.upper, strict=True)),
        constraints={"type": "ineq", "fun": lambda y: steps.slack + steps.jacobian @ y},
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    np.testing.assert_allclose(near, other.x, atol=1e-6)
    assert steps.active(near).size > 0
    np.testing.assert_allclose(steps.nearest(0.99 * near), 0.99 * near, atol=1e-12)


def test_a_face_holds_its_rows_and_fits_their_multipliers() -> None:
    rng = np.random.default_rng(3)
    steps = random_polyhedron(rng)
    rows, inside = np.arange(4), rng.random(steps.scale.size) < 0.8
    face, r = steps.face(rows, inside), rng.standard_normal(steps.scale.size)
    direction = face.precondition(r)
    np.testing.assert_allclose(steps.jacobian[rows] @ direction, 0, atol=1e-8)
    assert np.all(direction[~inside] == 0)
    pull = np.array([1.0, 0.5, 2.0, 0.1])
    np.testing.assert_allclose(face.multipliers(steps.jacobian[rows].T @ pull), pull, rtol=1e-7)
    np.testing.assert_allclose(steps.face(rows[:0], inside).precondition(r), inside * r / steps.scale)


@pytest.mark.parametrize("largest", [constraints.LARGEST_DENSE, 0])
def test_multipliers_are_not_negative_and_of_active_rows_alone(
    largest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constraints, "LARGEST_DENSE", largest)
    jacobian = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 5.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    rows = Linearised(np.array([0.0, 5e-5, 2e-4, 0.0]), np.zeros(4), sp.csr_array(jacobian))
    inside = np.array([True, True, False])
    found = rows.fitted(np.array([2.0, 3.0, 99.0]), inside)
    np.testing.assert_allclose(found[[1, 2]], [3.0, 0.0], atol=1e-8)
    assert found[0] + found[3] == pytest.approx(2.0)
    np.testing.assert_allclose(rows.fitted(np.array([-2.0, -3.0, 9.0]), inside), 0.0, atol=1e-8)
    np.testing.assert_allclose(
        nonnegative_fit(sp.csr_array(np.eye(2)), np.array([1.0, -1.0])), [1, 0], atol=1e-8
    )
