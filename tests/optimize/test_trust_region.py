"""Trust-region Newton-CG in boxes and with local radii, and multipliers of constraints."""

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize import constraints
from rmesh_nlp.optimize.activity import ZERO, both_vanish, is_inside
from rmesh_nlp.optimize.constraints import Linearised, nonnegative_fit
from rmesh_nlp.optimize.newton_step import BoxStep, NewtonSettings
from rmesh_nlp.optimize.trust_region import Evaluation, LocalRadii, NewtonResult, minimise


class Matrix:
    """A constant Hessian."""

    def __init__(self, A: np.ndarray) -> None:
        self.A = A

    def __call__(self, d: np.ndarray) -> np.ndarray:
        return self.A @ d

    def diagonal(self) -> np.ndarray:
        return np.abs(np.diag(self.A)) + 1e-3


def quadratic(A: np.ndarray, b: np.ndarray, x: np.ndarray) -> Evaluation:
    """1/2 x^T A x - b^T x."""
    return Evaluation(0.5 * x @ A @ x - b @ x, A @ x - b, lambda: Matrix(A))


def convex(rng: np.random.Generator, n: int) -> np.ndarray:
    """A positive definite matrix."""
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def descent(function: Any, start: Any = (0.0, 0.0), far: float = 5.0, **options: Any) -> NewtonResult:
    """Minimise in the box of half-width ``far``."""
    box = np.full(len(start), far)
    return minimise(function, np.array(start, dtype=float), -box, box, **options)


@pytest.mark.parametrize("widths", [None, np.ones_like, lambda x: 1 + x**2])
@pytest.mark.parametrize("seed", range(3))
def test_convex_quadratics_in_a_box_end_at_their_kkt_point(seed: int, widths: Any) -> None:
    rng = np.random.default_rng(seed)
    A, b = convex(rng, 12), 5 * rng.standard_normal(12)
    local = None if widths is None else LocalRadii(widths, lambda x, step: 1.0)
    tolerance = 1e-7 if local is None else 1
    result = descent(lambda x: quadratic(A, b, x), np.zeros(12), 1.0, tolerance=tolerance, local=local)
    assert result.status is rm.Status.CONVERGED
    assert np.max(np.abs(result.x - np.clip(result.x - (A @ result.x - b), -1, 1))) < 1e-5
    assert np.any(np.abs(result.x) == 1)
    assert result.iterations > 0


@pytest.mark.parametrize(("share", "second"), [(0.26, 0.125), (0.24, 0.03125)])
def test_a_cut_step_is_judged_by_what_the_model_says_of_it(share: float, second: float) -> None:
    """Half of a step of 1/2 is taken, where the function falls by a share of what the model predicts."""

    def evaluate(x: Array) -> Evaluation:
        return Evaluation(-share * float(x[0] - x[0] ** 2 / 2), x - 1, lambda: Matrix(np.eye(1)))

    visited: list[float] = []
    local = LocalRadii(np.ones_like, lambda x, step: 0.5)
    descent(evaluate, [0.0], local=local, max_iterations=2, on_step=lambda _, x: visited.append(x[0]))
    np.testing.assert_allclose(visited[:3], [0, 0.25, 0.25 + second])


def test_points_where_the_function_is_not_defined_are_not_taken() -> None:
    # the minimum of (x - 2)^2 in [-3, 3] is forbidden beyond 1: the method must stop before it
    def evaluate(x: Array) -> Evaluation | None:
        return None if x[0] > 1 else quadratic(np.array([[2.0]]), np.array([4.0]), x)

    assert 0.9 < descent(evaluate, [0.0], 3.0, max_iterations=30).x[0] <= 1
    assert descent(evaluate, [3.0], 3.0).status is rm.Status.EVALUATION_ERROR


def rosenbrock(x: Array) -> Evaluation:
    """Valley along a parabola; minimum 0 at (1, 1)."""
    a, b = x[1] - x[0] ** 2, 1 - x[0]
    gradient = np.array([-4 * a * x[0] - 2 * b, 2 * a])
    hessian = np.array([[8 * x[0] ** 2 - 4 * a + 2, -4 * x[0]], [-4 * x[0], 2.0]])
    return Evaluation(a**2 + b**2, gradient, lambda: Matrix(hessian))


def test_convergence_is_quadratic_near_a_minimum_of_a_function_that_is_none_of_its_models() -> None:
    values: list[float] = []
    result = descent(
        rosenbrock,
        (-1.2, 1.0),
        unit=1.0,
        tolerance=1e-9,
        settings=NewtonSettings(forcing=1e-3),
        on_step=lambda i, x: values.append(rosenbrock(x).value),
    )
    assert result.status is rm.Status.CONVERGED
    np.testing.assert_allclose(result.x, 1.0, atol=1e-8)
    assert np.all(np.diff(values) < 0)
    small = [value for value in values if value < 1e-2]
    # the value falls like the square of the error
    assert all(later < 10 * value**1.7 for value, later in itertools.pairwise(small))


@pytest.mark.parametrize(
    ("tolerance", "gain", "iterations"), [(1e-9, 1e-12, 99), (1e9, 1.0, 0), (1e-9, 1.0, 99)]
)
def test_it_ends_only_where_it_is_stationary_and_nothing_is_predicted(tolerance, gain, iterations) -> None:
    result = descent(rosenbrock, tolerance=tolerance, gain_tolerance=gain, reference=1e3, unit=1.0)
    assert result.status is rm.Status.CONVERGED
    assert result.iterations <= iterations
    assert (np.max(np.abs(rosenbrock(result.x).gradient)) < 1e-8) == (iterations > 0)


def test_what_rounding_hides_is_stalled_unless_it_is_stationary() -> None:
    """A slope of 1 in a box of 1e-5, below the digits of a value of 1e12."""

    def evaluate(x: Array) -> Evaluation:
        return Evaluation(1e12 + x[0], np.ones(1), lambda: Matrix(np.eye(1)))

    for tolerance, status in ((1e-6, rm.Status.STALLED), (1e-4, rm.Status.CONVERGED)):
        assert descent(evaluate, [0.0], 1e-5, unit=1.0, tolerance=tolerance).status is status


def test_a_callback_stops_it_and_the_iteration_limit_does() -> None:
    seen: list[int] = []
    stopped = descent(rosenbrock, on_step=lambda i, x: seen.append(i) or i == 2)
    assert (stopped.status, stopped.iterations, seen) == (rm.Status.INTERRUPTED, 2, [0, 1, 2])
    limited = descent(rosenbrock, max_iterations=2)
    assert (limited.status, limited.iterations) == (rm.Status.ITERATION_LIMIT, 2)
    np.testing.assert_array_equal(limited.x, stopped.x)


class TestRadius:
    """Steps of the quadratic with A = I: its gradient step is b."""

    B = np.array([1.0, 2.0, 3.0, 4.0])

    def true(self, x: Array) -> Evaluation:
        return quadratic(np.eye(4), self.B, x)

    def points(self, settings: NewtonSettings, **options: Any) -> list[Array]:
        """The points of a descent of which every model is right."""
        found: list[Array] = []
        options |= {"on_step": lambda iteration, x: found.append(x), "max_iterations": 3}
        descent(self.true, np.zeros(4), 100.0, settings=settings, **options)
        return found

    def test_a_step_beyond_the_domain_is_cut_and_its_own_decrease_counts(self) -> None:
        lengths: list[float] = []

        def longest(x: Array, step: Array) -> float:
            lengths.append(float(np.max(np.abs(step))))
            return min(1.0, 0.25 / lengths[-1])

        local, settings = LocalRadii(np.ones_like, longest), NewtonSettings(first_radius=2.0, grow=2.0)
        points = self.points(settings, local=local)
        # cut to the radius that was left, which is right and grows, and is cut again
        np.testing.assert_allclose(lengths, [2.0, 0.25, 0.5], rtol=1e-9)
        np.testing.assert_allclose(np.max(np.abs(np.diff(points, axis=0)), axis=1), 0.25, rtol=1e-9)
        lengths.clear()
        once = {"tolerance": np.inf, "max_iterations": 1, "local": local, "settings": settings}
        result = descent(lambda x: None if x[3] > 0.1 else self.true(x), np.zeros(4), 100.0, **once)
        # a refused step shrinks the radius from what was left of it
        np.testing.assert_allclose(lengths, [2.0, 0.25 * 0.25], rtol=1e-9)
        assert np.max(result.x) == pytest.approx(0.0625)


def test_bad_settings_are_refused_by_name() -> None:
    for given, message in (
        ({"poor": 0.9}, "poor < good"),
        ({"shrink": 1.5}, "shrink must be below 1"),
        ({"max_products": 2.5}, "max_products must be a whole number of at least 1, got 2.5"),
        ({"grow": 1.0}, "grow must be above 1"),
    ):
        with pytest.raises(rm.BadInputError, match=message):
            NewtonSettings.of(given)


SMALL, LARGE = 0.5 * ZERO, 2 * ZERO


def test_a_pair_is_weak_only_where_both_members_vanish() -> None:
    one = np.array([SMALL, -SMALL, SMALL, LARGE, -LARGE])
    other = np.array([-SMALL, 0.0, -LARGE, 0.0, SMALL])
    assert both_vanish(one, other).tolist() == [True, True, False, False, False]


def test_a_variable_is_inside_if_it_is_off_both_bounds() -> None:
    upper = np.array([1.0, 1.0, 1.0, 1.0, np.inf])
    x = np.array([-1 + SMALL, -1 + LARGE, 1 - LARGE, 1 - SMALL, 1e6])
    assert is_inside(x, -np.ones(5), upper).tolist() == [False, True, True, False, True]


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


def test_a_gradient_that_is_no_number_ends_the_descent() -> None:
    end = descent(lambda x: Evaluation(1.0, np.full(2, np.nan), lambda: Matrix(np.eye(2))))
    assert end.status is rm.Status.STALLED
    np.testing.assert_array_equal(end.x, 0)
