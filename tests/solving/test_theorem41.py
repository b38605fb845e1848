"""Theorem 4.1 of a solution, and a strategy's own residuals beside the outer's."""

from __future__ import annotations

import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.solving.verification import error_terms, error_terms_on
from support.formulations import fixed, joint, mpcc
from support.sliding import sliding_block


@pytest.mark.slow
def test_the_terms_sum_to_the_energy_above_the_exact_one() -> None:
    problem = EXAMPLES["6.1"](4)
    before, after = error_terms(fixed.solve(problem)), error_terms(joint.solve(problem))
    assert before is not None
    assert after is not None
    for terms in (before, after):
        assert terms.I3 == 0
        assert min(terms.I1, terms.I2) > 0
        # what is left is the audit's quadrature of the load
        assert terms.total == pytest.approx(terms.above_exact, rel=1e-5)
    assert after.total < before.total


@pytest.mark.slow
def test_with_friction_the_third_term_closes_the_sum() -> None:
    found = []
    for n in (4, 8):
        problem = sliding_block(n)
        terms = error_terms_on(problem, problem.mesh.p)
        assert terms is not None
        assert min(terms.I1, terms.I3) > 0  # on these grids nodes slide where the exact solution sticks
        assert terms.I2 >= -1e-12
        # loads and displacement are polynomials on the elements, so rules are exact and nothing is left over
        assert terms.total == pytest.approx(terms.above_exact, rel=1e-9)
        assert terms.total - terms.I3 != pytest.approx(terms.above_exact, rel=1e-6)
        found.append(terms)
    assert found[1].total < 0.5 * found[0].total


def test_the_terms_do_not_depend_on_the_rule_of_the_problem() -> None:
    one, two = (EXAMPLES["6.1"](2).with_rule(rule) for rule in (1, 8))
    assert error_terms_on(one, one.mesh.p) == error_terms_on(two, two.mesh.p)


def test_without_an_exact_solution_there_are_no_terms() -> None:
    assert error_terms(fixed.solve(EXAMPLES["6.2"]((6, 4)))) is None


@pytest.mark.parametrize("strategy", [joint, mpcc])
def test_own_residuals_are_those_of_the_strategy_s_own_forces(strategy) -> None:
    record = strategy.solve(EXAMPLES["6.3"]((6, 4))).record()
    for kind in ("equilibrium", "complementarity"):
        own, outer = record[f"own_{kind}_residual"], record[f"assessed_{kind}_residual"]
        # an interior point is right to its tolerance, a contact solve to rounding: not one number twice
        assert 0 <= own <= 1e-6
        assert 0 <= outer <= 1e-9
    assert record["own_equilibrium_residual"] != record["assessed_equilibrium_residual"]
