"""The only place that knows history and callbacks, and where a budget stops what runs.

A formulation reports every iterate to a :class:`Track`, one for each NLP that it runs, and is stopped by
it. What was reached until then is kept here, so that no formulation has to look after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import expect
from rmesh_nlp.evaluation import Array, is_finite
from rmesh_nlp.meshes.geometry import have_same_mesh
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.mpcc import Iterate
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError, checked
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step, Work

NAN = float("nan")

OnStep = Callable[[Step], object]
"""Called after each iteration, for progress."""

T = TypeVar("T")


class Runs(Protocol):
    """What a monitor runs: a :class:`rmesh_nlp.solving.formulation.Formulation`."""

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        """Minimise from outer variables ``q``."""


class Monitor:
    """Watches one solve.

    Parameters
    ----------
    limits : Limits, optional
        Seconds and iterations, at most.
    on_step : callable, optional
        Called with each step.
    mesh : skfem.MeshTri, optional
        The mesh as given. Outer variables of another one are not shown to ``on_step``.

    Attributes
    ----------
    budget : Budget
        Of the solve, from the making of the monitor on: its ``check`` ends what runs once it is over.
    steps : list of Step
        The history, over all NLPs of the solve.
    work : Work
        What formulations have spent beside the contact solves of the outer problems that they track.
    """

    def __init__(
        self, limits: Limits | None = None, on_step: OnStep | None = None, mesh: MeshTri | None = None
    ) -> None:
        self.budget = Budget(limits or Limits())
        self.on_step, self.mesh = on_step, mesh
        self.steps: list[Step] = []
        self.work = Work()
        self._tracked: list[Outer] = []
        self._gains: dict[ContactSolver, float] = {}
        self._track: Track | None = None

    @property
    def spent(self) -> Work:
        """All work so far."""
        return sum((outer.spent for outer in self._tracked), self.work)

    def track(self, outer: Outer, unit: float = 1.0) -> Track:
        """What the iterates of one NLP are reported to.

        Parameters
        ----------
        outer : Outer
            Whose outer variables are the leading unknowns of the program.
        unit : float
            Value of the objective where the program's is one.
        """
        with self.budget.during("build"):
            measure = outer.residual
        self._track = Track(self, self.tracked(outer), measure, unit)
        return self._track

    def tracked(self, outer: Outer) -> Outer:
        """Count the contact solves of an outer problem from now on; returns it."""
        if all(outer.energy is not one.energy for one in self._tracked):
            self._tracked.append(outer)
        return outer

    def estimate(self, outer: Outer) -> float:
        """The estimated error of the energy on the mesh as given; its work is spent and counted once."""
        if outer.gain is not None:
            return outer.gain
        if outer.contact not in self._gains:
            self._gains[outer.contact] = gain_estimate(outer.contact)
            self.work += Work(contact_solves=2)
        return self._gains[outer.contact]

    def note(self, step: Step, q: Array | None = None, *, shown: bool = True) -> bool:
        """Add a step at ``q`` to the history, ``shown`` to ``on_step``; whether the solve is over."""
        if self.steps and _is_same(self.steps[-1], step):
            return self.budget.is_over()  # the start of an NLP is where the last one ended
        self.steps.append(step)
        self.budget.iterations = step.iteration
        if self.on_step is not None:
            self.on_step(replace(step, q=np.array(q)) if q is not None and shown else step)
        return self.budget.is_over()

    def run(self, formulation: Runs, outer: Outer, q: Array) -> Outcome:
        """Where a formulation ends, also if Ctrl-C or a limit ends it: at the best valid mesh so far."""
        self._track = None
        outcome, last = self.attempt(lambda: formulation.run(outer, q, self)), self._track
        if outcome is not None:
            expect("what run returns", outcome, Outcome)
            return outcome
        if last is None:
            lacks = "It ended before the last load step." if outer.problem.steps else ""
            return Outcome(outer, q, self.end, lacks=lacks)
        start = q if last.outer.n == q.size else np.zeros(last.outer.n)
        return Outcome(last.outer, last.best(start), self.end)

    def attempt(self, work: Callable[[], T]) -> T | None:
        """The result of a part of a solve; None if Ctrl-C or a limit has ended the solve before or ends it.

        A formulation that knows more of what was reached than the last track does asks for it by this.
        """
        if self.budget.stopped is not None:
            return None
        try:
            return checked(self._check, work)
        except KeyboardInterrupt:
            self.budget.stopped = Status.INTERRUPTED
        except StoppedError as stop:
            self.budget.stopped = self.budget.stopped or stop.status
        return None

    @property
    def end(self) -> Status:
        """What ended the solve."""
        return self.budget.stopped or Status.TIME_LIMIT

    def finish(self, work: Callable[[], T]) -> T | None:
        """The result of a part of the assessment, whatever ended the solve before; None if it is ended."""
        budget = self.budget
        before, budget.stopped = budget.stopped, None
        with budget.during("audit"):
            result = self.attempt(work)
        budget.stopped = budget.stopped or before
        return result

    def _check(self) -> None:
        """End what runs when time is over, once: what keeps the best mesh goes on."""
        if self.budget.stopped is None and self.budget.remaining == 0:
            self.budget.stopped = Status.TIME_LIMIT
            raise StoppedError(Status.TIME_LIMIT)


def _is_same(last: Step, step: Step) -> bool:
    """Whether a step is the last one again, and not the start on another mesh or with another weight."""
    numbers = (last.iteration, last.t) == (step.iteration, step.t)
    return numbers and math.isclose(last.objective, step.objective, rel_tol=1e-9)


class Track:
    """The iterates of one NLP; called as the monitor of an NLP solver it is one.

    Attributes
    ----------
    residual : callable or None
        First-order residual of the outer problem by an iterate's own displacement and forces: of the unknowns
        and multipliers ``(x, lam_g)`` of an NLP, of the unknowns ``x`` of a homotopy, which hold the forces.
    """

    def __init__(self, monitor: Monitor, outer: Outer, measure: OuterResidual, unit: float) -> None:
        self.monitor, self.outer, self._measure, self._unit = monitor, outer, measure, unit
        self._before, self._first = monitor.budget.iterations, len(monitor.steps)
        self.residual: Callable[..., float] | None = None
        mesh = outer.problem.mesh
        self._shown = have_same_mesh(mesh, monitor.mesh or mesh)
        self._valid: Array | None = None  # the last such outer variables of an all-at-once solver
        self._best: tuple[tuple[float, float], Array] | None = None

    @property
    def iterations(self) -> int:
        """Of this NLP."""
        return self.monitor.budget.iterations - self._before

    def __call__(self, iteration: int, x: Array, f: float, lam_g: Array) -> bool:
        """An iterate of an NLP without complementarity: its relaxation parameter is infinite."""
        residual = NAN if self.residual is None else self.residual(x, lam_g)
        return self._approximate(iteration, x, f, t=math.inf, primal_residual=NAN, dual_residual=residual)

    def iterate(self, one: Iterate) -> None:
        """An iterate of a homotopy."""
        self._approximate(
            one.iteration,
            one.x,
            one.objective,
            t=one.t,
            dual_residual=NAN if self.residual is None else self.residual(one.x),
            primal_residual=one.constraint_violation,
            product=one.product,
            biactive=one.biactive,
        )

    def exact(self, iteration: int, q: Array, point: ReducedPoint | None = None, **known: float) -> bool:
        """Outer variables with their contact solution; whether the solve is over.

        Parameters
        ----------
        iteration : int
            Of this NLP.
        q : (n,) array
        point : ReducedPoint, optional
            The outer objective there; evaluated if it is not given.
        known
            Further fields of the step.
        """
        point = self.outer.function(q) if point is None else point
        merit = self.outer.merit(point)
        lower = self._best is None or merit < self._best[0]
        if lower and np.isfinite(point.value) and self.outer.is_valid(q):
            self._best = merit, np.array(q)
        spent = self.monitor.spent.contact_solves
        known |= {"t": 0.0, "primal_residual": merit[0], "dual_residual": self._measure(point)}
        energy = point.equilibrium.energy
        return self._note(iteration, q, energy=energy, objective=point.value, contact_solves=spent, **known)

    def _approximate(self, iteration: int, x: Array, f: float, **known: float) -> bool:
        q, value = np.array(x[: self.outer.n]), f * self._unit
        if is_finite(q) and self.outer.is_valid(self.outer.clipped(q)):
            self._valid = self.outer.clipped(q)
        else:  # inverted elements have any energy
            value = NAN
        energy = value if self.outer.objective.is_energy else NAN
        return self._note(iteration, q, energy=energy, objective=value, contact_solves=0, **known)

    def _note(self, iteration: int, q: Array, **known: Any) -> bool:
        outer = self.outer
        known |= {"seconds": self.monitor.budget.elapsed, "design": outer.figures(q)}
        known |= {"energy_given": outer.contact.given.energy, "objective_given": outer.at_start.value}
        step = Step(iteration=self._before + iteration, **known)
        return self.monitor.note(step, q, shown=self._shown)

    def with_violations(self, violations: list[float]) -> None:
        """Fill in what an NLP solver tells of its iterates when it has ended."""
        steps = self.monitor.steps
        for number, violation in zip(range(self._first, len(steps)), violations, strict=False):
            steps[number] = replace(steps[number], primal_residual=violation)

    def best(self, start: Array) -> Array:
        """The best outer variables that give a valid mesh: at worst those it started with.

        Of an all-at-once solver only the last ones are known.
        """
        if self._best is not None:
            return self._best[1]
        candidates = [start] if self._valid is None else [start, self._valid]
        return min(candidates, key=lambda q: self.outer.merit(self.outer.function(q)))
