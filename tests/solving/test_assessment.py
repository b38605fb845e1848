"""Valid, improved, stationary: what each finding makes of a solution; residuals of the laws by hand."""

from __future__ import annotations

import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.measures import (
    EXPLOITS,
    ContactResiduals,
    equilibrium_residual,
    law_residual,
)
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.assessment import EXPLOITED, FAILURES
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from support.conclusions import BROKEN, HOLDS, compared
from support.endings import Ends, ended
from support.solved import solve_once

NAN = float("nan")
STILL = {"stationary": False, "gain": 0.0, "gain_audited": 0.0, "decrease": 0.0}
ON_THE_WAY = {"stationary": False}
LIMITS = (Status.TIME_LIMIT, Status.ITERATION_LIMIT, Status.INTERRUPTED, Status.STALLED)
OTHERS = (Status.CYCLED, Status.INACCURATE, Status.INVALID_MESH)
TOO_LARGE = [ContactResiduals(*both) for both in ((2e-6, 0.0), (NAN, 0.0), (0.0, 2e-6), (0.0, NAN))]
FALL = ("gain", "gain_audited", "decrease")


CONCLUSIONS: dict[str, list[tuple[Status, dict[str, Any], Status]]] = {
    "not valid": [
        (Status.CONVERGED, {"min_area_ratio": 0.0}, Status.INVALID_MESH),
        (Status.CONVERGED, {"contact": Status.CYCLED}, Status.CYCLED),
        # the solver's own displacement does not solve the contact problem
        (Status.CONVERGED, {"own": BROKEN}, Status.INACCURATE),
        *((Status.CONVERGED, {"residuals": large}, Status.INACCURATE) for large in TOO_LARGE),
        (Status.CONVERGED, {"gain": NAN}, Status.EVALUATION_ERROR),
    ],
    "not improved": [
        (Status.CONVERGED, {"gain_audited": -1e-8, "decrease": -1e-8}, Status.EXPLOITED),
        (Status.CONVERGED, {"gain": 0.0, "gain_audited": -1e-8, "decrease": 0.1}, Status.EXPLOITED),
        (Status.CONVERGED, dict.fromkeys(FALL, -0.1), Status.WORSE),
        (Status.CONVERGED, {"is_energy": False, "decrease": -1e-8}, Status.WORSE),
        # the energy of the displacement in the files is above that of the given mesh
        (Status.CONVERGED, {"gain": -0.1, "audited_above": -0.1 - 1e-8}, Status.WORSE),
        (Status.CONVERGED, {"size": 1e-6, **dict.fromkeys(FALL, -5e-15)}, Status.WORSE),
        (Status.CONVERGED, {"size": 1e6, **dict.fromkeys(FALL, -5e-3)}, Status.WORSE),
    ],
    "success": [
        *((said, {}, Status.CONVERGED) for said in Status),  # stationary, whatever the solver says
        *((said, ON_THE_WAY, Status.NOT_STATIONARY) for said in (Status.CONVERGED, Status.ACCEPTABLE)),
        *((said, ON_THE_WAY, said) for said in LIMITS),
        # a point where a limit stopped a solver need not be a solution of its program
        (Status.TIME_LIMIT, {"own": BROKEN, **ON_THE_WAY}, Status.TIME_LIMIT),
        # a better mesh is never called infeasible: it is one at which the solver got stuck
        *((said, ON_THE_WAY, Status.STALLED) for said in (*FAILURES, *OTHERS)),
        (Status.FAILED, {**ON_THE_WAY, "decrease": 2e-8, "size": 10.0}, Status.STALLED),
        # another objective may be lowered at the cost of the energy
        (Status.CONVERGED, {"is_energy": False, "gain": -1.0}, Status.CONVERGED),
        # differences of rounding are none, relative to the objective's size, whatever its unit
        *(
            (Status.CONVERGED, {"size": unit, **dict.fromkeys(FALL, -5e-10 * unit)}, Status.CONVERGED)
            for unit in (1e-6, 1.0, 1e6)
        ),
    ],
    "no success": [
        *((said, STILL, said) for said in FAILURES),
        *((said, STILL, Status.FAILED) for said in OTHERS),
        (Status.FAILED, {**ON_THE_WAY, "decrease": 5e-9, "size": 10.0}, Status.FAILED),
    ],
}


@pytest.mark.parametrize("kind", CONCLUSIONS)
def test_what_follows_from_measurements(kind: str) -> None:
    for said, figures, status in CONCLUSIONS[kind]:
        found, valid, improved = compared(said, **figures), kind != "not valid", kind != "not improved"
        assert (found.status, found.valid, found.success) == (status, valid, kind == "success"), figures
        assert found.improved == improved or not valid, figures


@pytest.mark.parametrize("name", DISTORTIONS)
def test_a_rise_of_a_distortion_that_was_zero_is_measured_in_units_of_its_density(name: str) -> None:
    outer = Outer.of(EXAMPLES["6.1"](2), f"3*{name}")
    found = ended(outer, np.zeros(outer.n))
    assert found.given.objective_audited == 0
    for rise, improved in ((1e-17, True), (2e-9, True), (4e-9, False)):
        risen = replace(found.final, objective_audited=rise)
        assert replace(found, final=risen).improved is improved


@pytest.mark.parametrize("name", EXPLOITS)
def test_what_was_exploited_is_the_correction_that_costs_most(name: str) -> None:
    corrections = {**dict.fromkeys(EXPLOITS, 0.01), name: 0.2}
    rose = {"gain_audited": -0.1, "decrease": -0.1, "corrections": corrections}
    found = compared(**rose)
    assert (found.is_exploited, found.costliest) == (True, name)
    assert found.message.endswith(EXPLOITED[name].format(remedy="smaller elements there"))
    assert not compared(**{**rose, "gain_audited": 0.1, "decrease": 0.1}).is_exploited
    worse = compared(**rose, gain=-0.05)  # one's own measure says the same: the mesh is worse
    assert (worse.is_exploited, worse.status) == (False, Status.WORSE)


NUMBERS = st.sampled_from([0.0, 1e-12, -1e-12, 0.1, -0.1, NAN, float("inf")]) | st.floats(-1, 1)
RESIDUALS = st.sampled_from([0.0, 1e-6, 1.1e-6, NAN, float("inf")])
MEASURED = {
    "residuals": st.just(HOLDS) | st.builds(ContactResiduals, RESIDUALS, RESIDUALS),
    "min_area_ratio": st.sampled_from([0.5, 0.5, 0.0, -1.0, NAN]),
    "contact": st.sampled_from([*4 * [Status.CONVERGED], Status.CYCLED, Status.ITERATION_LIMIT]),
    "own": st.sampled_from([HOLDS, BROKEN]),
    **dict.fromkeys((*FALL, "audited_above"), NUMBERS),
    "size": st.sampled_from([0.0, 1.0, 1e3, NAN]),
    "is_energy": st.booleans(),
    "stationary": st.booleans(),
}
LEGITIMATE = {"converged", "not_stationary", "stalled", "iteration_limit", "time_limit", "interrupted"}
"""What docs/assessment.md allows as the status of a success."""


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(list(Status)), st.fixed_dictionaries(MEASURED))
def test_no_conclusion_contradicts_itself(said: Status, measured: dict[str, Any]) -> None:
    found = compared(said, **measured)
    word, rounding = found.status.value, 1e-9 * found.given.size
    assert (word == "converged") == (found.success and found.first_order.is_stationary)
    assert (word in ("worse", "exploited")) == (found.valid and not found.improved)
    if found.success:
        residuals = found.final.residuals
        assert found.valid
        assert found.improved
        assert word in LEGITIMATE
        assert np.max([residuals.equilibrium, residuals.complementarity]) <= 1e-6
        assert found.final.min_area_ratio > 0
        assert found.final.contact_status is Status.CONVERGED
        assert np.all(np.isfinite((found.gain, found.gain_audited, found.decrease)))
        assert found.decrease >= -rounding
        assert not found.objective.collapses or found.gain < 0 or found.gain_audited >= -rounding
        assert not found.objective.collapses or not found.gain_computed < -rounding
    elif found.improved:
        assert not found.decrease > rounding or not found.valid


@pytest.mark.parametrize("given_is_sick", [True, False])
def test_a_contact_solve_of_the_assessment_that_failed_is_a_fault(given_is_sick, monkeypatch) -> None:
    """Of either mesh: a gain is a difference of four of them."""
    outer = Outer.of(EXAMPLES["6.2"]((4, 2)))
    found, q = outer.initial, np.full(outer.n, 0.01)
    sick = replace(found, state=replace(found.state, status=Status.CYCLED))

    def continuous(_: Outer, q: Array) -> Admissible:
        return found if bool(np.any(q)) is given_is_sick else sick

    monkeypatch.setattr(Outer, "continuous", continuous)
    judged = ended(outer, q)
    assert (judged.status, judged.valid, judged.success) == (Status.CYCLED, False, False)


def pressed(*_: Any) -> Any:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("sign", [0.0, 1.0])
@pytest.mark.parametrize("when", ["during", "after"])
def test_ctrl_c_hides_no_fault_and_no_fault_hides_it(sign, when, monkeypatch) -> None:
    """``during`` the solve the mesh as given takes the place of a worse end, ``after`` it none does."""

    def end(outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        to = q + 0.5 * sign * np.sign(outer.energy(q).gradient) * outer.discretisation.mesh_map.upper
        if when == "during":
            monitor.attempt(pressed)
        else:
            assess = driver.assess
            monkeypatch.setattr(driver, "assess", lambda *a, **k: pressed() or assess(*a, **k))
        return Outcome(outer, to, Status.CONVERGED)

    found = solve_once(EXAMPLES["6.2"]((4, 2)), Ends(end))
    good = sign == 0 or when == "during"
    assert (found.status, found.success, found.assessment.improved) == (Status.INTERRUPTED, good, good)
    assert ("no success, worse" in found.message) == (not good)
    assert found.message.startswith(Status.INTERRUPTED.message)


SYSTEM = ContactSystem(
    stiffness=sp.csc_array(np.diag([10.0, 20.0, 30.0])),
    load=np.array([8.0, 0.0, 0.0]),
    constant=0.0,
    normals=sp.csr_array(np.array([[0.0, 1.0, 0.0]])),
    tangents=sp.csr_array(np.array([[0.0, 0.0, 1.0]])),
    offset=np.array([0.5]),
    slip_bound=np.array([4.0]),
)
"""The largest applied force, the unit of forces, is 8."""

SMOOTH = replace(SYSTEM, slip_bound=np.zeros(0))


def law(gap: float, force: float, slip: float = 0.0, friction: float = 0.0, system: Any = SYSTEM) -> float:
    """With the largest displacement 2."""
    u = np.array([2.0, gap - 0.5, slip])
    return law_residual(system, u, np.array([force]), np.array([friction]))


@pytest.mark.parametrize(
    ("gap", "force", "residual"),
    [
        (0.0, 3.0, 0.0),  # touches
        (0.7, 0.0, 0.0),  # open
        (-0.1, 3.0, 0.05),  # penetrates by a twentieth of the largest displacement
        (-0.1, 0.0, 0.05),
        (0.7, -0.4, 0.05),  # pulls with a twentieth of the largest force
        (0.2, 0.4, 0.05),  # both: the smaller one
        (0.05, 4.0, 0.025),
    ],
)
def test_the_contact_law(gap: float, force: float, residual: float) -> None:
    assert law(gap, force, system=SMOOTH) == pytest.approx(residual, abs=1e-15)
    assert law(gap, force, 0.0, 1.0) == pytest.approx(residual, abs=1e-15)  # sticks within the bound


@pytest.mark.parametrize(
    ("slip", "friction", "residual"),
    [
        (0.0, 3.9, 0.0),  # sticks
        (1.0, -4.0, 0.0),  # slides against the friction
        (-1.0, 4.0, 0.0),
        (2.0, 4.0, 1.0),  # is pulled along: 4 + 4 in units of 8
        (1.0, 0.0, 0.5),  # slides without friction: 4 of 8
        (0.25, -3.0, 0.125),  # slip 0.25 / 2 * 8 = 1, less than the reserve of the friction
        (0.0, 5.0, 0.125),  # above the bound
    ],
)
def test_the_friction_law(slip: float, friction: float, residual: float) -> None:
    assert law(0.0, 3.0, slip, friction) == pytest.approx(residual, abs=1e-15)


def test_the_worst_of_both_laws_counts() -> None:
    assert ContactResiduals(1e-6, 1e-6).hold  # what the documents promise
    assert not ContactResiduals(0.0, 1.01e-6).hold
    assert law(-0.1, 3.0, 1.0, 0.0) == pytest.approx(0.5)
    assert law(-1.4, 3.0, 1.0, 0.0) == pytest.approx(0.7)
    assert np.isnan(law(0.0, 3.0, 0.0, NAN))
    none, no_rows = np.zeros(0), sp.csr_array((0, 3))
    nothing = replace(SYSTEM, normals=no_rows, tangents=no_rows, offset=none, slip_bound=none)
    assert law_residual(nothing, np.ones(3), none, none) == 0


def test_a_body_at_rest_is_measured_too() -> None:
    """Nothing moves: without gap and force the laws hold, with a force of 8 across a gap they do not."""
    for gap, force, residual in ((0.0, 0.0, 0.0), (1e-6, 8.0, 1.0)):
        rest = replace(SMOOTH, offset=np.full(1, gap))
        assert law_residual(rest, np.zeros(3), np.full(1, force), np.zeros(0)) == pytest.approx(residual)


@pytest.mark.parametrize(
    ("load", "normal", "friction", "residual"),
    [(8.0, 3.0, 2.0, 12 / 8), (20.0, 3.0, 2.0, 7 / 20), (20.0, 10.0, 2.0, 4 / 20), (20.0, 10.0, 6.0, 0.0),
     (20.0, 10.0, None, 6 / 20)],
)  # fmt: skip
def test_equilibrium_is_the_largest_force_out_of_balance(load, normal, friction, residual) -> None:
    """K u - F - N^T lambda - T^T tau by hand: (20 - F, 10 - lambda, 6 - tau) over F."""
    system = replace(SMOOTH if friction is None else SYSTEM, load=np.array([load, 0.0, 0.0]))
    tau = np.zeros(0) if friction is None else np.array([friction])
    found = equilibrium_residual(system, np.array([2.0, 0.5, 0.2]), np.array([normal]), tau)
    assert found == pytest.approx(residual, abs=1e-15)
