"""Kinks: labels against a search of all branches, descents that go on from there, and how ends are judged."""

from dataclasses import replace
from functools import cache
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations import nested as module
from formulations import outer_solvers
from formulations.finish import EXACT_FINISH, Finished, is_stationary
from formulations.nested import CREEPING, LONG_WINDOW, WINDOW, Creeping, Nested
from formulations.outer_solvers import OuterResult
from gallery.kinks import seal
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.descent import Watch
from rmesh_nlp.models.residual import Released
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.exploited import safe_discretisation
from rmesh_nlp.solving.outer import Outer
from support.endings import ended
from support.solved import example, solved


def leak(cost: float) -> str:
    return f"boundary(seal, {cost}*(y + uy) - y)"


def solved_to(problem: rm.ContactProblem, objective: str, formulation: str) -> tuple[rm.Solution, Array]:
    solution = rm.solve(problem, formulation, objective=objective)
    return solution, Outer.of(problem).variables(np.asarray(solution.mesh.p))


@cache
def end_of_seal() -> tuple[rm.ContactProblem, Array]:
    """A rough seal, and the edge at which ``mpcc`` ends: every node touches without force."""
    block = seal(3, 0.3)
    return block, solved_to(block, leak(2.0), "mpcc")[1]


SEAL, LEAK = seal(4, 0.0), leak(1.2)
"""At the best edge it touches in the middle without force."""


@pytest.mark.slow
def test_nested_settles_on_a_kink_where_mpcc_ends_and_both_are_labelled_alike() -> None:
    nested, mpcc = (rm.solve(SEAL, name, objective=LEAK) for name in ("nested", "mpcc"))
    rows = [solution.record() for solution in (nested, mpcc)]
    for solution, row in zip((nested, mpcc), rows, strict=True):
        assert (solution.status, row["stationarity"]) == (Status.CONVERGED, "S")
        assert row["label"] == "S (3 biactive pairs, B-stationary)"
        assert (row["b_stationary"], row["biactive"], row["descent_rate"]) == (True, 3, 0.0)
        assert len(row["biactive_nodes"]) == 3
        # the gradient with the contact set held is that of one side
        assert solution.assessment.first_order.residual > 1e-2
    assert rows[0]["objective_value"] == pytest.approx(rows[1]["objective_value"], rel=1e-8)
    assert rows[0]["outer"].endswith(f", then {EXACT_FINISH}")
    assert 0 < rows[0]["kkt_factorisations"] < rows[1]["kkt_factorisations"]
    assert nested.history[-1].objective == pytest.approx(rows[0]["objective_value"], rel=1e-12)
    iterations = [step.iteration for step in nested.history]
    assert iterations == sorted(iterations)


def test_a_kink_is_stationary_only_over_all_its_branches() -> None:
    """The gradient of one side may vanish where the other one descends."""

    def said(*, is_energy: bool, weak: bool, b_stationary: bool | None) -> bool:
        outer = SimpleNamespace(
            tolerance=1.0,
            residual=lambda _: 0.5,
            branches=lambda _: SimpleNamespace(b_stationary=b_stationary),
        )
        return is_stationary(outer, SimpleNamespace(is_energy=is_energy, weak=np.array([weak])))

    assert said(is_energy=True, weak=True, b_stationary=False)  # the energy has no kinks
    assert said(is_energy=False, weak=False, b_stationary=False)
    assert said(is_energy=False, weak=True, b_stationary=True)
    assert not said(is_energy=False, weak=True, b_stationary=False)


def test_where_a_constraint_is_violated_no_branch_is_labelled() -> None:
    outer = Outer.of(replace(SEAL, constraints=(rm.Constraint("resultant(bottom)", (50.0, np.inf)),)), LEAK)
    found = outer.branches(outer.function(np.zeros(outer.n)))
    assert (found.label, found.b_stationary) == ("", None)


@pytest.mark.slow
def test_a_finish_that_fails_is_not_taken_and_the_descent_that_is_left_is_said(monkeypatch):
    monkeypatch.setattr(module, "finished", lambda outer, q, monitor: Finished(q, False))
    solution = rm.solve(SEAL, "nested", objective=LEAK)
    row = solution.record()
    assert (solution.success, solution.status) == (True, Status.STALLED)
    assert (EXACT_FINISH in row["outer"], row["b_stationary"]) == (False, False)
    if row["biactive"]:
        assert row["descent_rate"] < -1e-6


def test_where_a_descent_creeps_the_finish_begins_at_its_best_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its last step may be a long one across a kink."""
    outer, begun = Outer.of(SEAL, LEAK), []
    start, best, last = (part * np.ones(outer.n) for part in (0.0, 0.2, 0.1))
    assert outer.function(best).value < outer.function(last).value < outer.function(start).value

    def creeping(_: Outer, q: Array, watch: Watch, *__: object) -> OuterResult:
        for iteration, point in enumerate((q, best, last)):
            watch(iteration, point)
        return OuterResult(last, Status.INTERRUPTED)

    monkeypatch.setattr(outer_solvers, "solved", creeping)
    monkeypatch.setattr(module, "finished", lambda outer, q, monitor: begun.append(q) or Finished(q, False))
    found = Nested().run(outer, start, rm.Monitor())
    assert found.status is Status.STALLED
    np.testing.assert_array_equal(begun, [best])
    np.testing.assert_array_equal(found.q, best)


@pytest.mark.slow
def test_an_end_that_was_asked_for_is_the_end() -> None:
    solution = rm.solve(SEAL, Nested(enough=0.1), objective=LEAK)
    assert solution.success
    assert solution.record()["outer"] == "newton"


def test_for_the_energy_there_is_no_kink() -> None:
    row = solved("nested", "6.3", (4, 2)).record()
    assert (row["stationarity"], row["outer"]) == ("KKT", "newton")
    assert not {"descent_rate", "label"} & row.keys()


@pytest.mark.slow
def test_a_residual_whose_multipliers_were_fitted_badly_is_no_proof_against_a_claim(monkeypatch):
    problem, objective = example("6.3", (4, 2)), "mean(top, -uy)"
    outer = Outer.of(problem, objective)
    q = outer.variables(np.asarray(solved("nested", "6.3", (4, 2), objective=objective).mesh.p))
    monkeypatch.setattr(Released, "residual", lambda *_: 1.0)
    for claim in (Status.CONVERGED, Status.STALLED):
        found = ended(outer, q, claim)
        assert (found.status, found.first_order.label["b_stationary"]) == (claim, claim is Status.CONVERGED)
    given = ended(outer, np.zeros(outer.n))  # what is claimed is looked at
    assert (given.status, given.first_order.stationarity) == (Status.NOT_STATIONARY, "none")


def _point(contact: int) -> SimpleNamespace:
    active = SimpleNamespace(key=lambda: bytes([contact]))
    return SimpleNamespace(equilibrium=SimpleNamespace(active=active))


@pytest.mark.parametrize(("changes", "part"), [(True, 0.5), (True, 2.0), (False, 0.5)])
def test_a_descent_creeps_if_hardly_anything_is_gained_and_contact_changes(changes, part):
    tell, gain = Creeping(), part * CREEPING / WINDOW
    said = [tell(_point(0), 0.0, 1.0)]
    said += [tell(_point(k % 2 if changes else 0), 0.0, -gain * k) for k in range(1, 2 * WINDOW)]
    assert not any(said[: WINDOW + 1])
    assert any(said) == (changes and part < 1)


def test_an_energy_creeps_over_a_longer_window_whatever_the_contact() -> None:
    tell = Creeping(LONG_WINDOW, is_kinked=False)
    said = [tell(_point(0), 0.0, -min(k, 5) / 5) for k in range(LONG_WINDOW + 10)]
    assert said.index(True) == LONG_WINDOW + 5


@pytest.mark.slow
def test_a_descent_ends_where_an_error_of_the_discretisation_is_minimised() -> None:
    """By midpoints, without limits, nodes run away from where the load acts: its energy falls for ever."""
    coarse, coarser = (replace(rm.EXAMPLES["6.1"](n), motion=rm.Motion(None)) for n in (8, 4))
    for problem, ends in ((coarse, True), (safe_discretisation(coarser), False)):
        outer, monitor = Outer.of(problem), rm.Monitor()
        found = Nested().run(outer, np.zeros(outer.n), monitor)
        assert found.details["outer"].endswith("was minimised") == ends
        rose = outer.continuous(found.q).energy >= outer.initial.energy
        assert (rose, monitor.budget.iterations in (64, 128, 256)) == (ends, ends)


def rates(outer: Outer, q: Array, ways: Array, step: float = 1e-5) -> Array:
    """Of the objective along directions (ways, n) by differences, the contact solved anew."""
    ends = [outer.function(outer.clipped(q + step * way)).value for way in ways]
    return (np.array(ends) - outer.function(q).value) / (step * outer.residual.unit)


@pytest.mark.slow
def test_a_kink_is_a_minimum_or_descends_by_the_weight_of_what_changes_there() -> None:
    """At the best edge of a seal every node touches without force; it is the best for some costs of a gap."""
    block, q = end_of_seal()
    ways = np.vstack([list(product((-1.0, 1.0), repeat=q.size)), np.eye(q.size), -np.eye(q.size)])
    for cost, is_best in ((2.0, True), (0.7, False)):
        outer = Outer.of(block, leak(cost))
        found, least = outer.branches(outer.function(q)), np.min(rates(outer, q, ways))
        assert found.pairs.size == 3
        assert (found.b_stationary, found.label == "S", least >= -1e-6) == (is_best, is_best, is_best)
        if is_best:
            assert found.rate == 0.0
        else:  # no corner of the unit box and no axis falls faster
            assert found.rate == pytest.approx(least, rel=1e-3)
            assert rates(outer, q, [found.direction]) == pytest.approx(found.rate, rel=1e-3)


def test_slips_that_are_given_have_no_friction_of_their_own() -> None:
    """The corner of the block is held sideways: its friction is any force up to the bound."""
    outer = Outer.of(seal(4, 0.3), leak(2.0))
    q = np.random.default_rng(2).uniform(-0.2, 0.0, outer.n)
    here, d = outer.function(q), np.random.default_rng(3).uniform(-1, 1, outer.n)
    hessian = outer.function.hessian(here)
    change = (outer.function(q + 1e-4 * d).gradient - outer.function(q - 1e-4 * d).gradient) / 2e-4
    np.testing.assert_allclose(hessian(d), change, atol=1e-5 * np.abs(change).max())


@pytest.mark.slow
def test_friction_that_sets_in_at_a_sliding_node_is_one_condition_and_not_two() -> None:
    """Gap, force and friction vanish together at grazing nodes of a seal, which slide."""
    block, q = end_of_seal()
    outer = Outer.of(block, leak(2.0))
    point = outer.function(q)
    program = outer.kkt
    rows, _ = program.mpcc.derivatives.jac_g(program.point(point), [])
    members = np.abs(rows.full().ravel()[program.mpcc.n_g :]).reshape(2, -1)
    vanish = np.flatnonzero(np.max(members, axis=0) < 1e-6)
    assert vanish.size > 3
    found = outer.branches(point)
    assert set(found.pairs) < set(vanish)
    assert np.all(found.pairs < program.parts.n_contact)
