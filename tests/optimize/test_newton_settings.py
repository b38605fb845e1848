"""The numbers of the Newton methods: checked, heeded, and in the record where they are not the defaults."""

from typing import Any

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.outer_solvers import NestedSettings
from rmesh_nlp.optimize.local_newton import descend
from rmesh_nlp.optimize.newton_settings import (
    LocalNewtonSettings,
    NewtonSettings,
    StepSettings,
)
from rmesh_nlp.optimize.newton_step import BoxStep
from rmesh_nlp.optimize.trust_region import minimise
from support.formulations import nested
from support.quadratics import Matrix, quadratic


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"newton": {"poor": 0.9}}, "poor < good"),
        ({"newton": {"shrink": 1.5}}, "shrink must be below 1"),
        ({"newton": {"step": {"max_products": 2.5}}}, "max_products must be a whole number, got 2.5"),
        ({"newton": {"projection": {"damping_up": 1.0}}}, "damping_up must be above 1"),
        ({"newton": {"radius": 1}}, "radius"),
        ({"newton": 3}, "newton"),
        ({"local_newton": {"hidden": 2.0}}, "hidden must be below 1"),
    ],
)
def test_bad_settings_are_refused_by_name(given: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        NestedSettings.of(given)


def test_a_limit_of_products_is_kept() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((30, 30))
    A, g = root @ root.T + 0.01 * np.eye(30), rng.standard_normal(30)
    wide = np.full(30, 1e3)
    free = BoxStep(Matrix(A), g)
    free.solve(-wide, wide, 1e-8)
    short = BoxStep(Matrix(A), g, StepSettings(max_products=5))
    short.solve(-wide, wide, 1e-8)
    assert short.products <= 6 < free.products  # one more for the search that ends a round


def test_the_first_radius_bounds_the_first_step() -> None:
    points: list[np.ndarray] = []
    A, b, far = np.eye(4), np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 100.0)
    minimise(
        lambda x: quadratic(A, b, x),
        np.zeros(4),
        -far,
        far,
        max_iterations=1,
        settings=NewtonSettings(first_radius=0.01),
        on_step=lambda iteration, x, here: points.append(x),
    )
    assert np.max(np.abs(points[1])) == pytest.approx(0.01 * 4 / 1.001, rel=1e-9)
    points.clear()
    descend(
        lambda x: quadratic(A, b, x),
        np.zeros(4),
        -far,
        far,
        np.ones_like,
        lambda x, s: 1.0,
        gain_tolerance=0.0,
        max_iterations=1,
        settings=LocalNewtonSettings(first=0.02),
        on_step=lambda iteration, x, here: points.append(x),
    )
    assert np.max(np.abs(points[1])) == pytest.approx(0.02, rel=1e-9)


def test_what_differs_from_the_defaults_is_in_the_record_and_changes_the_path() -> None:
    problem, given = EXAMPLES["6.1"](5), {"newton": {"first_radius": 1e-3, "step": {"max_products": 10}}}
    usual, other = nested.solve(problem), nested.solve(problem, settings=given)
    assert usual.record()["settings"] == {}
    assert other.record()["settings"] == given
    assert other.iterations > usual.iterations
