"""The second-order adjoint of outer objectives against differences of the first-order one."""

from __future__ import annotations

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.programs.objective_curvature import ObjectiveCurvature
from rmesh_nlp.programs.reduced import ReducedObjective
from rmesh_nlp.solving.outer import Outer
from support.formulations import nested


@pytest.mark.parametrize(
    ("name", "size", "objective"),
    [("6.1", 4, "error-l2"), ("6.3", (6, 4), "energy + 0.1*quality"), ("6.3", (6, 4), "energy")],
)
def test_products_are_derivatives_of_the_gradient(name: str, size: int, objective: str) -> None:
    outer, wanted, rng = Outer(EXAMPLES[name](size)), parse_objective(objective), np.random.default_rng(1)
    function = ReducedObjective(outer.energy, wanted)
    q = 0.3 * rng.uniform(-1, 1, outer.relocation.n_q)
    d = rng.uniform(-1, 1, q.size)
    hessian = ObjectiveCurvature(outer.energy, wanted).at(function(q))
    np.testing.assert_allclose(hessian.gradient, function(q).gradient, atol=1e-12)
    # central differences are wrong by the square of their step
    errors = []
    for h in (1e-2, 5e-3):
        difference = (function(q + h * d).gradient - function(q - h * d).gradient) / (2 * h)
        errors.append(np.max(np.abs(difference - hessian(d))))
    assert np.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.slow
def test_newton_takes_a_true_error_and_needs_few_contact_solves() -> None:
    problem = EXAMPLES["6.1"](6)
    newton, ipopt = (nested.solve(problem, objective="error-l2", outer=o) for o in ("newton", "ipopt"))
    assert newton.success
    before, after = newton.record()["objective_initial"], newton.record()["objective_value"]
    assert before - after >= 0.95 * (before - ipopt.record()["objective_value"])
    assert newton.stationarity == "KKT"
    assert newton.contact_solves < ipopt.contact_solves
