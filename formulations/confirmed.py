"""A rule for the loads that the assessment confirms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rmesh_nlp.assessment.measures import corrections
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.state import accurate

FIRST = 6
"""Degree of the quadrature rule that is tried before that of the assessment."""

AGREEMENT = 0.01
"""Largest error of the gain by the rule, in parts of the assessed gain."""


@dataclass(frozen=True)
class Confirmed(Wrapper):
    """Takes the rule of the assessment for the loads where the problem's changes the gain by more than 1 %.

    Attributes
    ----------
    then : Formulation, optional
        What goes on with a higher rule from where the last one ended; by default what began.
    """

    then: Any = None

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        outcome, problem = monitor.run(self.inner, outer, q), outer.problem
        rules = [problem.quadrature]
        if monitor.budget.is_over() or accurate(problem) is problem:
            return outcome.having({"rules": tuple(rules)})
        with monitor.budget.during("audit"):
            confirmed = agrees(outcome)
        if not confirmed:
            with monitor.budget.during("build"):
                finer = outcome.outer.on(accurate(outcome.outer.problem))
            rules.append(finer.problem.quadrature)
            outcome = monitor.run(self.then or self.inner, finer, outcome.q).after(outcome)
        return outcome.having({"rules": tuple(rules)})


def first_rule(problem: ContactProblem) -> str | int:
    """The rule to begin with: an exact one, else of degree 6 at least."""
    rule = problem.quadrature
    return problem.exact_rule or (max(rule, FIRST) if isinstance(rule, int) else FIRST)


def agrees(outcome: Outcome) -> bool:
    """Whether the problem's rule for the loads changes the gain by at most 1 %."""
    outer, q = outcome.outer, outcome.q
    if not outer.is_valid(q) or not np.any(q):
        return True
    ends = (outer.contact.given, outer.initial), (outer.energy(q).equilibrium, outer.continuous(q))
    before, after = (
        corrections(outer.contact, nodes, solved, continuous)["quadrature"]
        for nodes, (solved, continuous) in zip((outer.problem.mesh.p, outer.nodes(q)), ends, strict=True)
    )
    return bool(abs(after - before) <= AGREEMENT * abs(outer.initial.energy - outer.continuous(q).energy))
