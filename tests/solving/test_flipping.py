"""The verdict on rounds of flips and moves as a whole."""

from __future__ import annotations

from dataclasses import replace

import pytest

from support.formulations import fixed
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.flipping import _judged_as_a_whole
from rmesh_nlp.solving.solution import Solution


@pytest.fixture(scope="module")
def rounds() -> tuple[Solution, Solution]:
    """A first round that gained 0.2 of an energy of -1, and a last one that gained 0.1 more."""
    made = fixed.solve(EXAMPLES["6.2"]((4, 2)))
    measured = made.measured
    assert measured is not None
    found = []
    for before, after in ((-1.0, -1.2), (-1.2, -1.3)):
        gain = before - after
        figures = {"energy_initial": before, "energy": after, "energy_initial_audited": before}
        audit = replace(made.audit, energy_audited=after)
        judged = replace(measured, audit=audit, gain=gain, gain_audited=gain, decrease=gain, size=1.0)
        found.append(replace(made, **figures, audit=audit, measured=judged))
    return found[0], found[1]


def test_the_gain_is_that_of_all_rounds(rounds: tuple[Solution, Solution]) -> None:
    first, last = rounds
    whole = _judged_as_a_whole(first, last)
    assert (whole.status, whole.success) == (Status.CONVERGED, True)
    assert whole.measured is not None
    assert whole.measured.gain == pytest.approx(0.3)
    # what was exploited, or lost, in the last round alone is little beside the whole
    measured = replace(last.measured, gain=0.02, gain_audited=-0.001, decrease=-0.001)
    bad = replace(last, measured=measured, status=Status.EXPLOITED, success=False, improved=False)
    assert _judged_as_a_whole(first, bad).success


@pytest.mark.parametrize(
    ("audited", "status"),
    [(-1.28, Status.CONVERGED), (-0.9, Status.EXPLOITED)],
)
def test_the_audit_is_compared_over_all_rounds(
    rounds: tuple[Solution, Solution], audited: float, status: Status
) -> None:
    first, last = rounds
    last = replace(last, audit=replace(last.audit, energy_audited=audited))
    assert _judged_as_a_whole(first, last).status is status


def test_faults_of_the_last_mesh_stay_faults(rounds: tuple[Solution, Solution]) -> None:
    first, last = rounds
    rough = replace(last.measured, audit=replace(last.audit, equilibrium_residual=1.0))
    assert _judged_as_a_whole(first, replace(last, measured=rough)).status is Status.INACCURATE
    # also where the whole is worse than the mesh as given
    lower = replace(first, energy_initial=-2.0, energy_initial_audited=-2.0)
    found = _judged_as_a_whole(lower, replace(last, measured=rough))
    assert (found.status, found.valid, found.improved) == (Status.INACCURATE, False, False)
    found = _judged_as_a_whole(lower, last)
    assert (found.status, found.valid, found.improved) == (Status.WORSE, True, False)


def test_another_objective_keeps_the_verdict_of_the_last_round(rounds: tuple[Solution, Solution]) -> None:
    first, last = rounds
    other = replace(last, measured=replace(last.measured, is_energy=False))
    assert _judged_as_a_whole(replace(first, energy_initial=-5.0), other) is other
