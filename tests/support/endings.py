"""Formulations and outcomes that end where a test says."""

from dataclasses import dataclass
from typing import Any

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.formulation import Choice, Chooser, Formulation
from rmesh_nlp.solving.outer import Outer


@dataclass(frozen=True)
class Ends(Formulation):
    """Ends where ``end(outer, q, monitor)`` says."""

    end: Any

    def run(self, outer: Outer, q: Array, monitor: rm.Monitor) -> rm.Outcome:
        return self.end(outer, q, monitor)


@dataclass(frozen=True)
class Chooses(Chooser):
    """Chooses :class:`Ends`."""

    end: Any

    def choose(self, problem: rm.ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        return Choice(Ends(self.end), problem, "there is no other")


def ended(
    outer: Outer, q: Array, status: rm.Status = rm.Status.CONVERGED, *, relocates: bool = True, **fields: Any
) -> Assessment:
    """What is assess of an end at moves ``q``."""
    return assess(outer, rm.Outcome(outer, q, status, **fields), relocates=relocates)
