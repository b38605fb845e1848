"""One solve under way: every NLP passes here, is measured, logged, shown, and counted against the limits."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.programs import BoolArray, Programs
from rmesh_nlp.mpcc.result import Step
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Iterate:
    """One Ipopt iteration of a relaxation or of a branch, measured on the source problem.

    Attributes
    ----------
    phase, t : str, float
        As in :class:`~rmesh_nlp.mpcc.result.Step`.
    iteration : int
        Counted from 1 through the whole solve.
    x : array
    objective, constraint_violation, complementarity, product : float
        As in ``Step``.
    biactive : int
        Pairs with both members near zero, as in ``Step``.
    """

    phase: str
    t: float
    iteration: int
    x: Array
    objective: float
    constraint_violation: float
    complementarity: float
    product: float
    biactive: int


class LimitReachedError(Exception):
    """A limit of time or of iterations was met; ``status`` says which."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.message)
        self.status = status


@dataclass(frozen=True)
class Observers:
    """Functions that are shown a solve while it runs.

    Attributes
    ----------
    line : callable, optional
        Receives a line of text per NLP.
    step : callable, optional
        Receives the ``Step`` of each NLP.
    iterate : callable, optional
        Receives an ``Iterate`` after each Ipopt iteration.
    """

    line: Progress | None = None
    step: Callable[[Step], None] | None = None
    iterate: Callable[[Iterate], None] | None = None


class Run:
    """The NLPs of one solve: their table, their limits, and the best point so far.

    Attributes
    ----------
    p : array
        Parameters of the lifted program: those of the source problem and the weight of the objective.
    steps : list of Step
    iterations : int
        Ipopt iterations spent.
    nearest : (z, f, excess) or None
        The point with the smallest residuals that any NLP ended at; of exact ones the lowest.
    """

    def __init__(
        self, programs: Programs, p: Array, observers: Observers | None = None, weight: float = 1.0
    ) -> None:
        self.programs, self.p = programs, np.append(p, weight)
        self.steps: list[Step] = []
        self.iterations = 0
        self.nearest: tuple[Array, float, float] | None = None
        self._observers = observers or Observers()
        options = programs.options
        self._deadline = time.monotonic() + options.time_limit_s
        self._most = options.max_iterations
        self._watched = (
            self._observers.iterate is not None or self._most is not None or np.isfinite(self._deadline)
        )
        programs.only_clock = self._observers.iterate is None and self._most is None
        if self._observers.line is not None:
            self._observers.line(Step.HEADER)

    def relaxed(
        self, name: str, z: Array, t: float, warm: NLPResult | None = None, *, first: bool = False
    ) -> NLPResult:
        """Solve the relaxation ``name`` at ``t`` from ``z``; ``warm`` gives multipliers to start from.

        ``first`` says that ``z`` is a user's start.
        """
        monitor = self._monitor("relaxed", t)
        return self._ended("relaxed", t, self.programs.relaxed(name, z, self.p, t, warm, monitor, first))

    def unlifted(self, x: Array, t: float) -> NLPResult:
        """Solve Scholtes' relaxation in the source problem's own unknowns; the result is a lifted one."""
        return self._ended("second", t, self.programs.unlifted(x, self.p, t, self._monitor("second", t)))

    def branch(
        self,
        z: Array,
        fix_G: BoolArray,
        fix_H: BoolArray | None = None,
        *,
        phase: str = "branch",
        box: Array | None = None,
        free_signs: bool = False,
        warm: NLPResult | None = None,
    ) -> NLPResult:
        """Solve the NLP in which G is zero where ``fix_G``, and H where ``fix_H`` (None: elsewhere)."""
        fixed = ~fix_G if fix_H is None else fix_H
        result = self.programs.branch(
            z, self.p, fix_G, fixed, box=box, free_signs=free_signs, warm=warm,
            monitor=self._monitor(phase, 0.0),
        )  # fmt: skip
        return self._ended(phase, 0.0, result)

    def exact(self, z: Array) -> bool:
        """Whether the source problem is feasible and complementary at ``z``, within the scaled tolerances."""
        return self.programs.excess(z, self.p) <= 1.0

    def check(self) -> None:
        """Raise LimitReachedError if the time or the iterations are used up."""
        if time.monotonic() > self._deadline:
            raise LimitReachedError(Status.TIME_LIMIT)
        if self._most is not None and self.iterations >= self._most:
            raise LimitReachedError(Status.ITERATION_LIMIT)

    @property
    def seconds_left(self) -> float:
        """Time left of the user's limit; infinite without one."""
        return max(self._deadline - time.monotonic(), 1e-3)

    def _monitor(self, phase: str, t: float) -> Callable[[int, Array, float], bool] | None:
        """What an NLP calls after each iteration; None if nobody asks."""
        self.check()
        if not self._watched:
            return None
        count = itertools.count(
            self.iterations
        )  # of the whole solve: the callback's own goes on between NLPs
        n_z = self.programs.lifted.nlp.n_x

        def after(iteration: int, z: Array, f: float) -> bool:
            spent = next(count)
            if self._observers.iterate is not None:
                self._observers.iterate(self._iterate(phase, t, spent, z[:n_z]))
            return time.monotonic() > self._deadline or (self._most is not None and spent >= self._most)

        return after

    def _iterate(self, phase: str, t: float, iteration: int, z: Array) -> Iterate:
        f, res, (_, G, H) = self.programs.measure(z, self.p)
        x = z[: self.programs.lifted.source.n_x]
        near = self._near_corner(G, H, t)
        return Iterate(
            phase, t, iteration, x, f, res.constraint_violation, res.complementarity, res.product, near
        )

    def _near_corner(self, G: Array, H: Array, t: float) -> int:
        """Pairs whose larger member is at most 2 sqrt(t): the corner of every relaxation is at sqrt(t)."""
        reach = max(self.programs.options.corner, 2 * np.sqrt(t))
        return int(np.count_nonzero(np.maximum(np.abs(G), np.abs(H)) <= reach))

    def _ended(self, phase: str, t: float, result: NLPResult) -> NLPResult:
        """Measure a solve on the source problem, log and show it, keep it if it is the best."""
        f, res, (_, G, H) = self.programs.measure(result.x, self.p)
        step = Step(
            phase, t, f, res.constraint_violation, res.complementarity, res.product,
            result.iterations, result.status, result.seconds, self._near_corner(G, H, t),
            float(np.max(result.lam_g[self.programs.lifted.nlp.n_g :], initial=0.0)) if t > 0 else 0.0,
        )  # fmt: skip
        self.iterations += result.iterations
        self._log(step)
        self.keep(result.x, f)
        self.check()
        return result

    def polished(self, z: Array) -> None:
        """Log a point that was found without an NLP."""
        f, res, (_, G, H) = self.programs.measure(z, self.p)
        self._log(
            Step(
                "polished", 0.0, f, res.constraint_violation, res.complementarity, res.product,
                0, Status.CONVERGED, 0.0, self._near_corner(G, H, 0.0),
            )
        )  # fmt: skip
        self.keep(z, f)

    def _log(self, step: Step) -> None:
        self.steps.append(step)
        if self._observers.line is not None:
            self._observers.line(step.line())
        if self._observers.step is not None:
            self._observers.step(step)

    def keep(self, z: Array, f: float) -> None:
        """Remember a point if it is better than the one remembered."""
        excess = self.programs.excess(z, self.p)
        if np.isfinite(excess) and (
            self.nearest is None or (max(excess, 1.0), f) < (max(self.nearest[2], 1.0), self.nearest[1])
        ):
            self.nearest = (z, f, excess)
