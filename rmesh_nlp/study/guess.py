"""How long a plan may take, roughly: from rows that are there, else from a rule of thumb."""

from __future__ import annotations

import re
from collections.abc import Sequence
from statistics import median

from rmesh_nlp.io.records import Record
from rmesh_nlp.study.plan import PlannedSolve

RULE_S = {"fixed": 0.1, "joint": 0.5, "nested": 1.5, "mpcc": 2.5}
"""Seconds of a solve with 128 triangles on a processor of 2020, audit included (Example 6.1, n = 8)."""

GROWTH = 1.3
"""Times grow at least like this power of the number of triangles."""


def seconds_of_plan(solves: Sequence[PlannedSolve], rows: Sequence[Record]) -> float:
    """Seconds that the solves take one after the other."""
    known: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if row.get("task_time_s") is not None:
            known.setdefault((str(row.get("variant")), str(row.get("family"))), []).append(row["task_time_s"])
    total = 0.0
    for solve in solves:
        times = known.get((solve.variant, solve.family))
        seconds = median(times) if times else _rule(solve)
        total += min(seconds, solve.time_s)
    return total


def _rule(solve: PlannedSolve) -> float:
    numbers = [int(number) for number in re.findall(r"\d+", solve.size)]
    triangles = 30 if not numbers else 2 * numbers[0] * numbers[-1]
    return RULE_S.get(solve.formulation, 1.0) * max(1.0, triangles / 128) ** GROWTH
