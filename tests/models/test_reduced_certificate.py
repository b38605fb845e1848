"""The bound of the error as an outer objective."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedCertificate, ReducedEnergy
from rmesh_nlp.models.second_derivatives import SecantCurvature
from rmesh_nlp.problem import ContactProblem, Motion
from support.formulations import fixed, joint, mpcc, nested


def boxed(kind: str) -> ContactProblem:
    return replace(random_problem(2, kind=kind), motion=Motion(delta=0.05))


@pytest.mark.parametrize("kind", ["scalar", "membrane"])
@pytest.mark.parametrize(
    "objective", ["certificate", pytest.param("2*certificate + 0.01*quality", marks=pytest.mark.slow)]
)
def test_the_gradient_is_right(kind, objective):
    assert rm.verify_gradient(boxed(kind), objective, seed=1).order > 1.9


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scalar", "membrane"])
def test_nested_lowers_the_bound_from_the_given_mesh_and_from_that_of_least_energy(kind):
    problem = boxed(kind)
    by_energy = nested.solve(problem)
    for start in (None, by_energy):
        found = nested.solve(problem, objective="certificate", start=start)
        assert found.success
        assert found.extra["objective_value"] < found.extra["objective_initial"]
        certificate = rm.certify(found)
        assert certificate.guaranteed_lower
        assert certificate.error_bound < certificate.error_bound_initial
        # what is minimised is a bound as well, and close to that of the certificate
        half_square = certificate.error_bound**2 / 2
        assert found.extra["objective_value"] == pytest.approx(half_square, rel=0.05)
    # with its own lower bound, not the better one of the given mesh
    assert half_square <= 1.001 * rm.certify(by_energy).error_bound ** 2 / 2


@pytest.mark.slow
def test_others_refuse_and_fixed_tells_the_value():
    problem = boxed("scalar")
    for strategy in (joint, mpcc):
        with pytest.raises(ValueError, match="certificate"):
            strategy.solve(problem, objective="certificate")
    elastic = EXAMPLES["6.3"]((4, 2))
    with pytest.raises(ValueError, match="scalar"):
        nested.solve(elastic, objective="certificate")
    found = fixed.solve(problem, objective="certificate")
    assert found.extra["objective_value"] > 0


def test_secants_learn_what_the_upper_bound_does_not_know():
    energy = ReducedEnergy(relocation(boxed("scalar")))
    function = ReducedCertificate(energy, parse_objective("2*certificate"))
    curvature, rng = SecantCurvature(function), np.random.default_rng(0)
    ends = [function(q) for q in rng.uniform(-0.2, 0.2, (2, energy.relocation.n_q))]
    curvature.at(ends[0])
    hessian, step = curvature.at(ends[1]), ends[1].q - ends[0].q
    rest = [end.gradient - 2 * function.upper(end.q).gradient for end in ends]
    np.testing.assert_allclose(hessian(step) - 2 * hessian.upper(step), rest[1] - rest[0], atol=1e-9)
