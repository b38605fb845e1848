"""History, time limit, pace and last moves of a cascade of meshes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.discretisation.validity import is_valid
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.acceptance import HALVINGS
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.levels import COARSER
from rmesh_nlp.programs.outer_solvers import StoppedError
from rmesh_nlp.programs.prolongation import prolonged
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.residual import OuterResidual
from rmesh_nlp.solving.interrupts import deferred
from rmesh_nlp.solving.referee import OnStep
from rmesh_nlp.solving.step import Step

T = TypeVar("T")


class Watch:
    """What listens to a cascade: :data:`rmesh_nlp.programs.cascade.OnMove`, with a clock."""

    def __init__(
        self,
        problem: ContactProblem,
        settings: CascadeSettings,
        limit: float,
        on_step: OnStep | None,
        max_iterations: int | None = None,
    ) -> None:
        self._most = max_iterations
        self._nodes, self._limit, self._on_step = problem.mesh.p.shape[1], limit, on_step
        self._settings = settings
        self._began = time.perf_counter()
        self._last: tuple[float, Array] | None = None
        self._map: tuple[Array, NDArray[np.int64], Array] | None = None
        self._before = self._iteration = 0
        self._level: _Level | None = None
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

    def __call__(
        self, iteration: int, energy: ReducedEnergy, q: Array, value: float, *, ends: bool = True
    ) -> bool:
        """Note an iteration; whether to stop.

        ``ends`` says whether the descent has a limit of iterations that lets the time left be guessed.
        """
        if self.steps and iteration < self._iteration:  # another descent begins
            self._before = self.steps[-1].iteration
        self._iteration = iteration
        if self._level is None or self._level.energy is not energy:
            before = self.steps[-1].seconds if self.steps else 0.0
            self._level = _Level(energy, before, self._before + iteration)
        point, level = energy(q), self._level
        number = self._before + iteration
        step = Step(
            iteration=number,
            energy=point.equilibrium.energy,
            t=0.0,
            primal_residual=0.0,
            dual_residual=level.residual(point),
            contact_solves=energy.contact_solves,
            seconds=self.seconds,
            objective=value,
            energy_given=level.given.equilibrium.energy,
            seconds_left=self._seconds_left(level, number) if ends else float("nan"),
        )
        self.steps.append(step)
        mesh = energy.relocation.problem.mesh
        finest = mesh.p.shape[1] == self._nodes
        if finest:
            self._last = value, np.array(q)
        else:
            self._map = mesh.p, energy.relocation.problem.triangles, energy.relocation.nodes(q) - mesh.p
        if self._on_step is not None:
            self._on_step(replace(step, q=np.array(q)) if finest else step)
        return self.is_late()

    def _seconds_left(self, level: _Level, iteration: int) -> float:
        """A guess: every mesh to come takes its most iterations, at the seconds per node of this one."""
        done = iteration - level.first
        if done == 0:
            return float("nan")
        chosen, nodes = self._settings, level.nodes
        rate = (self.seconds - level.began) / (done * nodes)
        limits = {True: chosen.iterations, False: chosen.brief_unnested}
        left = max(limits[nodes <= chosen.thorough] - done, 0) * nodes
        while nodes < self._nodes:
            nodes = min(COARSER * nodes, self._nodes)
            left += limits[nodes <= chosen.thorough and nodes < self._nodes] * nodes
        return rate * left

    def is_late(self) -> bool:
        """Whether the solve was stopped, or its time is up, or it has taken all its iterations."""
        if self.stopped is None and self._most is not None and self.iterations >= self._most:
            self.stopped = Status.ITERATION_LIMIT
        if self.stopped is None and self.seconds > self._limit:
            self.stopped = Status.TIME_LIMIT
        return self.stopped is not None

    def changed(self) -> dict[str, Any]:
        """Settings that differ from the defaults, for the record."""
        given = {} if self._most is None else {"max_iterations": self._most}
        return {**self._settings.changed(), **given}

    def run(self, solve: Callable[[], T]) -> T | None:
        """The result of ``solve``; None after Ctrl-C, and if the time was up before there was one."""
        try:
            return solve()
        except KeyboardInterrupt:
            self.stopped = Status.INTERRUPTED
            return None
        except StoppedError:
            return None

    def to_its_end(self, work: Callable[[], T]) -> T:
        """The result of ``work``, which is not lost by Ctrl-C: what follows it is."""
        with deferred() as interrupted:
            result = work()
        if interrupted():
            self.stopped = Status.INTERRUPTED
        return result

    def best(self, problem: ContactProblem) -> Array:
        """The last moves on the given mesh, which are the best; if it was not reached, the map so far.

        A map that makes elements too small is halved until it does not; without one there are no moves.
        """
        if self._last is not None:
            return self._last[1]
        parts = discretise(problem)
        if self._map is not None:
            q = prolonged(*self._map, parts)
            for _ in range(HALVINGS):
                if is_valid(problem, parts.freedoms.positions.values(q)):
                    return q
                q = 0.5 * q
        return np.zeros(parts.freedoms.n)


class _Level:
    """The descent on one mesh: what its steps are measured against.

    Parameters
    ----------
    energy : ReducedEnergy
    began : float
        Seconds at which the statement of its program began.
    first : int
        Number of its first iteration.
    """

    def __init__(self, energy: ReducedEnergy, began: float, first: int) -> None:
        self.energy, self.began, self.first = energy, began, first
        self.nodes = int(energy.relocation.problem.mesh.p.shape[1])
        none = np.zeros(energy.relocation.n_q)
        system = energy.model.system(energy.relocation.nodes(none))
        self.given = energy.at(none, system, energy.model.solve(energy.relocation.nodes(none)))
        energy.contact_solves += 1
        self.residual = OuterResidual(energy, self.given)
