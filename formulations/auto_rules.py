"""Degrees of quadrature: where to begin, and when the audit asks for a higher one."""

from __future__ import annotations

from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution

RULES = (6, 10, 14, 20)
"""Degrees of the quadrature rule that are tried in turn; the last one is that of the audit."""

AGREEMENT = 0.01
"""Largest error of the gain by the rule, in parts of the audited gain."""


def first_rule(problem: ContactProblem) -> str | int:
    """The rule to begin with: where a load varies an exact one of low degree, else degree 6 at least."""
    if not any(callable(component) for law in problem.laws for component in law.load):
        return problem.quadrature
    rule = problem.rule
    if not isinstance(rule, int):
        return RULES[0]
    return min(rule, RULES[0]) if problem.quadrature == "auto" else max(rule, RULES[0])


def next_rule(problem: ContactProblem) -> int | None:
    """The next degree to try; None if the problem's rule is that of the audit already."""
    rule = problem.rule
    return next((degree for degree in RULES if not isinstance(rule, int) or degree > rule), None)


def agrees(solution: Solution) -> bool:
    """Whether the problem's rule for the loads changes the gain by at most 1 %."""
    wrong = 0.0 if solution.measured is None else solution.measured.corrections["quadrature"]
    return abs(wrong) <= AGREEMENT * abs(solution.gain_audited)
