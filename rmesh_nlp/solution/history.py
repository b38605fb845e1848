"""Histories of Ipopt runs as Steps."""

from __future__ import annotations

import time
from dataclasses import replace

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.nlp import NLPResult
from rmesh_nlp.solution.referee import OnStep
from rmesh_nlp.solution.solution import Step

NAN = float("nan")


class Recorder:
    """A monitor of an NLP solver that notes when each iterate came, and reports it.

    Parameters
    ----------
    on_step : callable, optional
        Called with each step as it comes; residuals are known only afterwards.
    n_q : int
        Number of moves at the head of x, which the steps for ``on_step`` carry.
    unit : float
        Energy of an objective of one; NaN if the objective is not the energy.
    """

    def __init__(self, on_step: OnStep | None = None, n_q: int = 0, unit: float = 1.0) -> None:
        self._on_step, self._n_q, self._unit = on_step, n_q, unit
        self._began = time.perf_counter()
        self._steps: list[Step] = []

    def __call__(self, iteration: int, x: Array, f: float) -> None:
        """Note an iterate."""
        step = Step(iteration, f * self._unit, NAN, NAN, NAN, 0, time.perf_counter() - self._began)
        self._steps.append(step)
        if self._on_step is not None:
            self._on_step(replace(step, q=x[: self._n_q]))

    def steps(self, result: NLPResult) -> list[Step]:
        """The steps with the solver's residuals and barrier parameter filled in."""
        history = result.history
        columns = zip(history["mu"], history["inf_pr"], history["inf_du"], strict=True)
        return [
            replace(step, t=mu, primal_residual=primal, dual_residual=dual)
            for step, (mu, primal, dual) in zip(self._steps, columns, strict=False)
        ]
