"""Degrees of quadrature: where to begin, and when the audit asks for a higher one."""

from __future__ import annotations

from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solution.solution import Solution

RULES = (6, 10, 14, 20)
"""Degrees of the quadrature rule that are tried in turn; the last one is that of the audit."""

AGREEMENT = 0.01
"""Largest difference of the gain by the rule and by the audit, in parts of the audited gain."""


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
    """Whether the gain by the problem's rule is the audited one, to 1 %."""
    audited = solution.energy_initial_audited - solution.audit.energy_audited
    return abs(solution.energy_initial - solution.energy - audited) <= AGREEMENT * abs(audited)
