"""Time limits and Ctrl-C during ``auto``: the best mesh so far is the solution, and the record says so."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from formulations import cascade as of_formulation
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.models import cascade as of_cascade
from rmesh_nlp.models.cascade import cascade
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.regularised_descent import finished
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import (
    signed_areas,
)
from rmesh_nlp.solving import outer as of_outer
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.parts import Step
from support.formulations import auto
from support.problems import no_boxes


def test_nothing_more_is_stated_once_the_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = []
    for module in (of_cascade, of_outer):
        monkeypatch.setattr(module, "relocation", lambda *a, make=relocation: stated.append(a) or make(*a))
    problem = no_boxes(EXAMPLES["6.1"](n=16))
    row = auto.solve(problem, time_limit_s=1e-9).record()
    assert row["status"] == "time_limit"
    assert row["valid"]
    assert row["gain"] == 0
    assert row.get("error_reduction") is None
    assert len(stated) == 1  # that of the audit


def test_a_cascade_that_is_late_prolongs_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = []
    monkeypatch.setattr(of_cascade, "relocation", lambda *a: stated.append(a) or relocation(*a))
    problem = replace(no_boxes(EXAMPLES["6.1"](n=16)), quadrature=6)
    result = cascade(problem, is_late=lambda: len(stated) > 0)
    assert len(stated) == 1  # the first weight on the coarsest mesh
    assert [level.nodes for level in result.levels] == [81]
    assert result.status is Status.INTERRUPTED
    assert np.any(result.q != 0)
    nodes = MeshMap.of(problem).positions.values(result.q)
    assert np.all(signed_areas(nodes, problem.triangles) > 0)
    energies = [ContactSolver(problem).solve(x).energy for x in (problem.mesh.p, nodes)]
    assert energies[1] < energies[0]


def test_a_time_limit_on_the_way_to_a_stationary_point_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(*given, **options):
        monkeypatch.setattr(Monitor, "remaining", 0.0)
        return finished(*given, **options)

    monkeypatch.setattr(of_formulation, "finished", late)
    row = auto.solve(no_boxes(EXAMPLES["6.1"](n=3))).record()
    assert row["status"] == "time_limit"
    assert row["valid"]
    assert row["gain_audited"] > 0
    assert row.get("error_reduction") is None


class Interrupting:
    """Ctrl-C in the first step that ``when`` is true of."""

    def __init__(self, when: Callable[[Step], bool]) -> None:
        self.when, self.steps, self.pressed = when, [], False

    def __call__(self, step: Step) -> None:
        self.steps.append(step)
        if not self.pressed and self.when(step):
            self.pressed = True
            raise KeyboardInterrupt


@pytest.mark.slow
def test_ctrl_c_on_a_coarse_mesh_keeps_the_map_that_there_is() -> None:
    problem = no_boxes(EXAMPLES["6.1"](n=16))
    press = Interrupting(lambda step: step.iteration == 6)
    solution = auto.solve(problem, on_step=press)
    assert press.pressed
    assert all(step.q is None for step in press.steps)  # the given mesh was not reached
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    assert solution.record()["gain_audited"] > 0


def test_ctrl_c_on_the_way_to_a_stationary_point_keeps_the_best_mesh() -> None:
    problem = no_boxes(EXAMPLES["6.1"](n=3))
    # the steps of that way are the ones of which no limit of iterations is known
    press = Interrupting(lambda step: step.iteration > 5 and not math.isfinite(step.seconds_left))
    solution = auto.solve(problem, on_step=press)
    assert press.pressed
    assert solution.status is Status.INTERRUPTED
    assert solution.valid
    finest = [step for step in press.steps if step.q is not None]
    assert solution.energy <= finest[0].energy
    assert solution.record()["gain_audited"] > 0


@pytest.mark.slow
def test_the_way_to_a_stationary_point_keeps_to_its_contact_solves() -> None:
    problem = replace(no_boxes(EXAMPLES["6.1"](n=3)), quadrature=8)
    free = auto.solve(problem, tolerance=1e-15)  # a tolerance that is not met
    most = free.contact_solves - 1
    held = auto.solve(problem, tolerance=1e-15, settings={"most": most})
    assert held.contact_solves <= most
    assert held.status is Status.ITERATION_LIMIT
    assert held.success
