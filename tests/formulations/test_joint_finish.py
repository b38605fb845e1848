"""Newton steps of ``joint`` from near a stationary point to one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from formulations.joint import Joint
from formulations.nested import Nested
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from support.formulations import joint

LOOSE = {"tol": 1e-3, "acceptable_tol": 1e-3, "tol_areas": 1e-6, "acceptable_tol_areas": 1e-6}
"""Ipopt then stops near a stationary point, not at one."""


@pytest.mark.parametrize(
    ("example", "arguments"),
    [("6.1", (4,)), ("6.3", ((4, 2),)), ("6.2", ((6, 3), (1.0, 0.5)))],
    ids=["boxes", "friction", "areas"],
)
def test_a_loose_end_is_finished_by_newton_steps_that_the_record_counts(
    example: str, arguments: tuple[Any, ...]
) -> None:
    steps: list[Step] = []
    solution = joint.solve(EXAMPLES[example](*arguments), settings=LOOSE, on_step=steps.append)
    record = solution.record()
    ipopt, newton = record["kkt_factorisations"], record["newton_steps"]
    assert newton > 0
    assert solution.status is Status.CONVERGED
    assert record["iterations"] == ipopt + newton == solution.history[-1].iteration
    assert record["contact_solves"] > 2
    exact = [step for step in solution.history if step.t == 0.0]
    assert len(exact) == newton + 1  # after Ipopt's iterates
    before, after = steps[ipopt], steps[-1]  # the last iterate of Ipopt, and the end
    assert before.dual_residual > 1e-6 >= after.dual_residual
    assert after.energy <= before.energy + 1e-9 * abs(before.energy)


def test_a_stationary_end_of_ipopt_is_left_as_it_is() -> None:
    record = joint.solve(EXAMPLES["6.1"](4)).record()
    assert "newton_steps" not in record
    assert record["contact_solves"] == 2  # at its start and at its end


@pytest.mark.parametrize("rise", [0.0, 1e-6])
def test_newton_steps_to_a_higher_energy_are_not_taken(rise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    outer = Outer(EXAMPLES["6.1"](3))
    begin = np.zeros(outer.n)
    end, energies = begin + 1e-3, outer.energy
    higher = replace(energies(begin), q=end, value=energies(begin).value * (1 - rise))
    near = {begin.tobytes(): 5e-3, end.tobytes(): 1e-9}
    outer.__dict__["residual"] = lambda point: near[point.q.tobytes()]
    monkeypatch.setattr(ReducedEnergy, "__call__", lambda self, q: higher if np.any(q) else self._last)
    monkeypatch.setattr(Nested, "run", lambda *_: Outcome(outer, end, Status.CONVERGED))
    found = Joint()._finished(outer, begin, Monitor())
    np.testing.assert_array_equal(found, begin if rise else end)
