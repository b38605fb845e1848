import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton_step import BoxStep, PreconditionedStep, positive_definite


class Quadratic:
    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix

    def __call__(self, d: Array) -> Array:
        return np.asarray(self.matrix @ d)

    def diagonal(self) -> Array:
        return np.abs(self.matrix.diagonal())


def stiff(n: int) -> Array:
    """Positive definite, with a condition number of about 1e4 that no diagonal mends."""
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return matrix @ matrix


def test_a_positive_definite_matrix_is_factorised_as_it_is() -> None:
    matrix = stiff(12)
    found = positive_definite(sp.csc_array(matrix), 12)
    assert found is not None
    assert (found.shift, found.factorisations) == (0, 1)
    r = np.arange(12.0)
    np.testing.assert_allclose(found(r), np.linalg.solve(matrix, r), rtol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_an_indefinite_matrix_is_shifted_until_its_inverse_is_positive_definite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = 6, 10
    matrix = rng.standard_normal((m, m))
    matrix = matrix + matrix.T
    rest = matrix[n:, n:]
    matrix[n:, n:] = rest + (1 - np.linalg.eigvalsh(rest).min()) * np.eye(m - n)
    matrix[:n, :n] -= 3 * np.eye(n)
    assert np.linalg.eigvalsh(matrix).min() < 0
    found = positive_definite(sp.csc_array(matrix), n)
    assert found is not None
    assert found.shift > 0
    inverse = np.column_stack([found(e) for e in np.eye(n)])
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-12)
    assert np.linalg.eigvalsh(inverse).min() > 0
    # it is the least shift of the sequence
    unit = np.mean(np.abs(np.diag(matrix)[:n]))
    less = matrix + np.diag(np.r_[np.full(n, found.shift / 10 * unit), np.zeros(m - n)])
    assert found.shift <= 1e-3 or np.linalg.eigvalsh(less).min() <= 0


def test_a_good_preconditioner_saves_products_and_gives_the_same_minimum_in_a_box() -> None:
    n = 40
    model = Quadratic(stiff(n))
    g = np.random.default_rng(0).standard_normal(n)
    factor = positive_definite(sp.csc_array(model.matrix), n)
    assert factor is not None
    wide = np.full(n, 1e6)
    step = PreconditionedStep(model, g, factor)
    s, _ = step.solve(-wide, wide, 1e-8)
    np.testing.assert_allclose(s, -np.linalg.solve(model.matrix, g), rtol=1e-6)
    plain = BoxStep(model, g)
    plain.solve(-wide, wide, 1e-8)
    assert step.products < plain.products / 3
    narrow = np.full(n, 0.3)
    inside, decrease = PreconditionedStep(model, g, factor).solve(-narrow, narrow, 1e-6)
    assert np.all(np.abs(inside) <= narrow)
    assert decrease > 0
