"""Histories of Ipopt runs as Steps."""

from __future__ import annotations

import math
import time
from dataclasses import replace

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import Iterate
from rmesh_nlp.optimize.nlp import NLPResult
from rmesh_nlp.solution.referee import OnStep
from rmesh_nlp.solution.solution import Step

NAN = float("nan")


class Recorder:
    """A monitor of an NLP solver, or of the homotopy of an MPCC, that notes when each iterate came.

    Parameters
    ----------
    on_step : callable, optional
        Called with each step as it comes; an NLP's residuals are known only afterwards.
    n_q : int
        Number of moves at the head of x, which the steps for ``on_step`` carry.
    unit : float
        Value of the outer objective where the program's is one.
    is_energy : bool
        Whether the outer objective is the energy, which is then known at every iterate.
    """

    def __init__(
        self, on_step: OnStep | None = None, n_q: int = 0, unit: float = 1.0, is_energy: bool = True
    ) -> None:
        self.on_step, self._n_q, self._unit, self._is_energy = on_step, n_q, unit, is_energy
        self._began = time.perf_counter()
        self._before = 0
        self._steps: list[Step] = []

    def after(self, iterations: int) -> None:
        """Go on counting after so many iterations of something else."""
        self._before = iterations

    def __call__(self, iteration: int, x: Array, f: float) -> None:
        """Note an iterate of an NLP without complementarity: its relaxation parameter is infinite."""
        self._note(iteration, x, f, t=math.inf)

    def iterate(self, one: Iterate) -> None:
        """Note an iterate of a homotopy."""
        self._note(
            one.iteration,
            one.x,
            one.objective,
            t=one.t,
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
        violation: float = NAN,
        product: float = NAN,
        biactive: float = NAN,
    ) -> None:
        objective = f * self._unit
        step = Step(
            iteration=self._before + iteration,
            energy=objective if self._is_energy else NAN,
            t=t,
            primal_residual=violation,
            dual_residual=NAN,
            contact_solves=0,
            seconds=time.perf_counter() - self._began,
            objective=objective,
            product=product,
            biactive=biactive,
        )
        self._steps.append(step)
        if self.on_step is not None:
            self.on_step(replace(step, q=x[: self._n_q]))

    def steps(self, result: NLPResult | None = None) -> list[Step]:
        """The steps since the last call, with the residuals of an NLP solver filled in."""
        steps, self._steps = self._steps, []
        if result is None:
            return steps
        columns = zip(result.history["inf_pr"], result.history["inf_du"], strict=True)
        return [
            replace(step, primal_residual=primal, dual_residual=dual)
            for step, (primal, dual) in zip(steps, columns, strict=False)
        ]
