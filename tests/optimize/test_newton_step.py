"""One step in a box or polyhedron: projections, multipliers, factorisations as preconditioners."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize import constraints
from rmesh_nlp.optimize.constraints import Linearised, Polyhedron, nonnegative_fit
from rmesh_nlp.optimize.newton_step import BoxStep, ConstrainedStep, Shifted, positive_definite
from support.quadratics import Matrix, convex


def stiff(n: int) -> Array:
    """Positive definite, with a condition number of about 1e4 that no diagonal mends."""
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return matrix @ matrix


def factorised(matrix: Array, n: int) -> Shifted:
    found = positive_definite(sp.csc_array(matrix), n)
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_predicted_decrease_is_that_of_the_model_and_the_step_is_stationary(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, g, upper = convex(rng, 15), rng.standard_normal(15), rng.uniform(0.01, 1, 15)
    step = BoxStep(Matrix(A), g, max_products=400)
    s, predicted = step.within(-upper, upper, 1e-9)
    assert step.rows_active(s) == 0  # bounds are no rows: they never hold the radius back
    assert predicted == pytest.approx(-(g @ s + 0.5 * s @ A @ s), rel=1e-9)
    assert predicted > 0
    assert np.all(np.abs(s) <= upper)


def test_a_limit_of_products_is_kept() -> None:
    rng = np.random.default_rng(0)
    A, g, wide = convex(rng, 30), rng.standard_normal(30), np.full(30, 1e3)
    free, short = BoxStep(Matrix(A), g), BoxStep(Matrix(A), g, max_products=5)
    for step in (free, short):
        step.within(-wide, wide, 1e-8)
    assert short.products <= 6 < free.products  # one more for the search that ends a round


def test_a_constrained_step_ends_on_the_rows_with_their_multipliers() -> None:
    # nearest point of the half plane x + y <= 1 to (1, 2): (0, 1), multiplier 1
    rows = Linearised(np.array([1.0]), np.zeros(1), sp.csr_array([[-1.0, -1.0]]))
    step = ConstrainedStep(Matrix(np.eye(2)), -np.array([1.0, 2.0]), rows)
    s, predicted = step.within(-np.full(2, 9.0), np.full(2, 9.0), 1e-8)
    np.testing.assert_allclose(s, [0.0, 1.0], atol=1e-5)
    assert predicted == pytest.approx(2 - 0.5, rel=1e-4)
    np.testing.assert_allclose(step.multipliers(s), [1.0], atol=1e-3)
    np.testing.assert_array_equal(step.multipliers(np.zeros(2)), [0.0])
    assert [step.rows_active(at) for at in (s, np.zeros(2))] == [1, 0]


@pytest.mark.parametrize("seed", range(3))
def test_an_indefinite_matrix_is_shifted_until_its_inverse_is_positive_definite(seed: int) -> None:
    rng, n, m = np.random.default_rng(seed), 6, 10
    matrix = rng.standard_normal((m, m))
    matrix = matrix + matrix.T
    matrix[n:, n:] += (1 - np.linalg.eigvalsh(matrix[n:, n:]).min()) * np.eye(m - n)
    matrix[:n, :n] -= 3 * np.eye(n)
    found, unit = factorised(matrix, n), np.mean(np.abs(np.diag(matrix)[:n]))

    def shifted(shift: float) -> Array:
        return matrix + np.diag(np.r_[np.full(n, shift * unit), np.zeros(m - n)])

    inverse = np.column_stack([found(e) for e in np.eye(n)])
    np.testing.assert_allclose(inverse, np.linalg.inv(shifted(found.shift))[:n, :n], atol=1e-9)
    assert np.linalg.eigvalsh(inverse).min() > 0
    # it is the least shift of the sequence 1e-3, 1e-2, ...
    assert found.shift == pytest.approx(1e-3 * 10.0 ** (found.factorisations - 2))
    assert np.linalg.eigvalsh(shifted(found.shift / 10 if found.shift > 1e-3 else 0)).min() <= 0


def test_a_good_preconditioner_saves_products_and_gives_the_same_minimum_in_a_box() -> None:
    n = 40
    model, g = Matrix(stiff(n)), np.random.default_rng(0).standard_normal(n)
    factor, wide, narrow = factorised(model.A, n), np.full(n, 1e6), np.full(n, 0.3)
    step, plain = BoxStep(model, g, factor), BoxStep(model, g)
    s, _ = step.within(-wide, wide, 1e-8)
    np.testing.assert_allclose(s, -np.linalg.solve(model.A, g), rtol=1e-6)
    plain.within(-wide, wide, 1e-8)
    assert step.products < plain.products / 3
    inside, decrease = BoxStep(model, g, factor).within(-narrow, narrow, 1e-6)
    assert np.all(np.abs(inside) <= narrow)
    assert decrease == pytest.approx(-(g @ inside + 0.5 * inside @ model.A @ inside))
    assert decrease > 0


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
def test_multipliers_are_not_negative_and_of_active_rows_alone(largest, monkeypatch) -> None:
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
