"""No relocation: the contact problem on the mesh as given, the baseline of all comparisons."""

from __future__ import annotations

import time

import numpy as np

from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.reduced import ReducedObjective
from rmesh_nlp.solution.referee import OnStep, Referee
from rmesh_nlp.solution.solution import Solution, Step


def solve(
    problem: ContactProblem, *, objective: str | Objective = "energy", on_step: OnStep | None = None
) -> Solution:
    """Solve the contact problem on the initial mesh.

    Parameters
    ----------
    problem : ContactProblem
    objective : str
        An outer objective whose value is to be recorded as well.
    on_step : callable, optional
        Called once with the only step.
    """
    referee = Referee(problem)
    began = time.perf_counter()
    equilibrium = referee.model.solve(problem.mesh.p)
    seconds = time.perf_counter() - began
    step = Step(equilibrium.iterations, equilibrium.energy, 0.0, 0.0, float("nan"), 1, seconds)
    if on_step is not None:
        on_step(step)
    return referee.judge(
        "fixed",
        np.zeros(referee.relocation.n_q),
        status=equilibrium.status,
        history=[step],
        iterations=equilibrium.iterations,
        contact_solves=1,
        wall_time_s=seconds,
        stationarity="",
        objective=objective,
        extra=_objective_value(referee, objective),
    )


def _objective_value(referee: Referee, text: str | Objective) -> dict[str, float]:
    objective = parse_objective(text)
    if objective.is_energy:
        return {}
    value = ReducedObjective(referee.reduced, objective)(np.zeros(referee.relocation.n_q)).value
    return {"objective_initial": value, "objective_value": value}
