"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there; the default outer solver is a Newton method
with the second derivative of the active set at hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rmesh_nlp.errors import unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.outer_function import Reduced
from rmesh_nlp.programs.outer_solvers import (
    OUTER_SOLVERS,
    NestedSettings,
    OuterResult,
    ReducedProgram,
    reduced_nlp,
)
from rmesh_nlp.programs.residual import OuterResidual
from rmesh_nlp.solving.beginning import Start, beginning
from rmesh_nlp.solving.composed import composed
from rmesh_nlp.solving.history import TIME_LIMIT_S, Watch
from rmesh_nlp.solving.referee import STATIONARY, OnStep, Referee
from rmesh_nlp.solving.regularised import Regularisation
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.step import Step
from rmesh_nlp.solving.time_left import Falling


@composed
def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    regularisation: Regularisation = None,
    distortion: str = "shape-size",
    flips: bool = False,
    outer: str = "newton",
    settings: NestedSettings | Mapping[str, Any] | None = None,
    tolerance: float = STATIONARY,
    max_iterations: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    start: Start = None,
    seed: int | None = None,
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
    regularisation : float or sequence of float, optional
        Weight of a distortion that is added to the energy, relative to the error of the energy on the mesh as
        given, or a schedule of weights of which the last may be 0; 0.01 suits most problems without boxes.
    distortion : str
        "quality", "shape-size" or "elastic", see :mod:`rmesh_nlp.fem.distortion`.
    flips : bool
        Flip edges by energy between relocations, until neither gains; without boxes only.
    outer : str
        A name in ``rmesh_nlp.programs.outer_solvers.OUTER_SOLVERS``: "newton" (projected trust-region
        Newton-CG where boxes alone keep the elements valid, else an interior-point Newton method),
        "newton-cg" (the former along element areas too, and the latter only where it stalls: cheaper, often
        to another minimum), "newton-pair" (two descents of the first kind, recombined: for fine meshes, the
        energy only), "ipopt" (with exact second derivatives; with limited memory for many moves and another
        objective than the energy), "slsqp",
        "trust-constr" or "l-bfgs-b".
    settings : NestedSettings or mapping, optional
    tolerance : float
        Largest first-order residual, measured by the referee, of a solution that is called converged.
    max_iterations : int, optional
        In place of that of the settings.
    time_limit_s : float
        After it, as after Ctrl-C, the best valid mesh so far is the solution.
    start : positions (2, nodes), "given", name of a strategy, or Solution, optional
        See :func:`rmesh_nlp.solving.beginning.beginning`.
    seed : int, optional
        Random start; by default the initial mesh.
    on_step : callable, optional
        Called after each outer iteration.

    Raises
    ------
    ValueError
        If the objective, the outer solver, a setting or the start is unknown, or the solver cannot hold
        the element areas that need it.
    """
    if outer not in OUTER_SOLVERS:
        raise unknown("outer solver", outer, OUTER_SOLVERS)
    chosen = NestedSettings.of(settings)
    if max_iterations is not None:
        chosen = replace(chosen, max_iterations=max_iterations)
    referee = Referee(problem, objective)
    function = referee.function(objective)
    with referee.clock.during("build"):
        residual = referee.residual(function)
        program = reduced_nlp(referee.relocation, function, referee.is_valid, residual, tolerance)
    begin = beginning(referee, start, seed, objective=objective, time_limit_s=time_limit_s)
    recorder = _Recorder(referee, function, residual, on_step, time_limit_s, chosen.enough)
    warm = begin.name not in ("given", "random")
    program = replace(program, out_of_time=lambda: recorder.remaining == 0.0, warm=warm)
    finish = recorder.run(lambda: _run(outer, program, begin.q, recorder, chosen))
    if finish is None or recorder.stopped is not None:
        q, status = recorder.best(function, begin.q), recorder.stopped or Status.FAILED
    else:
        q, status = finish.q, finish.status
    kkt = {"kkt_factorisations": finish.iterations} if outer == "ipopt" and finish is not None else {}
    return referee.judge(
        "nested",
        q,
        status=status,
        tolerance=tolerance,
        history=recorder.steps,
        iterations=begin.iterations + max((step.iteration for step in recorder.steps), default=0),
        contact_solves=begin.contact_solves + function.contact_solves,
        objective=objective,
        start=begin.name,
        seed=seed,
        settings=chosen.changed(),
        extra={"outer": outer, **kkt, **_method(finish), **_outer_figures(referee, function, q)},
    )


def _run(
    outer: str, program: ReducedProgram, start: Array, recorder: _Recorder, settings: NestedSettings
) -> OuterResult:
    if start.size == 0:  # nothing can move, and not every solver takes a program without unknowns
        recorder(0, start, 0.0)
        return OuterResult(start, Status.CONVERGED, 0)
    return OUTER_SOLVERS[outer](program, start, recorder, settings)


def _method(finish: OuterResult | None) -> dict[str, str]:
    """Record entry of what an outer solver ran, where its name leaves that open."""
    return {"outer_method": finish.method} if finish is not None and finish.method else {}


def _outer_figures(referee: Referee, function: Reduced, q: Array) -> dict[str, Any]:
    """Record entries of an outer objective: its value before and after, and biactive nodes."""
    start, end = function(np.zeros(q.size)), function(q)
    weak = referee.model.contact_nodes[end.weak]
    return {
        "objective_initial": start.value,
        "objective_value": end.value,
        "biactive_nodes": [int(node) for node in weak],
    }


class _Recorder(Watch):
    """Turns the iterates of an outer solver into Steps."""

    def __init__(
        self,
        referee: Referee,
        function: Reduced,
        residual: OuterResidual,
        on_step: OnStep | None,
        time_limit_s: float,
        enough: float | None,
    ) -> None:
        super().__init__(referee, on_step, time_limit_s)
        self._decrease = None if enough is None else Falling(enough)
        self._function, self._residual = function, residual
        self.steps: list[Step] = []

    def __call__(self, iteration: int, q: Array, _: float) -> bool:
        point = self._function(q)
        residual = self._residual(point)
        solves, seconds = self._function.contact_solves, self.referee.clock.elapsed
        energy, objective = point.equilibrium.energy, point.value
        step = Step(
            iteration,
            energy,
            0.0,
            0.0,
            residual,
            solves,
            seconds,
            objective=objective,
            stationarity=residual,
            seconds_left=self._seconds_left(seconds, objective),
        )
        self.steps.append(step)
        if self.on_step is not None:
            self.on_step(replace(step, q=q.copy()))
        return self.note(q, point.value)

    def _seconds_left(self, seconds: float, value: float) -> float:
        """A guess where the descent ends as soon as a step is not worth taking: each is worth less."""
        if self._decrease is None or not self.steps:
            return float("nan")
        gain = self.steps[0].objective - value
        self._decrease(seconds, (self.steps[-1].objective - value) / gain if gain > 0 else 0.0)
        left = self._decrease.seconds_left
        return float("nan") if left is None else left
