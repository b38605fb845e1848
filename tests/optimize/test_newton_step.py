"""One step in a box, and multipliers of constraints."""

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.optimize import constraints
from rmesh_nlp.optimize.constraints import Linearised, nonnegative_fit
from rmesh_nlp.optimize.newton_step import BoxStep, NewtonSettings
from support.quadratics import Matrix, convex


@pytest.mark.parametrize("seed", range(3))
def test_the_predicted_decrease_is_that_of_the_model_and_the_step_is_stationary(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, g, upper = convex(rng, 15), rng.standard_normal(15), rng.uniform(0.01, 1, 15)
    step = BoxStep(Matrix(A), g, NewtonSettings(forcing=1e-9, max_products=400))
    s, predicted = step.within(-upper, upper)
    assert predicted == pytest.approx(-(g @ s + 0.5 * s @ A @ s), rel=1e-9)
    assert predicted > 0
    assert np.all(np.abs(s) <= upper)


def test_a_limit_of_products_is_kept() -> None:
    rng = np.random.default_rng(0)
    A, g, wide = convex(rng, 30), rng.standard_normal(30), np.full(30, 1e3)
    free, short = (BoxStep(Matrix(A), g, NewtonSettings(forcing=1e-8, max_products=k)) for k in (40, 5))
    for step in (free, short):
        step.within(-wide, wide)
    assert short.products <= 6 < free.products  # one more for the search that ends a round


@pytest.mark.parametrize("largest", [constraints.LARGEST_DENSE, 0])
def test_multipliers_are_not_negative_and_of_active_rows_alone(largest, monkeypatch) -> None:
    monkeypatch.setattr(constraints, "LARGEST_DENSE", largest)
    jacobian = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 5.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    rows = Linearised(np.array([0.0, 5e-6, 2e-5, 0.0]), sp.csr_array(jacobian))
    inside = np.array([True, True, False])
    found = rows.fitted(np.array([2.0, 3.0, 99.0]), inside)
    np.testing.assert_allclose(found[[1, 2]], [3.0, 0.0], atol=1e-8)
    assert found[0] + found[3] == pytest.approx(2.0)
    np.testing.assert_allclose(rows.fitted(np.array([-2.0, -3.0, 9.0]), inside), 0.0, atol=1e-8)
    np.testing.assert_allclose(
        nonnegative_fit(sp.csr_array(np.eye(2)), np.array([1.0, -1.0])), [1, 0], atol=1e-8
    )
