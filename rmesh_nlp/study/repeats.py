"""Times of repeated solves: medians, and the range that says what they are worth."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from rmesh_nlp.io.records import Record

TIMES = ("build_time_s", "solve_time_s", "audit_time_s", "wall_time_s", "contact_time_s")
"""Entries of a record that are seconds."""


def joined(records: Sequence[Record]) -> Record:
    """The first of several records of one solve, with the medians of the times of all.

    Beside each time stands its range, ``build_time_range_s`` and so on: the least and the largest.
    ``repeats`` says how many there were, ``first_cost_s`` what build and solve of the first took: its history
    is kept. One record stays as it is.
    """
    first = records[0]
    if len(records) == 1:
        return first
    found: Record = {**first, "repeats": len(records)}
    for name in TIMES:
        seconds = [record[name] for record in records if record.get(name) is not None]
        if seconds:
            found[name] = median(seconds)
            found[name.replace("_time_s", "_time_range_s")] = [min(seconds), max(seconds)]
    if first.get("build_time_s") is not None and first.get("solve_time_s") is not None:
        found["first_cost_s"] = first["build_time_s"] + first["solve_time_s"]
    return found
