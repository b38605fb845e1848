"""Labels over the branches of the contact, against a search of all of them and one-sided differences."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import branches
import rmesh_nlp as rm
from benchmark_branches import seal, slab
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.branches import BranchLabel
from rmesh_nlp.models.second_derivatives import ObjectiveCurvature
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer


def leak(cost: float) -> str:
    return f"boundary(seal, {cost}*(y + uy) - y)"


def ended(problem: ContactProblem, objective: str, formulation: str) -> tuple[rm.Solution, Array]:
    solution = rm.solve(problem, formulation, objective=objective)
    return solution, Outer.of(problem).variables(np.asarray(solution.mesh.p))


@cache
def end_of_seal(coulomb: float) -> tuple[ContactProblem, Array]:
    """A seal, and the edge at which ``mpcc`` ends: every node touches without force."""
    block = seal(4, coulomb)
    return block, ended(block, leak(2.0), "mpcc")[1]


def labelled(outer: Outer, q: Array) -> BranchLabel:
    return outer.branches(outer.function(q))


@pytest.mark.parametrize("coulomb", [0.0, 0.3])
def test_a_kink_is_a_minimum_or_descends_by_the_weight_of_what_changes_there(
    coulomb: float,
) -> None:
    """At the best edge of a seal every node touches without force; it is the best for some costs of a gap."""
    block, q = end_of_seal(coulomb)
    rates = []
    for cost in (2.0, 0.7, 40.0):
        outer = Outer.of(block, leak(cost))
        found, every = labelled(outer, q), branches.steepest(outer, q)
        assert found.pairs.size == 3
        assert every.branches == 8
        rates.append(every.rate)
        stationary = every.rate >= -1e-6
        assert found.b_stationary == stationary
        assert (found.label == "S") == stationary
        if stationary:
            assert found.rate == 0.0
            continue
        point = outer.function(q)
        for direction, rate in ((found.direction, found.rate), (every.direction, every.rate)):
            step = 1e-5 * direction
            change = (outer.function(q + step).value - point.value) / outer.residual.unit
            assert change / 1e-5 == pytest.approx(rate, rel=1e-3)
        # a step of at most one in every variable goes further than one of at most one in their sum
        assert found.rate <= every.rate
    assert rates[0] >= -1e-6
    assert min(rates[1:]) < -1e-3


def test_where_no_pair_is_biactive_the_label_is_that_of_the_residual() -> None:
    problem, objective = slab(0.5, (6, 4)), "mean(top, -uy)"
    solution, q = ended(problem, objective, "nested")
    outer = Outer.of(problem, objective)
    assert solution.stationarity_residual <= outer.tolerance
    best, given = labelled(outer, q), labelled(outer, np.zeros(outer.n))
    assert (best.label, best.b_stationary, best.pairs.size) == ("S", True, 0)
    assert (given.label, given.b_stationary) == ("none", False)
    # to first order a step of one in every variable gains the sum of the gradient
    unit = outer.residual.unit
    assert given.rate == pytest.approx(-np.sum(np.abs(outer.function(np.zeros(outer.n)).gradient)) / unit)


def test_slips_that_are_given_have_no_friction_of_their_own() -> None:
    """The corner of the block is held sideways: its friction is any force up to the bound."""
    outer = Outer.of(seal(4, 0.3), leak(2.0))
    q = np.random.default_rng(2).uniform(-0.2, 0.0, outer.n)
    here, d = outer.function(q), np.random.default_rng(3).uniform(-1, 1, outer.n)
    hessian = ObjectiveCurvature(outer.energy, parse_objective(leak(2.0))).at(here)
    np.testing.assert_allclose(hessian.gradient, here.gradient, atol=1e-8 * np.abs(here.gradient).max())
    change = (outer.function(q + 1e-4 * d).gradient - outer.function(q - 1e-4 * d).gradient) / 2e-4
    np.testing.assert_allclose(hessian(d), change, atol=1e-5 * np.abs(change).max())


def test_friction_that_sets_in_at_a_sliding_node_is_one_condition_and_not_two() -> None:
    """Gap, force and friction vanish together at grazing nodes of a seal, which slide."""
    block, q = end_of_seal(0.3)
    outer = Outer.of(block, leak(2.0))
    point = outer.function(q)
    program = outer.kkt
    rows, _ = program.mpcc.derivatives.jac_g(program.point(q, point.equilibrium, point.system), [])
    members = np.abs(rows.full().ravel()[program.mpcc.n_g :]).reshape(2, -1)
    vanish = np.flatnonzero(np.max(members, axis=0) < 1e-6)
    assert vanish.size > 3
    found = outer.branches(point)
    assert set(found.pairs) < set(vanish)
    assert np.all(found.pairs < program.n_contact)
