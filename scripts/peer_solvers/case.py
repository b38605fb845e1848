"""A problem to be solved, and where a solver stopped."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution


@dataclass(frozen=True)
class Case:
    """A relocation problem, what is minimised, and the seconds a solver may take."""

    problem: ContactProblem
    objective: str = "energy"
    limit: float = float("inf")

    @property
    def settings(self) -> dict[str, object]:
        """Keywords of our solves."""
        return {"objective": self.objective, "limits": rm.Limits(min(self.limit, 1e6))}


@dataclass(frozen=True)
class Finish:
    """Positions (2, nodes), the solver's own word, processor seconds of build and solve, and counts.

    ``value`` is the objective, where that is not the energy.
    """

    nodes: Array
    status: str
    seconds: float
    iterations: int | None = None
    value: float | None = None


def finish(case: Case, solution: Solution, began: float) -> Finish:
    """Where one of our formulations stopped; the assessment is no part of its time."""
    seconds, record = time.process_time() - began, solution.record()
    seconds *= 1 - record["audit_time_s"] / record["wall_time_s"]
    status = solution.status.value if solution.success else f"{solution.status.value}, no success"
    value = None if case.objective == "energy" else float(solution.extra["objective_value"])
    return Finish(np.asarray(solution.mesh.p), status, seconds, solution.iterations, value)
