"""The error reduction of a solution, and its quantities on a refined mesh, for the record."""

from __future__ import annotations

import time
from dataclasses import replace

from rmesh_nlp.assessment.error_reduction import error_reduction
from rmesh_nlp.assessment.quantities import Quantities, worse
from rmesh_nlp.solving.solution import Solution, interrupted


def with_error_reduction(solution: Solution) -> Solution:
    """The solution with its error reduction in the record; the time for that counts as audit."""
    if solution.assessed is None:
        return solution
    began = time.perf_counter()
    try:
        found, refined = error_reduction(*solution.assessed, solution.contact_solves)
    except KeyboardInterrupt:  # the solution is there
        return interrupted(solution)
    extra = dict(solution.extra)
    if found is not None:
        extra["error_reduction"] = found.record()
    if refined is not None:
        extra |= refined.entries("_refined")
        before, after = (
            Quantities(**{name: extra[name + suffix] for name in vars(refined)})
            for suffix in ("_initial", "")
        )
        extra["warnings"] = [*extra["warnings"], *worse(before, after, refined)]
    return replace(solution, extra=extra, audit_time_s=solution.audit_time_s + time.perf_counter() - began)
