"""What verdicts rest on, measured again here by other means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formulations import fixed, joint
from rmesh_nlp.assessment.verdict import Measured, Verdict, verdict
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solution.referee import Referee
from support.verdicts import GOOD


@pytest.mark.parametrize(
    ("said", "measured", "judged"),
    [
        (Status.STALLED, GOOD, Verdict(True, True, True, True, Status.CONVERGED)),
        (
            Status.CONVERGED,
            replace(GOOD, stationary=False),
            Verdict(True, True, False, True, Status.NOT_STATIONARY),
        ),
        (
            Status.CONVERGED,
            replace(GOOD, consistent=False),
            Verdict(False, True, True, False, Status.INACCURATE),
        ),
        (
            Status.CONVERGED,
            replace(GOOD, gain=-0.1, gain_audited=-0.1, decrease=-0.1),
            Verdict(True, False, True, False, Status.WORSE),
        ),
        (
            Status.CONVERGED,
            replace(GOOD, contact=Status.CYCLED),
            Verdict(False, True, True, False, Status.CYCLED),
        ),
    ],
)
def test_the_three_findings_are_kept_apart(said: Status, measured: Measured, judged: Verdict) -> None:
    assert verdict(said, measured) == judged


def test_the_least_area_ratio_is_that_of_the_shoelace_formula() -> None:
    solution = joint.solve(EXAMPLES["6.1"](4))
    areas = []
    for mesh in (solution.problem.mesh.p, solution.mesh.p):
        (x0, y0), (x1, y1), (x2, y2) = (mesh[:, corner] for corner in solution.problem.mesh.t)
        areas.append(np.abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)) / 2)
    given, moved = areas
    assert np.min(moved / given) < 0.99
    assert solution.audit.min_area_ratio == pytest.approx(np.min(moved / given), rel=1e-12)


def test_gains_are_differences_to_the_given_mesh_by_one_rule_each() -> None:
    problem = EXAMPLES["6.2"]((4, 2))
    given, moved = fixed.solve(problem), joint.solve(problem)
    assert moved.gain == pytest.approx(given.energy - moved.energy, rel=1e-9)
    accurate = given.audit.energy_audited - moved.audit.energy_audited
    assert moved.gain_audited == pytest.approx(accurate, rel=1e-9)
    assert given.gain == given.gain_audited == 0


def test_a_mesh_that_cannot_be_solved_on_is_neither_valid_nor_improved() -> None:
    referee = Referee(EXAMPLES["6.1"](3))
    q = np.full(referee.relocation.n_q, 10.0)
    solution = referee.judge("joint", q, status=Status.CONVERGED, history=[], iterations=0, contact_solves=0)
    assert solution.status is Status.INVALID_MESH
    assert (solution.valid, solution.improved, solution.success) == (False, False, False)
