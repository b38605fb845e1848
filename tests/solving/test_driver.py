"""The driver of all formulations, with the one of docs/own_formulation.md as a third party writes it."""

import itertools
import signal
from contextlib import suppress
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.multistart import MultiStart
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize import budget
from rmesh_nlp.optimize.budget import Limits, checkpoint
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.parts import Step
from support.endings import Chooses, Ends
from support.formulations import alternating
from support.solved import solved

Alternating = alternating()


@pytest.fixture(scope="module")
def problem() -> rm.ContactProblem:
    return rm.EXAMPLES["6.2"]((4, 2))


@pytest.mark.slow
def test_a_formulation_of_one_s_own_has_all_that_others_have(problem: rm.ContactProblem) -> None:
    seen: list[Step] = []
    solution = rm.solve(problem, Alternating(first_step=0.1), tolerance=3e-2, on_step=seen.append)
    record = solution.record()
    assert solution.status is rm.Status.CONVERGED
    assert solution.assessment.gain_audited > 0.9 * solved("joint", "6.2", (4, 2)).assessment.gain_audited
    assert (record["formulation"], record["start"]) == ("alternating", "given")
    assert record["settings"] == {"first_step": 0.1}
    for steps in (seen, solution.history):
        assert [step.iteration for step in steps] == list(range(solution.trace.iterations + 1))
    assert solution.history[-1].dual_residual == pytest.approx(solution.assessment.first_order.residual)
    np.testing.assert_array_equal(seen[0].q, 0.0)
    assert all(step.q is None for step in solution.history)
    assert np.all(np.diff([step.contact_solves for step in seen]) >= 0)
    assert solution.trace.work.contact_solves >= solution.trace.iterations
    assert min(solution.trace.build_time_s, solution.trace.solve_time_s, solution.trace.audit_time_s) > 0


def test_derivatives_that_are_no_numbers_end_in_a_row_that_says_so() -> None:
    """The derivative of 1 / (1 + exp(-k x)) is inf / inf where the power overflows."""
    problem = rm.ContactProblem(
        rm.shapes.rectangle(4, 2, x=(0, 2)),
        rm.Laplace(-1.0),
        ("bottom",),
        rm.Obstacle("right", (1.0,), 0.5),
        tractions=(rm.Traction("top", (lambda x, y: -6 / (1 + ca.exp(-1e9 * (x - 1.7123))),)),),
    )
    solution = rm.solve(problem, "joint")
    assert (solution.status, solution.success) == (rm.Status.EVALUATION_ERROR, False)


@pytest.mark.parametrize(
    ("limits", "status"),
    [(Limits(iterations=3), rm.Status.ITERATION_LIMIT), (Limits(seconds=1e-6), rm.Status.TIME_LIMIT)],
)
@pytest.mark.parametrize("around", [lambda inner: inner, lambda inner: MultiStart(inner, 2)])
def test_limits_hold_for_it_and_for_what_wraps_it(problem, limits, status, around) -> None:
    solution = rm.solve(problem, around(Alternating()), limits=limits)
    assert (solution.status, solution.success) == (status, True)
    assert solution.trace.iterations == (limits.iterations or 0)
    assert solution.record()["limits"] == limits.changed()
    assert solution.assessment.gain_audited >= 0
    assert (solution.assessment.gain_audited > 0) == (status is rm.Status.ITERATION_LIMIT)


@pytest.mark.parametrize("during", ["reduced_error", "surviving_gain"])
def test_ctrl_c_after_the_assessment_keeps_the_solution(problem, during, monkeypatch) -> None:
    def press(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(driver, during, press)
    solution = rm.solve(problem, certify=True)
    assert (solution.status, solution.success) == (rm.Status.INTERRUPTED, True)
    assert solution.energy == solved("joint", "6.2", (4, 2)).energy
    assert (solution.error_reduction is None) == (during == "reduced_error")
    assert solution.certificate is solution.certificate_remark is None  # nothing more is begun


@pytest.mark.parametrize(("formulation", "share"), [("fixed", 0.5), ("fixed", 0.9), ("joint", 0.6)])
def test_a_time_limit_ends_audits_and_what_follows(formulation, share, monkeypatch) -> None:
    """By a clock that each look moves on. What was not done then is missing, and no success without audit."""
    looks = itertools.count()
    monkeypatch.setattr("time.perf_counter", lambda: float(next(looks)))
    monkeypatch.setattr(budget, "LEAST_AUDIT", 0.0)
    monkeypatch.setattr(driver, "MOST", 2000)
    body = rm.EXAMPLES["6.2"]((4, 2))
    whole = rm.solve(body, formulation, limits=Limits(seconds=1e9, iterations=2), certify=True)
    most = share * whole.trace.wall_time_s
    found = rm.solve(body, formulation, limits=Limits(most, 2), certify=True)
    row, is_audited = found.record(), bool(np.isfinite(found.energy_audited))
    assert found.trace.wall_time_s < most + 15
    assert (found.valid, found.success, found.energy_initial) == (True, is_audited, whole.energy_initial)
    assert is_audited or (row["status"], row["solver_status"]) == ("unaudited", "time_limit")
    assert "certificate_remark" in row or row["estimates_remark"] == driver.ENDED


def test_a_limit_before_the_last_load_step_is_no_success() -> None:
    loads = (rm.Traction("top", (0.0, -30.0)),)
    body = replace(rm.EXAMPLES["6.3"]((4, 2)), steps=(rm.LoadStep(tractions=loads),))
    found = rm.solve(body, "fixed", limits=Limits(seconds=1e-6))
    assert not found.success
    assert found.message.endswith("It ended before the last load step.")


def test_ctrl_c_in_an_audit_keeps_the_mesh(problem, monkeypatch) -> None:
    monkeypatch.setattr(budget, "LEAST_AUDIT", 0.0)

    def end(outer: rm.Outer, q: Array, monitor: rm.Monitor) -> rm.Outcome:
        to = q - 0.1 * np.sign(outer.energy(q).gradient) * outer.discretisation.mesh_map.upper
        monkeypatch.setattr(
            rm.Outer, "continuous", lambda *_: signal.raise_signal(signal.SIGINT) or checkpoint()
        )
        return rm.Outcome(outer, to, rm.Status.CONVERGED)

    found = rm.solve(problem, Ends(end))
    assert (found.status, found.success) == (rm.Status.INTERRUPTED, False)
    assert found.energy < found.energy_initial


def test_ctrl_c_is_not_lost_where_its_exception_is_swallowed(problem: rm.ContactProblem) -> None:
    """CasADi drops a KeyboardInterrupt that comes while it looks at an attribute: here of the formulation."""

    def press(step: Step) -> None:
        if step.iteration == 2:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    solution = rm.solve(problem, Alternating(), on_step=press)
    assert (solution.status, solution.success, solution.trace.iterations) == (rm.Status.INTERRUPTED, True, 2)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.slow
@pytest.mark.parametrize("way", ["tracked", "raised"])
def test_what_is_stopped_is_never_made_worse(problem: rm.ContactProblem, way: str) -> None:
    """A formulation that only goes uphill."""

    def end(outer: rm.Outer, q: Array, monitor: rm.Monitor) -> rm.Outcome:
        to = 0.5 * np.sign(outer.function(q).gradient) * outer.discretisation.mesh_map.upper
        monitor.track(outer).exact(0, to)
        if way == "raised":
            raise KeyboardInterrupt
        return rm.Outcome(outer, to, rm.Status.CONVERGED)

    stopped = rm.solve(problem, Ends(end), limits=Limits(seconds=1e-6))
    assert stopped.status in (rm.Status.TIME_LIMIT, rm.Status.INTERRUPTED)
    assert stopped.success
    np.testing.assert_array_equal(stopped.mesh.p, problem.mesh.p)
    if way != "raised":  # what ends by itself is shown as it is, but not by what chose the formulation
        worse = rm.solve(problem, Ends(end))
        assert (worse.status, worse.success) == (rm.Status.WORSE, False)
        given = rm.solve(problem, Chooses(end))
        assert (given.status, given.success) == (rm.Status.STALLED, True)
        np.testing.assert_array_equal(given.mesh.p, problem.mesh.p)


def test_an_invalid_end_is_reported_and_not_hidden(problem: rm.ContactProblem) -> None:
    solution = rm.solve(problem, Ends(lambda outer, q, _: rm.Outcome(outer, q + 50.0, rm.Status.CONVERGED)))
    found, final = solution.assessment, solution.assessment.final
    assert found.status is rm.Status.INVALID_MESH
    assert (found.valid, found.improved, found.success) == (False, False, False)
    assert np.all(np.isnan([*final.displacement.ravel(), *final.pressure, final.energy]))
    assert final.min_area_ratio < 0
    assert solution.record()["energy"] is None


@pytest.mark.slow
def test_a_formulation_begins_where_the_one_that_is_named_ended(problem: rm.ContactProblem) -> None:
    begun: list[tuple[rm.Outer, Array]] = []

    def end(outer: rm.Outer, q: Array, _: rm.Monitor) -> rm.Outcome:
        begun.append((outer, q))
        return rm.Outcome(outer, q, rm.Status.CONVERGED)

    first, then = solved("joint", "6.2", (4, 2)), rm.solve(problem, Ends(end), start="joint")
    ((outer, q),) = begun
    assert outer.is_near
    np.testing.assert_allclose(outer.nodes(q), first.mesh.p, atol=1e-12)
    assert (then.start, then.trace.iterations) == ("joint", first.trace.iterations)


@pytest.mark.parametrize(
    ("details", "words"),
    [({"energy": -1e9}, "the driver itself writes energy"), ({"a": {1}}, "type set is not JSON")],
)
def test_what_the_driver_measures_is_not_written_over(details: dict[str, object], words: str) -> None:
    outer = rm.Outer.of(rm.EXAMPLES["6.1"](2))
    with pytest.raises(rm.BadInputError, match=words):
        rm.Outcome(outer, np.zeros(outer.n), rm.Status.CONVERGED, details=details)


@pytest.mark.parametrize("formulation", ["fixed", "nested"])
def test_without_an_audit_the_solution_is_the_solver_s_and_no_success(problem, formulation) -> None:
    whole, alone = rm.solve(problem, formulation), rm.solve(problem, formulation, audit=False)
    assert np.array_equal(alone.mesh.p, whole.mesh.p)
    assert alone.energy == whole.energy
    assert (alone.status, alone.success, alone.valid) == (rm.Status.UNAUDITED, False, True)
    record = alone.record()
    assert record["energy_audited"] is record["gain_audited"] is None
    assert (record["status"], record["solver_status"]) == ("unaudited", whole.record()["solver_status"])
    assert "audited energy" not in dict(alone.summary())


@pytest.mark.parametrize("wrong", [{"audit": 1}, {"audit": False, "certify": True}])
def test_an_audit_is_a_flag_and_a_certificate_needs_one(problem, wrong) -> None:
    with pytest.raises(rm.BadInputError, match="audit"):
        rm.solve(problem, "fixed", **wrong)
