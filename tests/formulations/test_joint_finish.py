"""Newton steps of ``joint`` from near a stationary point to one."""

from __future__ import annotations

import pytest

from support.formulations import joint
from rmesh_nlp.examples import EXAMPLES, Size

LOOSE = {"tol": 1e-3}
"""Ipopt then stops near a stationary point, not at one."""


@pytest.mark.parametrize(("example", "size"), [("6.1", 4), ("6.3", (4, 2))])
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(example: str, size: Size) -> None:
    problem = EXAMPLES[example](size)
    steps = []
    record = joint.solve(problem, settings=LOOSE, on_step=steps.append).record()
    ipopt, newton = record["kkt_factorisations"], record["newton_steps"]
    assert newton > 0
    assert record["iterations"] == ipopt + newton
    assert record["contact_solves"] > 1
    assert record["stationarity_residual"] <= 1e-6
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 1
