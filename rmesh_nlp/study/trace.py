"""The first-order residual of the outer problem along a solve, by one measure for all formulations.

Solvers report residuals of programs of their own, in units of their own. Here the moves of each step are
kept, and once the solve has ended the residual is measured at them, off the formulation's clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution

MEASURED = 60
"""Steps at most that are measured, evenly spread, the last one among them."""


class Trace:
    """Keeps the moves of the steps that it is called with, and passes the steps on.

    Parameters
    ----------
    on_step : callable, optional
        Called with each step.
    """

    def __init__(self, on_step: Callable[[Step], None] | None = None) -> None:
        self._on_step = on_step
        self._moves: dict[int, Array] = {}

    def __call__(self, step: Step) -> None:
        """Note a step."""
        if step.q is not None and np.isnan(step.stationarity):
            self._moves[step.iteration] = step.q
        if self._on_step is not None:
            self._on_step(step)

    def measured(self, solution: Solution) -> tuple[Step, ...]:
        """The history with ``stationarity``, where a formulation has not filled it in itself."""
        if not self._moves or "flips" in solution.extra or "regularisation" in solution.extra:
            return solution.history  # flipped edges, or several programs one after the other
        outer = Outer(solution.problem, solution.objective)
        free = outer.relocation.mesh_map
        moves = {i: q for i, q in self._moves.items() if q.size == free.n and np.all(np.isfinite(q))}
        if not moves:
            return solution.history
        function = outer.function
        residual = outer.residual
        found: dict[int, float] = {}
        for iteration in _spread(sorted(moves)):
            q = np.clip(moves[iteration], -free.bound, free.bound)
            areas = signed_areas(outer.nodes(q), solution.problem.triangles)
            if np.min(areas) > 0 and function.is_defined(q):
                found[iteration] = residual(function(q))
        return tuple(
            replace(step, stationarity=found.get(step.iteration, step.stationarity))
            for step in solution.history
        )


def _spread(iterations: list[int]) -> list[int]:
    """At most ``MEASURED`` of them, the last one included."""
    every = -(-len(iterations) // MEASURED)
    return iterations[::-1][::every][::-1]
