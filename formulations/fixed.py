"""No relocation: the contact problem on the mesh as given, the baseline of all comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.contact import model
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Count, Settings, check_limits
from rmesh_nlp.solving.beginning import Start
from rmesh_nlp.solving.history import TIME_LIMIT_S
from rmesh_nlp.solving.referee import STATIONARY, OnStep, Referee
from rmesh_nlp.solving.registry import ignoring
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.step import Step


@dataclass(frozen=True)
class FixedSettings(Settings):
    """Settings of ``fixed``.

    Attributes
    ----------
    max_iterations : int
        Factorisations that the contact solve may take.
    """

    max_iterations: Count = model.MAX_ITERATIONS


@ignoring("start", "seed", "tolerance", "time_limit_s")
def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    settings: FixedSettings | Mapping[str, Any] | None = None,
    tolerance: float = STATIONARY,
    max_iterations: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    start: Start = None,
    seed: int | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Solve the contact problem on the initial mesh.

    Parameters
    ----------
    problem : ContactProblem
    objective : str
        An outer objective whose value is to be recorded as well.
    settings : FixedSettings or mapping, optional
    max_iterations : int, optional
        In place of that of the settings.
    tolerance, time_limit_s, start, seed
        As for the other strategies; nothing moves and one contact solve is finite, so they have no effect.
    on_step : callable, optional
        Called once with the only step.
    """
    check_limits(tolerance=tolerance, max_iterations=max_iterations, time_limit_s=time_limit_s)
    chosen = FixedSettings.of(settings)
    if max_iterations is not None:
        chosen = replace(chosen, max_iterations=max_iterations)
    referee = Referee(problem)
    q = np.zeros(referee.relocation.n_q)
    equilibrium = model.solve(referee.model.system(problem.mesh.p), max_iterations=chosen.max_iterations)
    nan, seconds = float("nan"), referee.clock.elapsed
    step = Step(equilibrium.iterations, equilibrium.energy, 0.0, 0.0, nan, 1, seconds)
    if on_step is not None:
        on_step(step)
    extra = {}
    if not parse_objective(objective).is_energy:
        value = referee.function(objective)(q).value
        extra = {"objective_initial": value, "objective_value": value}
    return referee.judge(
        "fixed",
        q,
        status=equilibrium.status,
        history=[step],
        iterations=equilibrium.iterations,
        contact_solves=1,
        stationarity="",
        relocates=False,
        tolerance=tolerance,
        objective=objective,
        settings=chosen.changed(),
        extra=extra,
    )
