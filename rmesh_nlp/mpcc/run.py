"""One solve under way: every NLP passes here, is measured, logged, shown, and counted against the limits."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import BoolArray
from rmesh_nlp.mpcc.nlps import CompiledNLPs, Watch
from rmesh_nlp.mpcc.result import Iterate, Step
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.solver import NLPResult

Progress = Callable[[str], None]
Watchers = tuple[Progress | None, Callable[[Step], None] | None, Callable[[Iterate], None] | None]
"""Who is told of lines, of steps and of iterations."""


class Run:
    """The NLPs of one solve: their table, their limits, and the best point so far.

    Attributes
    ----------
    p : array
        Parameters of the lifted problem: those of the source problem and the weight of the objective.
    steps : list of Step
    iterations : int
        Ipopt iterations spent.
    nearest : (z, f, excess) or None
        The point with the smallest residuals that any NLP ended at; of exact ones the lowest.
    """

    def __init__(
        self,
        nlps: CompiledNLPs,
        p: Array,
        weight: float = 1.0,
        progress: Progress | None = None,
        on_step: Callable[[Step], None] | None = None,
        on_iteration: Callable[[Iterate], None] | None = None,
        budget: Budget | None = None,
    ) -> None:
        self.nlps, self.lifted, self.options = nlps, nlps.lifted, nlps.options
        self.p = np.append(p, weight)
        self.steps: list[Step] = []
        self.budget = budget or nlps.options.budget()
        self._before = self.budget.iterations
        self.nearest: tuple[Array, float, float] | None = None
        self._progress, self._on_step, self._on_iteration = progress, on_step, on_iteration
        if progress is not None:
            progress(Step.HEADER)

    def relaxed(self, z: Array, t: float, warm: NLPResult | None = None, **how: bool | int) -> NLPResult:
        """Solve the relaxation at ``t``, see :meth:`CompiledNLPs.relaxed`."""
        return self.solve("relaxed", t, lambda w: self.nlps.relaxed(z, self.p, t, warm, w, **how))

    def branch(
        self,
        z: Array,
        zero: BoolArray,
        *,
        phase: str = "branch",
        free_signs: bool = False,
        warm: NLPResult | None = None,
    ) -> NLPResult:
        """Solve the NLP in which the given members are zero, see :meth:`CompiledNLPs.branch`."""
        parts = (z, self.p, zero)
        return self.solve(
            phase,
            0.0,
            lambda w: self.nlps.branch(*parts, free_signs=free_signs, warm=warm, watch=w),
        )

    def least_violation(self, z: Array, zero: BoolArray) -> NLPResult:
        """Minimise the violation of the rows on a branch, see :meth:`CompiledNLPs.least_violation`."""
        return self.solve("feasible", 0.0, lambda w: self.nlps.least_violation(z, self.p, zero, w))

    def solve(self, phase: str, t: float, nlp: Callable[[Watch], NLPResult]) -> NLPResult:
        """Solve an NLP within the limits, watched and recorded."""
        self.budget.check()
        before = self.budget.iterations
        only_clock = self._on_iteration is None and self.budget.iterations_left is None
        result = nlp(Watch(self._monitor(phase, t), only_clock))
        self.budget.iterations = before + result.iterations
        self._record(phase, t, result)
        self.budget.check()
        return result

    def _record(self, phase: str, t: float, result: NLPResult) -> None:
        """Measure the end of an NLP on the source problem and show it."""
        measured = self._measured(phase, t, result.x)
        self.keep(result.x, measured["objective"])
        step = Step(
            **measured,
            iterations=result.iterations,
            status=result.status,
            seconds=result.seconds,
            multiplier=float(np.max(result.lam_g[self.lifted.nlp.n_g :], initial=0.0)) if t > 0 else 0.0,
        )
        self.steps.append(step)
        if self._progress is not None:
            self._progress(step.line())
        if self._on_step is not None:
            self._on_step(step)

    def keep(self, z: Array, f: float) -> None:
        """Remember a point if it is better than the one remembered."""
        excess = self.nlps.excess(z, self.p)
        if np.isfinite(excess) and (
            self.nearest is None or (max(excess, 1.0), f) < (max(self.nearest[2], 1.0), self.nearest[1])
        ):
            self.nearest = (z, f, excess)

    def objective(self, z: Array) -> float:
        """Weighted objective at a lifted point, as in a ``Finish``."""
        return float(self.lifted.value(z, self.p)[0][0])

    def exact(self, z: Array) -> bool:
        """Whether the source problem is feasible and complementary at ``z``, within the scaled tolerances."""
        return self.nlps.excess(z, self.p) <= 1.0

    @property
    def iterations(self) -> int:
        """Ipopt iterations spent."""
        return self.budget.iterations - self._before

    def _monitor(self, phase: str, t: float) -> Monitor | None:
        """What the NLP calls after each iteration; nothing if nobody asks."""
        budget, show = self.budget, self._on_iteration
        if show is None and not budget.is_limited:
            return None
        # of the whole solve: the callback's own count goes on between NLPs
        count, n_z, n_x = itertools.count(budget.iterations), self.lifted.nlp.n_x, self.lifted.source.n_x

        def after(iteration: int, z: Array, f: float, lam_g: Array) -> bool:
            budget.iterations = next(count)
            if show is not None:
                measured = self._measured(phase, t, z[:n_z])
                show(Iterate(iteration=self.iterations, x=z[:n_x], **measured))
            return budget.is_over()

        return after

    def _measured(self, phase: str, t: float, z: Array) -> dict[str, Any]:
        f, res, (_, G, H) = self.nlps.measure(z, self.p)
        near = max(self.options.corner, 2 * np.sqrt(t))  # the corner of every relaxation is at sqrt(t)
        biactive = int(np.count_nonzero(np.maximum(np.abs(G), np.abs(H)) <= near))
        return {"phase": phase, "t": t, "objective": f, "biactive": biactive, **vars(res)}
