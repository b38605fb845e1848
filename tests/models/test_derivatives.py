"""First and second derivatives through the contact solve, by remainders and differences: (5.7), (5.11)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.second_derivatives import Curvature, ObjectiveCurvature
from rmesh_nlp.problem import ContactProblem, ExactSolution
from rmesh_nlp.solving.outer import Outer
from support.problems import sloped_block


def with_exact(problem: ContactProblem) -> ContactProblem:
    """The problem with some smooth function in the place of its exact solution.

    Its traction does not vanish at x = 0, the only place where nodes of 6.3 do not touch.
    """

    def value(x: Any, y: Any) -> Any:
        return ca.vertcat(-1e-3 * (x + 1) * y, -1e-2 * (x * x + y))

    return replace(problem, exact=ExactSolution(value, 0.0))


PROBLEMS = {
    "6.1": lambda: EXAMPLES["6.1"](),
    "6.2": lambda: with_exact(EXAMPLES["6.2"]()),
    "6.3": lambda: with_exact(EXAMPLES["6.3"]()),
    "sloped, stick and slip": lambda: with_exact(sloped_block()),
}
OBJECTIVES = ("error-l2", "error-energy", "contact", "energy", "energy + 0.1*quality")
QUICK = {
    ("6.1", "error-energy"),
    ("6.1", "contact"),
    ("6.3", "energy"),
    ("sloped, stick and slip", "error-l2"),
}
"""Each objective and each kind of contact once; the other combinations are slow."""


def last_rate(function: Callable[[np.ndarray], Any], n: int, seed: int, size: float) -> float:
    """Order of ``L(q + h d) - L(q) - h L'(q) d`` for halved h at a random admissible q."""
    rng = np.random.default_rng(seed)
    q = size * rng.uniform(-1, 1, n)
    d = rng.uniform(-1, 1, n)
    here = function(q)
    assert not np.any(here.weak)
    steps = 1e-2 * 0.5 ** np.arange(3, 5)
    one, two = (abs(function(q + h * d).value - here.value - h * here.gradient @ d) for h in steps)
    return float(np.log2(one / two))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_energy_gradient_is_of_second_order(name: str, seed: int) -> None:
    outer = Outer(PROBLEMS[name]())
    assert last_rate(outer.energy, outer.n, seed, 0.6) >= 1.9


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        pytest.param(name, objective, marks=() if (name, objective) in QUICK else pytest.mark.slow)
        for name in PROBLEMS
        for objective in OBJECTIVES
    ],
)
def test_the_adjoint_gradient_is_of_second_order(name: str, objective: str) -> None:
    outer = Outer(PROBLEMS[name]())
    assert last_rate(ReducedObjective(outer.energy, parse_objective(objective)), outer.n, 1, 0.5) >= 1.9


def test_weights_that_do_not_move_would_be_noticed() -> None:
    # the derivative of omega_i is a visible part of the gradient of 6.3
    problem = EXAMPLES["6.3"]()
    outer = Outer(problem)
    moving = outer.energy(np.zeros(outer.n)).gradient
    smooth = replace(problem, obstacle=replace(problem.obstacle, friction=1e-12))
    (still,) = Outer(smooth).energy._gradient(
        outer.energy.point(np.zeros(outer.n), outer.given),
        outer.given.normal_force,
        outer.given.tangential_force,
    )
    assert np.max(np.abs(moving - still)) > 0.1 * np.max(np.abs(moving))


def test_the_energy_gradient_is_the_adjoint_gradient_of_the_energy() -> None:
    outer = Outer(EXAMPLES["6.3"]())
    q = 0.5 * np.random.default_rng(2).uniform(-1, 1, outer.n)
    envelope = outer.energy(q).gradient
    adjoint = ReducedObjective(outer.energy, parse_objective("energy"))(q).gradient
    np.testing.assert_allclose(adjoint, envelope, atol=1e-10 * np.max(np.abs(envelope)))


@pytest.mark.parametrize("name", PROBLEMS)
def test_hessian_products_are_differences_of_gradients(name: str) -> None:
    outer = Outer(PROBLEMS[name]())
    rng = np.random.default_rng(1)
    q, d = 0.5 * rng.uniform(-1, 1, (2, outer.n))
    hessian = Curvature(outer.energy).at(outer.energy(q))
    h = 1e-5
    difference = outer.energy(q + h * d).gradient - outer.energy(q - h * d).gradient
    product = hessian(d)
    # central differences of an exactly solved problem: h^2 and rounding over h
    np.testing.assert_allclose(difference / (2 * h), product, atol=1e-6 * np.max(np.abs(product)))
    other = rng.uniform(-1, 1, d.size)
    assert other @ product == pytest.approx(d @ hessian(other), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "size", "objective"),
    [("6.1", 4, "error-l2"), ("6.3", (6, 4), "energy + 0.1*quality"), ("6.3", (6, 4), "energy")],
)
def test_products_of_objectives_are_derivatives_of_the_gradient(name: str, size: Any, objective: str) -> None:
    outer, wanted, rng = Outer(EXAMPLES[name](size)), parse_objective(objective), np.random.default_rng(1)
    function = ReducedObjective(outer.energy, wanted)
    q = 0.3 * rng.uniform(-1, 1, outer.n)
    d = rng.uniform(-1, 1, q.size)
    hessian = ObjectiveCurvature(outer.energy, wanted).at(function(q))
    np.testing.assert_allclose(hessian.gradient, function(q).gradient, atol=1e-12)
    # central differences are wrong by the square of their step
    errors = []
    for h in (1e-2, 5e-3):
        difference = (function(q + h * d).gradient - function(q - h * d).gradient) / (2 * h)
        errors.append(np.max(np.abs(difference - hessian(d))))
    assert np.log2(errors[0] / errors[1]) > 1.9
