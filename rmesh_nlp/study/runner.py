"""A planned solve becomes a row, whatever happens to it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from statistics import median

from rmesh_nlp.errors import one_line
from rmesh_nlp.io.export import write_solution
from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.records import REQUIRED, Record, Records
from rmesh_nlp.io.results import Result, write_history
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.entries import versions
from rmesh_nlp.solving.monitor import OnStep
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.study.plan import PlannedSolve, build

INTERRUPTED = Status.INTERRUPTED.value

TIMES = ("build_time_s", "solve_time_s", "audit_time_s", "wall_time_s", "contact_time_s")
"""Entries of a record that are seconds."""


@dataclass(frozen=True)
class Done:
    """The row of a solve, and its solution unless it raised or was solved in another process.

    That process has put fields and history ``aside``.
    """

    row: Record
    solution: Solution | None = None
    aside: Result | None = None

    def save(self, places: Result) -> None:
        """Put fields and history in place; a solve that raised has none, and removes older ones."""
        if (solution := self.solution) is not None:
            write_whole(places.vtu, lambda path: write_solution(solution, path, "vtu"))
            rows = [step.row() for step in solution.history]
            write_whole(places.history, lambda path: write_history(path, rows))
        elif self.aside is not None and self.aside.is_whole:
            places.vtu.parent.mkdir(exist_ok=True)
            os.replace(self.aside.vtu, places.vtu)
            os.replace(self.aside.history, places.history)
        else:
            places.vtu.unlink(missing_ok=True)
            places.history.unlink(missing_ok=True)


def perform(solve: PlannedSolve, on_step: OnStep | None = None) -> Done:
    """Run a planned solve, as often as it asks for; an exception becomes a row with its message.

    With repeats the times of the row are medians, everything else is that of the first run. An interrupted
    run is the last, and its row is kept.
    """
    try:
        solve = replace(solve, built=build(solve))
    except Exception as error:  # a problem that cannot be built here
        return Done(failure(solve, "failed", f"{type(error).__name__}: {_one_line(error)}"))
    first = _once(solve, on_step)
    rows = [first.row]
    while first.solution is not None and len(rows) < solve.repeats and rows[-1]["status"] != INTERRUPTED:
        rows.append(_once(replace(solve, certify=False), on_step).row)
    return replace(first, row=rows[-1] if rows[-1]["status"] == INTERRUPTED else joined(rows))


def _once(solve: PlannedSolve, on_step: OnStep | None) -> Done:
    assert solve.built is not None
    watch = Budget()
    try:
        formulation, identity = solve.made or solve.formulation, solve.identity
        solution = driver.solve(
            solve.built, formulation, **solve.options, on_step=on_step, certify=solve.certify
        )
        row = {**identity, **solution.record(), "key": solve.key}
        asked = {name: value for name, value in identity.items() if row[name] != value}
        if asked:  # auto chose, or the rule was raised
            row["asked"] = asked
        return Done(row, solution)
    except ValueError as error:  # the formulation does not take this problem or option
        return Done(failure(solve, "refused", _one_line(error), watch.elapsed))
    except Exception as error:
        said = f"{type(error).__name__}: {_one_line(error)}"
        return Done(failure(solve, "failed", said, watch.elapsed))


def _one_line(error: Exception) -> str:
    return one_line(error) or type(error).__name__


def failure(solve: PlannedSolve, status: str, message: str, seconds: float = 0.0) -> Record:
    """The row of a solve of which nothing else is known."""
    return {
        **dict.fromkeys(REQUIRED),
        **solve.identity,
        "objective": solve.options.get("objective", "energy"),
        "status": status,
        "success": False,
        "message": message,
        "stationarity": "",
        "wall_time_s": seconds,
        "versions": versions(),
        "seed": solve.options.get("seed"),
    }


def joined(rows: Records) -> Record:
    """The first of several rows of one solve, with the medians of the times of all.

    Beside each time stands its range, ``build_time_range_s`` and so on: the least and the largest.
    ``repeats`` says how many there were, ``first_cost_s`` what build and solve of the first took: its history
    is kept. One row stays as it is.
    """
    first = rows[0]
    if len(rows) == 1:
        return first
    record: Record = {**first, "repeats": len(rows)}
    for name in TIMES:
        seconds = [row[name] for row in rows if row.get(name) is not None]
        if seconds:
            record[name] = median(seconds)
            record[name.replace("_time_s", "_time_range_s")] = [min(seconds), max(seconds)]
    if first.get("build_time_s") is not None and first.get("solve_time_s") is not None:
        record["first_cost_s"] = first["build_time_s"] + first["solve_time_s"]
    return record
