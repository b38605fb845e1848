"""History, time limit and last moves of a cascade of meshes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rmesh_nlp.discretisation.freedoms import freedoms
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.nlp import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade import CascadeResult
from rmesh_nlp.programs.outer_solvers import StoppedError
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.solution.referee import OnStep
from rmesh_nlp.solution.solution import Step


class Watch:
    """What listens to a cascade: :data:`rmesh_nlp.programs.cascade.OnMove`, with a clock."""

    def __init__(self, problem: ContactProblem, limit: float, on_step: OnStep | None) -> None:
        self._nodes, self._limit, self._on_step = problem.mesh.p.shape[1], limit, on_step
        self._began = time.perf_counter()
        self._last: tuple[float, Array] | None = None
        self._before = self._iteration = 0
        self.steps: list[Step] = []
        self.stopped: Status | None = None

    @property
    def seconds(self) -> float:
        """Wall time so far."""
        return time.perf_counter() - self._began

    @property
    def iterations(self) -> int:
        """Over all meshes."""
        return max((step.iteration for step in self.steps), default=0)

    def __call__(self, iteration: int, energy: ReducedEnergy, q: Array, value: float) -> bool:
        """Note an iteration; whether to stop."""
        if self.steps and iteration < self._iteration:  # another descent begins
            self._before = self.steps[-1].iteration
        self._iteration = iteration
        step = Step(
            iteration=self._before + iteration,
            energy=energy(q).equilibrium.energy,
            t=0.0,
            primal_residual=0.0,
            dual_residual=float("nan"),
            contact_solves=energy.contact_solves,
            seconds=self.seconds,
            objective=value,
        )
        self.steps.append(step)
        finest = energy.relocation.problem.mesh.p.shape[1] == self._nodes
        if finest:
            self._last = value, np.array(q)
        if self._on_step is not None:
            self._on_step(replace(step, q=np.array(q)) if finest else step)
        return self.is_late()

    def is_late(self) -> bool:
        """Whether the solve was stopped, or its time is up."""
        if self.stopped is None and self.seconds > self._limit:
            self.stopped = Status.TIME_LIMIT
        return self.stopped is not None

    def run(self, solve: Callable[[], CascadeResult]) -> CascadeResult | None:
        """The result of ``solve``; None after Ctrl-C, and if the time was up before there was one."""
        try:
            return solve()
        except KeyboardInterrupt:
            self.stopped = Status.INTERRUPTED
            return None
        except StoppedError:
            return None

    def best(self, problem: ContactProblem) -> Array:
        """The last moves on the given mesh, which are the best; none if it was not reached."""
        return self._last[1] if self._last is not None else np.zeros(freedoms(problem).n)
