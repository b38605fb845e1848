"""The residual of Coulomb's law along edges: its size, units and rate, and where it is reported."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.coulomb import NOTICED, coulomb_residual, growth
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.problem import ContactProblem
from support import sliding
from support.problems import coulomb_slab


def coefficient(x: Any, _: Any) -> Any:
    """g over the exact pressure: with it the solution of support.sliding obeys Coulomb's law."""
    past = 3 * sliding.SLIDE * ca.fmax(x - sliding.TURN, 0) ** 2
    return -sliding.BOUND / (sliding.LAMBDA * (past + sliding.PRESS) + 2 * sliding.MU * sliding.PRESS)


def block(n: int, order: int) -> ContactProblem:
    """A block whose lower edge sticks on one half and slides on the other, under a pressure that varies."""
    problem = sliding.sliding_block(n)
    return replace(problem, obstacle=rm.Obstacle("bottom", coulomb=coefficient), order=order, exact=None)


def slab(coulomb: float, order: int = 1) -> ContactProblem:
    return coulomb_slab(coulomb, (8, 4), order=order)


def residual(problem: ContactProblem, push: float = 1.0, motion: float = 1.0) -> float:
    """That of the contact solution with its friction and its displacement multiplied."""
    model = ContactSolver(problem)
    state, field = model.given, model.displacement
    found = coulomb_residual(
        model.discretisation.space,
        np.asarray(problem.mesh.p),
        motion * field.values(state.u),
        state.normal_force,
        push * state.tangential_force,
    )
    assert found is not None
    return found


@pytest.mark.parametrize(("order", "least"), [(1, 3.0), (2, 5.0)])
def test_falls_with_the_edges_on_a_solution_that_sticks_and_slides(order: int, least: float) -> None:
    """The exact solution has a continuous stress and a slip of the third power of the distance."""
    coarse, fine = (residual(block(n, order)) for n in (8, 16))
    assert 0 < fine < coarse / least
    assert coarse < 0.01


def test_vanishes_where_all_edges_slide_and_the_coefficient_is_constant() -> None:
    problem = slab(0.5)
    model = ContactSolver(problem)
    state = model.given
    assert np.all(state.active.sliding[state.active.touching] != 0)
    assert residual(problem) < 1e-12


@pytest.mark.parametrize("order", [1, 2])
def test_counts_stress_above_the_bound(order: int) -> None:
    """All slides: a tenth more friction is above the bound by a tenth of F p.

    At order 2 the parabolas of both stresses are below zero on the last edge, where |r| is that stress.
    """
    F = 0.5
    found = residual(slab(F, order), push=1.1)
    assert found == pytest.approx(0.1 * F / np.hypot(1, 1.1 * F), rel=0.05 if order == 2 else 1e-10)


def test_counts_slip_with_the_friction() -> None:
    """The friction pushes along the slip, which must not be: r is c times the slip."""
    problem = slab(0.5)
    model = ContactSolver(problem)
    state, nodes = model.given, np.asarray(problem.mesh.p)
    weights, slip = model.discretisation.space.weights(nodes), np.abs(model.slips(nodes, state.u))
    pressing = state.normal_force > 0
    # r at nodes, a straight line on edges between them, all of which press or are open
    r = np.where(pressing, slip, 0.0) / np.max(np.abs(state.u)) / np.sum(weights[pressing])
    found = residual(problem, motion=-1.0)
    assert 0 < found <= 1.2 * np.sum(weights * r)
    assert found >= 0.5 * np.sum(weights * r)


def test_does_not_depend_on_units() -> None:
    problem = slab(1.0)
    law = problem.law
    stiff = replace(
        problem,
        law=rm.PlaneStrain(1e6 * law.lame_lambda, 1e6 * law.lame_mu),
        tractions=tuple(replace(t, value=tuple(1e6 * v for v in t.value)) for t in problem.tractions),
    )
    assert residual(problem) > 1e-5
    assert residual(stiff) == pytest.approx(residual(problem), rel=1e-6)


def test_only_with_coulomb_friction() -> None:
    problem = rm.EXAMPLES["6.3"](n=(4, 2))
    model = ContactSolver(problem)
    state, space = model.given, model.discretisation.space
    forces = model.displacement.values(state.u), state.normal_force, state.tangential_force
    assert coulomb_residual(space, np.asarray(problem.mesh.p), *forces) is None
    row = rm.solve(problem, "fixed").record()
    assert "coulomb_residual" not in row


def test_growth_is_said_above_a_thousandth_only() -> None:
    assert growth(None, None) is None
    assert growth(NOTICED, 1.9 * NOTICED) is None
    assert growth(0.1 * NOTICED, 0.9 * NOTICED) is None
    assert "holds less well" in (growth(0.1 * NOTICED, 1.1 * NOTICED) or "")


def test_record_and_summary_have_both_and_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = slab(1.0)
    found = rm.solve(problem, "fixed")
    row = found.record()
    assert row["coulomb_residual"] == row["coulomb_residual_initial"] == pytest.approx(residual(problem))
    assert "Coulomb's law along edges" in dict(found.summary())
    assert not row["warnings"]
    values = iter([0.02, 0.001])  # the final mesh is measured first
    monkeypatch.setattr("rmesh_nlp.solving.state.coulomb_residual", lambda *_: next(values))
    assert "holds less well" in " ".join(rm.solve(problem, "fixed").record()["warnings"])
