"""Second derivatives of the reduced model: differences of its gradients converge to them at rate 2."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models import second_derivatives
from rmesh_nlp.models.reduced_model import ReducedCertificate, ReducedEnergy, ReducedObjective
from rmesh_nlp.models.second_derivatives import Curvature, ObjectiveCurvature, SecantCurvature, curvature_of
from rmesh_nlp.problem import Motion
from rmesh_nlp.solving.outer import Outer
from support.contact_geometry import block_sliding_on_a_circle
from support.curved import HOLE, plate
from support.problems import no_boxes, sloped_block
from support.taylor import difference_order

PROBLEMS = {
    "6.1": lambda: EXAMPLES["6.1"](4),
    "6.2": lambda: EXAMPLES["6.2"]((6, 4)),
    "6.3": lambda: EXAMPLES["6.3"]((6, 4)),
    "sloped, stick and slip": sloped_block,
    "curved foundation, stick and slip": block_sliding_on_a_circle,
    "along a curve": lambda: plate({"hole": HOLE}, delta=0.4, load=(lambda x, y: x * y, lambda x, y: x)),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_products_of_the_energy_are_derivatives_of_its_gradient(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    energy = Outer(PROBLEMS[name]()).energy
    rng = np.random.default_rng(1)
    q, d, other = rng.uniform(-1, 1, (3, energy.relocation.n_q)) * [[0.3], [1], [1]]
    hessian = Curvature(energy).at(energy(q))
    product = hessian(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 2e-3) > 1.9
    assert other @ product == pytest.approx(d @ hessian(other), rel=1e-9)
    # one by one, in columns, or all at once
    both = hessian(np.column_stack([d, other]))
    monkeypatch.setattr(second_derivatives, "DENSE", 0)
    alone = Curvature(energy).at(energy(q))
    np.testing.assert_allclose(
        both, np.column_stack([alone(d), alone(other)]), atol=1e-10 * np.max(np.abs(both))
    )
    np.testing.assert_allclose(both[:, 0], product, atol=1e-10 * np.max(np.abs(both)))
    assert np.all(hessian.diagonal() > 0)


@pytest.mark.parametrize(
    "name", ["6.2", "sloped, stick and slip", "curved foundation, stick and slip", "along a curve"]
)
def test_the_schur_complement_of_the_sparse_matrix_is_the_second_derivative(name: str) -> None:
    energy = Outer(PROBLEMS[name]()).energy
    rng = np.random.default_rng(3)
    q, width = 0.3 * rng.uniform(-1, 1, energy.relocation.n_q), rng.uniform(0.5, 2, energy.relocation.n_q)
    hessian = Curvature(energy).at(energy(q))
    matrix, n = hessian.joint(width)
    matrix = matrix.toarray()
    schur = matrix[:n, :n] - matrix[:n, n:] @ np.linalg.solve(matrix[n:, n:], matrix[n:, :n])
    expected = width[:, None] * hessian(np.eye(n)) * width
    np.testing.assert_allclose(schur, expected, atol=1e-9 * np.max(np.abs(expected)))
    assert np.linalg.eigvalsh(matrix[n:, n:]).min() > 0


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_distortions_are_part_of_both_derivatives(distortion: str) -> None:
    problem = replace(no_boxes(EXAMPLES["6.1"](4)), quadrature=4)
    energy = ReducedEnergy.of(ContactSolver(problem), parse_objective(f"energy + 0.1*{distortion}"))
    rng = np.random.default_rng(3)
    q, d = 0.1 * rng.uniform(-1, 1, (2, energy.relocation.n_q))
    product = Curvature(energy).at(energy(q))(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 4e-2) > 1.9
    # the part of the distortion is no small one
    plain = ReducedEnergy.of(ContactSolver(problem))
    assert np.max(np.abs(product - Curvature(plain).at(plain(q))(d))) > 1e-2 * np.max(np.abs(product))


def test_a_lower_rule_changes_the_model_a_little() -> None:
    energy = ReducedEnergy.of(ContactSolver(replace(EXAMPLES["6.1"](4), quadrature=8)))
    q, d = 0.3 * np.random.default_rng(1).uniform(-1, 1, (2, energy.relocation.n_q))
    exact, lower = (Curvature(energy, rule).at(energy(q))(d) for rule in (None, 3))
    size = np.max(np.abs(exact))
    assert 1e-6 * size < np.max(np.abs(exact - lower)) < 0.3 * size


@pytest.mark.parametrize(
    ("name", "size", "objective"),
    [("6.1", 4, "error-l2"), ("6.3", (6, 4), "energy + 0.1*quality"), ("6.3", (6, 4), "energy")],
)
def test_products_of_objectives_are_derivatives_of_the_gradient(name: str, size: Any, objective: str) -> None:
    outer, wanted, rng = Outer(EXAMPLES[name](size)), parse_objective(objective), np.random.default_rng(1)
    function = ReducedObjective(outer.energy, wanted)
    q, d = rng.uniform(-1, 1, (2, outer.n)) * [[0.3], [1]]
    hessian = ObjectiveCurvature(outer.energy, wanted).at(function(q))
    np.testing.assert_allclose(hessian.gradient, function(q).gradient, atol=1e-12)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d) > 1.9
    if objective == "energy":
        energy = Curvature(outer.energy).at(outer.energy(q))(d)
        np.testing.assert_allclose(hessian(d), energy, atol=1e-9 * np.max(np.abs(energy)))


def test_secants_learn_what_the_upper_bound_does_not_know() -> None:
    problem = replace(random_problem(2, kind="scalar"), motion=Motion(delta=0.05))
    energy = ReducedEnergy.of(ContactSolver(problem))
    function = ReducedCertificate(energy, parse_objective("2*certificate"))
    curvature, rng = curvature_of(function), np.random.default_rng(0)
    assert isinstance(curvature, SecantCurvature)
    ends = [function(q) for q in rng.uniform(-0.2, 0.2, (2, energy.relocation.n_q))]
    first = curvature.at(ends[0])
    hessian, step = curvature.at(ends[1]), ends[1].q - ends[0].q
    np.testing.assert_allclose(first(step), 2 * first.upper(step), rtol=1e-12)
    rest = [end.gradient - 2 * function.upper(end.q).gradient for end in ends]
    np.testing.assert_allclose(hessian(step) - 2 * hessian.upper(step), rest[1] - rest[0], atol=1e-9)
    other = rng.uniform(-1, 1, step.size)
    assert other @ hessian(step) == pytest.approx(step @ hessian(other))
