"""A rule for the loads that the assessment confirms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import corrections
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer

RULES = (6, 10, 14, 20)
"""Degrees of the quadrature rule that are tried in turn; the last one is that of the assessment."""

AGREEMENT = 0.01
"""Largest error of the gain by the rule, in parts of the assessed gain."""


@dataclass(frozen=True)
class Confirmed(Wrapper):
    """Raises the degree of the rule for the loads until it changes the gain by at most 1 %.

    Attributes
    ----------
    then : Formulation, optional
        What goes on with a higher rule from where the last one ended; by default what began.
    """

    then: Any = None

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        outcome, rules = monitor.run(self.inner, outer, q), [outer.problem.quadrature]
        while True:
            higher = next_rule(outcome.outer.problem)
            if monitor.budget.is_over() or higher is None:
                break
            with monitor.budget.during("audit"):
                confirmed = agrees(outcome)
            if confirmed:
                break
            rules.append(higher)
            with monitor.budget.during("build"):
                finer = outcome.outer.on(replace(outcome.outer.problem, quadrature=higher))
            outcome = monitor.run(self.then or self.inner, finer, outcome.q).after(outcome)
        return outcome.having({"rules": tuple(rules)})


def first_rule(problem: ContactProblem) -> str | int:
    """The rule to begin with: where a load varies an exact one of low degree, else degree 6 at least."""
    if not any(callable(component) for law in problem.laws for component in law.load):
        return problem.quadrature
    rule = problem.rule
    if not isinstance(rule, int):
        return RULES[0]
    return min(rule, RULES[0]) if problem.quadrature == "auto" else max(rule, RULES[0])


def next_rule(problem: ContactProblem) -> int | None:
    """The next degree to try; None if the problem's rule is that of the assessment already."""
    rule = problem.rule
    return next((degree for degree in RULES if not isinstance(rule, int) or degree > rule), None)


def agrees(outcome: Outcome) -> bool:
    """Whether the problem's rule for the loads changes the gain by at most 1 %."""
    outer, q = outcome.outer, outcome.q
    if not outer.is_valid(q) or not np.any(q):
        return True
    exact, assessor = outer.energy(q).equilibrium, outer.assessor
    continuous = assessor.solve(outer.nodes(q), exact.active)
    wrong = corrections(outer.contact, outer.nodes(q), exact, continuous)["quadrature"]
    wrong -= assessor.initial_corrections["quadrature"]
    return bool(abs(wrong) <= AGREEMENT * abs(assessor.initial.energy - continuous.energy))
