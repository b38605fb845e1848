"""The first-order residual of the outer problem, in histories and in records."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models import outer_solvers, regularised_descent
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.residual import multipliers
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.outer import Outer
from support.formulations import fixed, joint, mpcc, nested
from support.problems import sloped_block


def test_relative_residual_is_one_on_given_mesh() -> None:
    for n in (3, 6):
        outer = Outer(EXAMPLES["6.1"](n))
        point = outer.energy(np.zeros(outer.relocation.n_q))
        assert outer.residual(point) == pytest.approx(1.0)


def test_history_and_record_agree_with_active_areas() -> None:
    problem = EXAMPLES["6.2"]((4, 2), 0.6)
    solution = nested.solve(problem, outer="newton", tolerance=1e-5)
    assert solution.multipliers is not None
    assert np.any(solution.multipliers.area > 0)
    assert solution.history[-1].dual_residual == pytest.approx(solution.stationarity_residual, rel=1e-6)


@pytest.mark.parametrize("strategy", [joint, mpcc])
@pytest.mark.parametrize("name", ["6.1", "6.3"])
def test_history_and_record_agree_where_no_contact_is_solved(strategy: Any, name: str) -> None:
    """The contact forces are multipliers of one program and unknowns of the other."""
    solution = strategy.solve(EXAMPLES[name](4) if name == "6.1" else EXAMPLES[name]((4, 3)))
    first, last = solution.history[0], solution.history[-1]
    assert first.dual_residual > 100 * last.dual_residual
    # both are rounding of a minimiser, the contact forces of one an interior point's
    assert abs(last.dual_residual - solution.stationarity_residual) <= 1e-8 + 0.01 * last.dual_residual


@pytest.mark.slow
def test_of_another_objective_the_end_of_mpcc_is_known() -> None:
    solution = mpcc.solve(EXAMPLES["6.1"](3), objective="error-l2")
    assert solution.history[-1].dual_residual == solution.stationarity_residual
    assert all(np.isnan(step.dual_residual) for step in solution.history[:-1])


@pytest.mark.slow
def test_an_objective_of_errors_has_one() -> None:
    solution = nested.solve(replace(EXAMPLES["6.1"](3), quadrature=8), objective="error-l2")
    assert solution.stationarity_residual < 1e-2
    given = fixed.solve(EXAMPLES["6.1"](3), objective="error-l2")
    assert given.stationarity_residual == pytest.approx(1.0)


def test_a_pull_of_elements_that_have_room_is_no_equilibrium() -> None:
    room = 1e-5
    given = EXAMPLES["6.2"]((4, 2), 0.6)
    problem = replace(given, motion=replace(given.motion, min_area_fraction=1 - room))
    outer = Outer(problem)
    residual, q = outer.residual, np.zeros(outer.relocation.n_q)
    rows = outer.energy.validity.at(q)
    # a gradient that multipliers of the elements explain as a whole
    pull = residual.unit * rows.jacobian.T @ np.ones(rows.slack.size)
    assert residual.at(q, np.asarray(pull)) == pytest.approx(room)
    assert residual.at(q, np.zeros(q.size)) == 0


def test_the_multiplier_of_a_box_on_a_slope_is_the_rate_at_its_narrower_side() -> None:
    problem = sloped_block()  # boxes of 0.1 by 0.05 over slopes of 1 and 4 %: x is the side that stops nodes
    outer = Outer(problem)
    index, q = outer.relocation.mesh_map.positions.index, np.zeros(outer.relocation.n_q)
    node = next(n for n in problem.contact_nodes if index[0, n] == index[1, n] >= 0)
    move = index[0, node]
    q[move], gradient = 1.0, np.where(np.arange(q.size) == move, -3.0, 0.0)
    found = multipliers(outer.energy, q, gradient).box
    assert found[node] == pytest.approx(3.0 / 0.1)
    assert np.count_nonzero(found) == 1


def test_steps_that_raise_the_residual_are_not_taken() -> None:
    energy = ReducedEnergy(relocation(EXAMPLES["6.1"](n=3), parse_objective("energy + 0.01*quality")))
    given, here = np.zeros(energy.relocation.n_q), 1e-3
    q, residual, _ = regularised_descent._polished(energy, given, lambda point: 2 * here, here, 1e-9)
    assert (list(q), residual) == (list(given), here)


def test_an_interior_point_never_ends_above_its_start(monkeypatch) -> None:
    def solver(nlp, **_):
        return lambda first: SimpleNamespace(
            x=np.ones(1), f=-1.0, converged=True, status=Status.CONVERGED, iterations=3
        )

    monkeypatch.setattr(outer_solvers, "Solver", solver)
    nlp = SimpleNamespace(n_x=1, lbx=-2 * np.ones(1), ubx=2 * np.ones(1))
    program = SimpleNamespace(nlp=nlp, function=lambda q: SimpleNamespace(value=float(q @ q)))
    found = outer_solvers._run(program, nlp, np.array([0.5]), None, {}, "")
    assert (found.q[0], found.status) == (0.5, Status.STALLED)
    assert outer_solvers._run(program, nlp, np.array([1.5]), None, {}, "").q[0] == 1.0
