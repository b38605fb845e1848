"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there, so the default outer solver is a quasi-Newton method.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.outer_solvers import OUTER_SOLVERS, Reduced, reduced_nlp
from rmesh_nlp.programs.reduced import ReducedObjective
from rmesh_nlp.solution.referee import OnStep, Referee
from rmesh_nlp.solution.solution import Solution, Step


def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    outer: str = "ipopt",
    seed: int | None = None,
    start: Array | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Minimise an outer objective with exact contact solves inside.

    The energy needs no adjoint; other objectives get one with the active set held, which is
    their gradient wherever strict complementarity holds. The contact nodes where it fails at
    the end are listed in the record as ``biactive_nodes``: they are what may have stopped it.

    Parameters
    ----------
    problem : ContactProblem
    objective : str or Objective
        Such as "energy", "error-l2 + 0.01*quality" or "mean(top, -uy)", see
        :mod:`rmesh_nlp.fem.objective_text`, or an object of :mod:`rmesh_nlp.fem.quantities`.
    outer : str
        A name in ``rmesh_nlp.programs.outer_solvers.OUTER_SOLVERS``: "ipopt" (limited-memory BFGS), "newton"
        (projected trust-region Newton-CG, the fastest) and "newton-pair" (two such descents,
        recombined: for fine meshes), both for the energy only, "slsqp", "trust-constr" or
        "l-bfgs-b".
    seed : int, optional
        Random start; by default the initial mesh.
    start : (2, nodes) array, optional
        Node positions to start from, say prolonged from a coarser mesh.
    on_step : callable, optional
        Called after each outer iteration.

    Raises
    ------
    ValueError
        If the objective or the outer solver is unknown, or the solver cannot hold the element
        areas that need it.
    """
    if outer not in OUTER_SOLVERS:
        raise ValueError(f"unknown outer solver {outer!r}: choose from {', '.join(OUTER_SOLVERS)}")
    referee = Referee(problem)
    began = time.perf_counter()
    outer_objective = parse_objective(objective)
    function: Reduced = referee.reduced
    if not outer_objective.is_energy:
        function = ReducedObjective(referee.reduced, outer_objective)
    recorder = _Recorder(function, referee.relocation.freedoms.bound, on_step, began)
    program = reduced_nlp(referee.relocation, function, referee.is_valid)
    finish = OUTER_SOLVERS[outer](program, referee.start(seed, start), recorder)
    seconds = time.perf_counter() - began
    return referee.judge(
        "nested",
        finish.q,
        status=finish.status,
        history=recorder.steps,
        iterations=finish.iterations,
        contact_solves=referee.reduced.contact_solves,
        wall_time_s=seconds,
        objective=objective,
        seed=seed,
        extra={"outer": outer, **_outer_figures(referee, function, finish.q)},
        outer_gradient=function(finish.q).gradient,
    )


def _outer_figures(referee: Referee, function: Reduced, q: Array) -> dict[str, Any]:
    """Record entries of an outer objective: its value before and after, and biactive nodes."""
    start, end = function(np.zeros(q.size)), function(q)
    weak = referee.model.contact_nodes[end.weak]
    return {
        "objective_initial": start.value,
        "objective_value": end.value,
        "outer_stationarity_residual": referee.reduced.stationarity_residual(end),
        "biactive_nodes": [int(node) for node in weak],
    }


class _Recorder:
    """Turns the iterates of an outer solver into Steps."""

    def __init__(self, function: Reduced, bound: Array, on_step: OnStep | None, began: float) -> None:
        self._function, self._bound, self._on_step, self._began = function, bound, on_step, began
        self.steps: list[Step] = []

    def __call__(self, iteration: int, q: Array, _: float) -> None:
        point = self._function(q)
        scale = max(abs(point.value), 1e-300)
        move = np.clip(q - point.gradient / scale, -self._bound, self._bound) - q
        residual = float(np.max(np.abs(move), initial=0.0))
        solves, seconds = self._function.contact_solves, time.perf_counter() - self._began
        energy, objective = point.equilibrium.energy, point.value
        step = Step(iteration, energy, 0.0, 0.0, residual, solves, seconds, objective=objective)
        self.steps.append(step)
        if self._on_step is not None:
            self._on_step(replace(step, q=q.copy()))
