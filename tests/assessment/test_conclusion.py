"""Valid, improved, stationary: what each finding makes of a solution."""

from __future__ import annotations

import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rmesh_nlp.assessment.assessor import EXPLOITS, Audit
from rmesh_nlp.assessment.conclusion import FAILURES, Conclusion, Measured, conclusion
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Obstacle, PlaneStrain, ProblemError
from rmesh_nlp.solving import assess as assessing
from rmesh_nlp.solving import clock, driver
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from support.conclusions import GOOD
from support.endings import Ends, ended
from support.solved import solve_once


def with_audit(**changes: Any) -> Measured:
    return replace(GOOD, audit=replace(GOOD.audit, **changes))


@pytest.mark.parametrize(
    ("measured", "status", "valid", "improved"),
    [
        (with_audit(min_area_ratio=0.0), Status.INVALID_MESH, False, True),
        (replace(GOOD, contact=Status.CYCLED), Status.CYCLED, False, True),
        (replace(GOOD, consistent=False), Status.INACCURATE, False, True),
        (with_audit(equilibrium_residual=2e-6), Status.INACCURATE, False, True),
        (with_audit(complementarity_residual=2e-6), Status.INACCURATE, False, True),
        (with_audit(equilibrium_residual=float("nan")), Status.INACCURATE, False, True),
        (with_audit(complementarity_residual=float("nan")), Status.INACCURATE, False, True),
        (replace(GOOD, gain_audited=-1e-8, decrease=-1e-8), Status.EXPLOITED, True, False),
        (replace(GOOD, gain=0.0, gain_audited=-1e-8, decrease=0.1), Status.EXPLOITED, True, False),
        (replace(GOOD, gain=-0.1, gain_audited=-0.1, decrease=-0.1), Status.WORSE, True, False),
        (replace(GOOD, is_energy=False, decrease=-1e-8), Status.WORSE, True, False),
        (replace(GOOD, gain=-0.1, gain_computed=-1e-8), Status.WORSE, True, False),
    ],
)
def test_each_finding_has_a_status_and_is_no_success(
    measured: Measured, status: Status, valid: bool, improved: bool
) -> None:
    assert conclusion(Status.CONVERGED, measured) == Conclusion(valid, improved, True, False, status)


def test_another_objective_may_be_lowered_at_the_cost_of_the_energy() -> None:
    assert conclusion(Status.CONVERGED, replace(GOOD, is_energy=False, gain=-1.0, gain_computed=-1.0)).success


@pytest.mark.parametrize("name", EXPLOITS)
def test_what_was_exploited_is_the_correction_that_costs_most(name: str) -> None:
    corrections = {**dict.fromkeys(EXPLOITS, 0.01), name: 0.2}
    rose = replace(GOOD, gain_audited=-0.1, decrease=-0.1, corrections=corrections)
    assert rose.exploits == name
    assert replace(rose, gain_audited=0.1, decrease=0.1).exploits == ""
    # one's own measure says the same: nothing was exploited, the mesh is worse
    assert replace(rose, gain=-0.05).exploits == ""
    assert conclusion(Status.CONVERGED, replace(rose, gain=-0.05)).status is Status.WORSE


def test_differences_of_rounding_are_none() -> None:
    tiny = replace(GOOD, gain=1e-10, gain_audited=-1e-10, decrease=-1e-10)
    assert conclusion(Status.CONVERGED, tiny).success
    # relative to the objective's size, whatever its unit
    for unit in (1e-6, 1e6):
        figures = {"gain": 5e-10 * unit, "gain_audited": -5e-10 * unit, "decrease": -5e-10 * unit}
        assert conclusion(Status.CONVERGED, replace(GOOD, size=unit, **figures)).success
        larger = {name: 10 * figure for name, figure in figures.items()}
        assert not conclusion(Status.CONVERGED, replace(GOOD, size=unit, **larger)).success


@pytest.mark.parametrize("said", list(Status))
def test_a_stationary_point_is_converged_whatever_the_solver_says(said: Status) -> None:
    judged = conclusion(said, GOOD)
    assert judged.status is Status.CONVERGED
    assert judged.success


@pytest.mark.parametrize(
    ("said", "status"),
    [
        (Status.CONVERGED, Status.NOT_STATIONARY),
        (Status.ACCEPTABLE, Status.NOT_STATIONARY),
        (Status.TIME_LIMIT, Status.TIME_LIMIT),
        (Status.INTERRUPTED, Status.INTERRUPTED),
        (Status.STALLED, Status.STALLED),
    ],
)
def test_a_point_that_is_not_stationary_keeps_its_limit_and_may_be_a_success(
    said: Status, status: Status
) -> None:
    judged = conclusion(said, replace(GOOD, stationary=False))
    assert (judged.status, judged.success, judged.stationary) == (status, True, False)


@pytest.mark.parametrize("said", [*FAILURES, Status.CYCLED, Status.INACCURATE, Status.INVALID_MESH])
def test_a_failed_solver_needs_a_gain(said: Status) -> None:
    still = replace(GOOD, stationary=False, gain=0.0, gain_audited=0.0, decrease=0.0)
    judged = conclusion(said, still)
    assert not judged.success
    assert judged.status is (said if said in FAILURES else Status.FAILED)
    # a success is never called infeasible: the better mesh is one at which the solver got stuck
    gained = conclusion(said, replace(GOOD, stationary=False))
    assert (gained.status, gained.success) == (Status.STALLED, True)


@pytest.mark.parametrize(("decrease", "status"), [(5e-9, Status.FAILED), (2e-8, Status.STALLED)])
def test_a_gain_of_rounding_excuses_no_failed_solver(decrease: float, status: Status) -> None:
    measured = replace(GOOD, stationary=False, decrease=decrease, size=10.0)
    assert conclusion(Status.FAILED, measured).status is status


def test_an_energy_that_the_solver_made_up_is_a_fault() -> None:
    judged = conclusion(Status.CONVERGED, replace(GOOD, consistent=False))
    assert (judged.status, judged.valid, judged.success) == (Status.INACCURATE, False, False)
    # of a point where a limit stopped a solver it is no claim
    assert conclusion(Status.TIME_LIMIT, replace(GOOD, consistent=False)).success


figures = st.one_of(
    st.sampled_from([0.0, 1e-12, -1e-12, 0.1, 0.0899, 0.0901, -0.1, 0.05, float("nan"), float("inf")]),
    st.floats(-1, 1),
)
residuals = st.sampled_from([0.0, 9.9e-7, 1e-6, 1.1e-6, float("nan"), float("inf")])
measurements = st.builds(
    Measured,
    audit=st.builds(
        Audit,
        energy_audited=figures,
        equilibrium_residual=residuals,
        complementarity_residual=residuals,
        min_area_ratio=st.sampled_from([0.5, 0.0, -1.0, float("nan")]),
        penetration=st.just(0.0),
    ),
    contact=st.sampled_from([Status.CONVERGED, Status.CONVERGED, Status.CYCLED, Status.ITERATION_LIMIT]),
    consistent=st.booleans(),
    gain=figures,
    gain_audited=figures,
    decrease=figures,
    size=st.sampled_from([0.0, 1.0, 1e3, float("nan")]),
    is_energy=st.booleans(),
    stationary=st.booleans(),
)
sound = st.builds(
    lambda gain, decrease, is_energy, stationary, consistent: replace(
        GOOD,
        gain=gain,
        gain_audited=gain,
        decrease=decrease,
        is_energy=is_energy,
        stationary=stationary,
        consistent=consistent,
    ),
    *2 * [figures],
    *3 * [st.booleans()],
)
LEGITIMATE = {"converged", "not_stationary", "stalled", "iteration_limit", "time_limit", "interrupted"}
"""What docs/assessment.md allows as the status of a success."""
FAILED = {"infeasible", "unbounded", "too_few_freedoms", "evaluation_error", "failed"}
FAULTS = {"invalid_mesh", "cycled", "iteration_limit", "inaccurate", "evaluation_error"}


@settings(max_examples=250, deadline=None)
@given(st.sampled_from(list(Status)), st.one_of(measurements, sound))
def test_no_conclusion_contradicts_itself(said: Status, measured: Measured) -> None:
    judged = conclusion(said, measured)
    word = judged.status.value
    assert judged.stationary == measured.stationary
    assert (word == "converged") == (judged.success and judged.stationary)
    if judged.success:
        audit, numbers = measured.audit, (measured.gain, measured.gain_audited, measured.decrease)
        assert judged.valid
        assert judged.improved
        assert word in LEGITIMATE
        assert audit.equilibrium_residual <= 1e-6
        assert audit.complementarity_residual <= 1e-6
        assert audit.min_area_ratio > 0
        assert np.all(np.isfinite(numbers))
        assert measured.contact is Status.CONVERGED
        assert measured.decrease >= -1e-9 * measured.size
        if measured.is_energy and measured.gain >= 0:
            assert measured.gain_audited >= -1e-9 * measured.size
    elif not judged.valid:
        assert word in FAULTS
    elif not judged.improved:
        assert word in ("worse", "exploited")
    else:
        assert word in FAILED
        assert not measured.decrease > 1e-9 * measured.size


def test_a_contact_solve_that_failed_anywhere_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one of the audit, or on the given mesh: a gain is a difference of four of them."""
    for number in range(2):
        outer = Outer(EXAMPLES["6.2"]((4, 2)))
        found = outer.assessor.initial
        sick = replace(found, state=replace(found.state, status=Status.CYCLED))
        outer.assessor.__dict__["initial"] = (found, sick)[number]
        monkeypatch.setattr(outer.assessor, "solve", lambda *_, end=(sick, found)[number]: end)
        judged = ended(outer, np.zeros(outer.n))
        assert (judged.status, judged.valid, judged.success) == (Status.CYCLED, False, False)
    ill = Outer(EXAMPLES["6.2"]((4, 2)))
    ill.given = replace(ill.given, status=Status.ITERATION_LIMIT)
    ill.energy.knows(ill.given)
    judged = ended(ill, np.zeros(ill.n))
    assert (judged.status, judged.success) == (Status.ITERATION_LIMIT, False)
    assert judged.solver_status is Status.CONVERGED


def pressed(*_: Any) -> Any:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("sign", [0.0, 1.0])
@pytest.mark.parametrize("when", ["during", "after"])
def test_ctrl_c_hides_no_fault_and_no_fault_hides_it(
    sign: float, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``during`` the solve the mesh as given takes the place of a worse end, ``after`` it none does."""

    def end(outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        to = q + 0.5 * sign * np.sign(outer.energy(q).gradient) * outer.bound
        if when == "during":
            monitor.attempt(pressed)
        else:
            assess = driver.assess
            monkeypatch.setattr(driver, "assess", lambda *a, **k: pressed() or assess(*a, **k))
        return Outcome(outer, to, Status.CONVERGED)

    found = solve_once(EXAMPLES["6.2"]((4, 2)), Ends(end))
    good = sign == 0 or when == "during"
    assert (found.status, found.success, found.improved) == (Status.INTERRUPTED, good, good)
    assert ("no success, worse" in found.message) == (not good)
    assert found.message.startswith(Status.INTERRUPTED.message)


def test_a_claimed_energy_is_checked() -> None:
    outer = Outer(EXAMPLES["6.2"]((4, 2)))
    q, value = np.zeros(outer.n), outer.energy(np.zeros(outer.n)).value
    wrong, right = (ended(outer, q, claimed=value * (1 + part)) for part in (1e-5, 1e-8))
    assert (wrong.status, wrong.success) == (Status.INACCURATE, False)
    assert (right.status, right.success) == (Status.NOT_STATIONARY, True)


@pytest.mark.parametrize(
    ("law", "dirichlet", "obstacle"),
    [
        (Laplace(-1.0), ("left", "right", "top", "bottom"), Obstacle.interior(0.5)),
        (
            PlaneStrain(1.0, 1.0),
            (Dirichlet("left", (0.0, -0.1)),),
            Obstacle("bottom", (0.0, 1.0), 0.0),
        ),
        (PlaneStrain(1.0, 1.0), ("left",), Obstacle.graph("bottom", 0.2)),
    ],
)
def test_given_displacements_that_violate_a_gap_are_refused(law, dirichlet, obstacle) -> None:
    with pytest.raises(ProblemError, match=r"no displacement is admissible.* node \d+.* gap -0\.[125]"):
        ContactProblem(rectangle(4, 4), law, dirichlet, obstacle)


def test_the_default_tolerance_is_what_docs_promise() -> None:
    assert clock.TOLERANCE == 1e-6
    assert assessing.ENERGY_AGREEMENT == 1e-6
