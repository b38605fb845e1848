"""What happens while a strategy runs: its history, its time limit, Ctrl-C, and the best valid mesh so far."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import Iterate
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.programs.outer_function import Reduced
from rmesh_nlp.programs.outer_solvers import StoppedError
from rmesh_nlp.solving.referee import OnStep, Referee
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.step import Step

NAN = float("nan")

TIME_LIMIT_S = 600.0
"""Default of ``time_limit_s``: seconds of build and solve together, looked at after each iteration."""

KEPT = 10
"""Last iterates of an all-at-once solver among which a valid mesh is looked for."""

T = TypeVar("T")


class Watch:
    """Stops a solve at its time limit or at Ctrl-C, and knows the best valid moves until then.

    Parameters
    ----------
    referee : Referee
    on_step : callable, optional
        Called with each step.
    time_limit_s : float
        Build and solve together.

    Attributes
    ----------
    stopped : Status or None
        TIME_LIMIT or INTERRUPTED, once the solve was stopped from outside.
    """

    def __init__(
        self, referee: Referee, on_step: OnStep | None = None, time_limit_s: float = TIME_LIMIT_S
    ) -> None:
        self.referee = referee
        self.stopped: Status | None = None
        self.on_step, self.limit = on_step, time_limit_s
        self._recent: deque[Array] = deque(maxlen=KEPT)
        self._best: tuple[float, Array] | None = None

    @property
    def remaining(self) -> float:
        """Seconds that are left, not negative."""
        return max(0.0, self.limit - self.referee.clock.elapsed)

    def note(self, q: Array, value: float | None = None) -> bool:
        """Keep moves, with their objective if it is known exactly; True if the solve must stop now."""
        if value is None:
            self._recent.append(np.array(q))
        elif np.isfinite(value) and (self._best is None or value < self._best[0]) and self._is_valid(q):
            self._best = value, np.array(q)
        if self.remaining == 0.0:
            self.stopped = self.stopped or Status.TIME_LIMIT
        return self.stopped is not None

    def run(self, solve: Callable[[], T]) -> T | None:
        """The result of ``solve``; None if Ctrl-C or the time limit ended it without one."""
        try:
            return solve()
        except KeyboardInterrupt:
            self.stopped = Status.INTERRUPTED
        except StoppedError:
            self.stopped = self.stopped or Status.TIME_LIMIT
        return None

    def best(self, function: Reduced, start: Array) -> Array:
        """The best moves of a stopped solve that give a valid mesh: at worst those it started with."""
        if self._best is not None:
            return self._best[1]
        bound = self.referee.relocation.freedoms.bound
        for q in reversed(self._recent):
            inside = np.clip(q, -bound, bound)
            if np.all(np.isfinite(inside)) and self._is_valid(inside):
                return inside if function(inside).value < function(start).value else start
        return start

    def ended_at(self, q: Array) -> bool:
        """Whether the moves of the last iterate of an all-at-once solver are these, up to rounding."""
        if not self._recent:
            return False
        return bool(np.allclose(self._recent[-1], q, rtol=0.0, atol=1e-8 * np.max(np.abs(q), initial=0.0)))

    def _is_valid(self, q: Array) -> bool:
        return self.referee.is_valid(q)


class Recorder(Watch):
    """A monitor of an NLP solver, or of the homotopy of an MPCC, whose first unknowns are the moves.

    Parameters
    ----------
    referee, on_step, time_limit_s : as for :class:`Watch`
        An NLP's residuals are known only when its solver has ended.
    unit : float
        Value of the outer objective where the program's is one.
    is_energy : bool
        Whether the outer objective is the energy, which is then known at every iterate.

    Attributes
    ----------
    residual : callable or None
        ``(x, lam_g) ->`` first-order residual of the outer problem at an iterate, while a program runs whose
        multipliers give it; None by default, and the histories then do not know it.
    state_residual : callable or None
        ``x ->`` the same at an iterate of a homotopy, whose unknowns hold the forces.
    """

    def __init__(
        self,
        referee: Referee,
        on_step: OnStep | None = None,
        time_limit_s: float = TIME_LIMIT_S,
        unit: float = 1.0,
        is_energy: bool = True,
    ) -> None:
        super().__init__(referee, on_step, time_limit_s)
        self._unit, self._is_energy = unit, is_energy
        self._before = 0
        self._steps: list[Step] = []
        self.residual: Callable[[Array, Array], float] | None = None
        self.state_residual: Callable[[Array], float] | None = None
        self._lam_g: Array | None = None

    def see_multipliers(self, lam_g: Array) -> None:
        """Multipliers of the iterate that comes next."""
        self._lam_g = lam_g

    def after(self, iterations: int) -> None:
        """Go on counting after so many iterations of something else."""
        self._before = iterations

    def __call__(self, iteration: int, x: Array, f: float) -> bool:
        """Note an iterate of an NLP without complementarity: its relaxation parameter is infinite."""
        known = self.residual is not None and self._lam_g is not None
        residual = self.residual(x, self._lam_g) if known else NAN  # type: ignore[misc, arg-type]
        return self._note(iteration, x, f, t=math.inf, residual=residual)

    def exact(self, iteration: int, q: Array, f: float, residual: float) -> bool:
        """Note moves with their contact solution, whose objective and first-order residual are known."""
        self._note(iteration, q, f / self._unit, t=0.0, residual=residual, violation=0.0)
        return self.note(q, f)

    def iterate(self, one: Iterate) -> None:
        """Note an iterate of a homotopy."""
        self._note(
            one.iteration,
            one.x,
            one.objective,
            t=one.t,
            residual=NAN if self.state_residual is None else self.state_residual(one.x),
            violation=one.constraint_violation,
            product=one.product,
            biactive=one.biactive,
        )

    def _note(
        self,
        iteration: int,
        x: Array,
        f: float,
        *,
        t: float,
        residual: float = NAN,
        violation: float = NAN,
        product: float = NAN,
        biactive: float = NAN,
    ) -> bool:
        objective = f * self._unit
        step = Step(
            iteration=self._before + iteration,
            energy=objective if self._is_energy else NAN,
            t=t,
            primal_residual=violation,
            dual_residual=residual,
            contact_solves=0,
            seconds=self.referee.clock.elapsed,
            objective=objective,
            product=product,
            biactive=biactive,
        )
        self._steps.append(step)
        q = x[: self.referee.relocation.n_q]
        if self.on_step is not None:
            self.on_step(replace(step, q=np.array(q)))
        return self.note(q)

    def status(self, result: NLPResult | None) -> Status:
        """How the solve ended, by the word of the solver."""
        if result is None or self.stopped is not None:
            return self.stopped or Status.FAILED
        return Status.CONVERGED if result.converged else result.status

    def steps(self, result: NLPResult | None = None) -> list[Step]:
        """The steps since the last call, with the constraint violation of an NLP solver filled in."""
        steps, self._steps = self._steps, []
        if result is None:
            return steps
        violation = result.history["inf_pr"]
        return [replace(step, primal_residual=v) for step, v in zip(steps, violation, strict=False)]


def ending_with_residual(solution: Solution) -> Solution:
    """A solution whose last step is its end, with the residual that the referee measured there in that step.

    Where each step of an all-at-once solver would need an adjoint to know it, the history has this one only.
    """
    last = replace(solution.history[-1], dual_residual=solution.stationarity_residual)
    return replace(solution, history=(*solution.history[:-1], last))
