"""One step in a box: products, factorisations as preconditioners; multipliers of constraints."""

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize import constraints
from rmesh_nlp.optimize.constraints import Linearised, nonnegative_fit
from rmesh_nlp.optimize.newton_step import BoxStep, Shifted, positive_definite
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


@pytest.mark.parametrize("largest", [constraints.LARGEST_DENSE, 0])
def test_multipliers_are_not_negative_and_of_active_rows_alone(largest, monkeypatch) -> None:
    monkeypatch.setattr(constraints, "LARGEST_DENSE", largest)
    jacobian = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 5.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    rows = Linearised(np.array([0.0, 5e-5, 2e-4, 0.0]), sp.csr_array(jacobian))
    inside = np.array([True, True, False])
    found = rows.fitted(np.array([2.0, 3.0, 99.0]), inside)
    np.testing.assert_allclose(found[[1, 2]], [3.0, 0.0], atol=1e-8)
    assert found[0] + found[3] == pytest.approx(2.0)
    np.testing.assert_allclose(rows.fitted(np.array([-2.0, -3.0, 9.0]), inside), 0.0, atol=1e-8)
    np.testing.assert_allclose(
        nonnegative_fit(sp.csr_array(np.eye(2)), np.array([1.0, -1.0])), [1, 0], atol=1e-8
    )
