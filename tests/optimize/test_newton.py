"""The Newton method with trust regions in boxes, and what is active there."""

import numpy as np
import pytest

from rmesh_nlp.optimize.activity import ZERO, both_vanish, is_inside
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import Evaluation, minimise
from support.quadratics import quadratic


@pytest.mark.parametrize("seed", range(5))
def test_convex_quadratics_in_a_box_end_at_their_kkt_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((12, 12))
    A, b = root @ root.T + 0.1 * np.eye(12), 5 * rng.standard_normal(12)
    result = minimise(lambda x: quadratic(A, b, x), np.zeros(12), -np.ones(12), np.ones(12), tolerance=1e-7)
    assert result.status is Status.CONVERGED
    g = A @ result.x - b
    assert np.max(np.abs(result.x - np.clip(result.x - g, -1, 1))) < 1e-5
    assert np.any(np.abs(result.x) == 1)


def test_negative_curvature_leads_to_a_corner() -> None:
    b = np.array([0.1, -0.2, 0.3])
    result = minimise(lambda x: quadratic(-np.eye(3), b, x), np.zeros(3), -np.ones(3), np.ones(3))
    np.testing.assert_array_equal(result.x, [1.0, -1.0, 1.0])


def test_points_where_the_function_is_not_defined_are_not_taken() -> None:
    # the minimum of (x - 2)^2 in [-3, 3] is forbidden beyond 1: the method must stop before it
    def evaluate(x: np.ndarray) -> Evaluation | None:
        return None if x[0] > 1 else quadratic(np.array([[2.0]]), np.array([4.0]), x)

    result = minimise(evaluate, np.zeros(1), np.array([-3.0]), np.array([3.0]), max_iterations=30)
    assert 0.9 < result.x[0] <= 1


SMALL, LARGE = 0.5 * ZERO, 2 * ZERO


def test_a_pair_is_weak_only_where_both_members_vanish() -> None:
    one = np.array([SMALL, -SMALL, SMALL, LARGE, -LARGE])
    other = np.array([-SMALL, 0.0, -LARGE, 0.0, SMALL])
    assert both_vanish(one, other).tolist() == [True, True, False, False, False]


def test_a_variable_is_inside_if_it_is_off_both_bounds() -> None:
    lower, upper = np.full(5, -1.0), np.full(5, 1.0)
    upper[4] = np.inf
    x = np.array([-1 + SMALL, -1 + LARGE, 1 - LARGE, 1 - SMALL, 1e6])
    assert is_inside(x, lower, upper).tolist() == [False, True, True, False, True]
