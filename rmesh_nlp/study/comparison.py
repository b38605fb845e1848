"""Many solves, one row each: whatever happens to a solve, it leaves a row and the next one runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.export import write_solution
from rmesh_nlp.io.files import remove_leftovers, write_whole
from rmesh_nlp.io.records import REQUIRED, Record
from rmesh_nlp.io.results import HISTORY_FIELDS, RECORDS, TABLES, Result, Results, write_history
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.driver import solve_by_options
from rmesh_nlp.solving.formulation import find
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution, versions
from rmesh_nlp.solving.verification import error_terms
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.cases import plan_comparison as plan_comparison
from rmesh_nlp.study.repeats import joined
from rmesh_nlp.study.trace import Trace

OnStep = Callable[[Step], None]


@dataclass(frozen=True)
class Outcome:
    """The row of a solve, and its solution unless it raised."""

    record: Record
    solution: Solution | None
    history: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Ended:
    """How a case ended: its row, and what puts its fields and history into their places."""

    case: Case
    record: Record
    save: Callable[[Result], object]


Solver = Callable[[Sequence[Case]], Iterator[Ended]]

INTERRUPTED = Status.INTERRUPTED.value


def solve(case: Case, on_step: OnStep | None = None) -> Outcome:
    """Run one case, as often as it asks for; an exception becomes a row with its message.

    The times of the row are then medians, everything else is that of the first run.

    Raises
    ------
    BadInputError
        If the formulation does not exist.
    """
    first = _solve(case, on_step)
    if first.solution is None or case.repeats == 1 or first.record["status"] == INTERRUPTED:
        return first
    records = [first.record]
    for _ in range(case.repeats - 1):
        records.append(_solve(replace(case, certify=False, trace=False), on_step).record)
        if records[-1]["status"] == INTERRUPTED:
            return replace(first, record=records[-1])
    return replace(first, record=joined(records))


def _solve(case: Case, on_step: OnStep | None) -> Outcome:
    made = case.made or case.formulation
    if isinstance(made, str):
        find(made)
    trace = Trace(on_step) if case.trace else None
    began = time.perf_counter()
    try:
        solution = solve_by_options(
            case.problem, made, case.options, on_step=trace or on_step, certify=case.certify
        )
        record = {**case.identity, "message": solution.status.message, **solution.record(), "key": case.key}
        asked = {name: value for name, value in case.identity.items() if record[name] != value}
        if asked:  # auto chose, or the rule was raised
            record["asked"] = asked
        terms = error_terms(solution) if solution.audit.min_area_ratio > 0 else None
        record.update({} if terms is None else terms.entries())
    except ValueError as error:  # the formulation does not take this problem or option
        return Outcome(_failure(case, "refused", error, time.perf_counter() - began), None)
    except Exception as error:
        return Outcome(_failure(case, "failed", error, time.perf_counter() - began), None)
    history = solution.history
    if trace is not None and record["status"] != INTERRUPTED:
        with suppress(ValueError, ArithmeticError, RuntimeError):  # a solve that ended stays what it is
            history = trace.measured(solution)
    return Outcome(record, solution, history)


def _failure(case: Case, status: str, error: Exception, seconds: float) -> Record:
    empty = dict.fromkeys(REQUIRED)
    text = " ".join(str(error).split()) or type(error).__name__
    return {
        **empty,
        **case.identity,
        "objective": case.options.get("objective", "energy"),
        "status": status,
        "success": False,
        "message": text if isinstance(error, ValueError) else f"{type(error).__name__}: {text}",
        "stationarity": "",
        "wall_time_s": seconds,
        "versions": versions(),
        "seed": case.options.get("seed"),
    }


def run(
    cases: Sequence[Case],
    results: Results,
    *,
    resume: bool = False,
    locked: bool = False,
    on_start: Callable[[Case], None] | None = None,
    on_step: OnStep | None = None,
    solver: Solver | None = None,
) -> Iterator[Record]:
    """Solve the cases and yield each record once it is on the disk, those that are there already first.

    What an earlier run left in the folder is set aside when the first solve has ended, not
    before. With ``resume`` it stays, and cases that succeeded there are not solved again, unless
    their fields or history are missing or damaged.

    Parameters
    ----------
    cases : sequence of Case
    results : Results
    resume : bool
    locked : bool
        The caller holds the lock of the folder; else it is taken here.
    on_start, on_step : callable, optional
        Called before each solve, and after each of its iterations.
    solver : callable, optional
        Solves cases and yields how each ended; by default one after the other in this process.

    Raises
    ------
    KeyboardInterrupt
        After the row of a solve that was interrupted: the next one does not begin.
    BadInputError
        If two cases have one key, the rows to be resumed were solved with other settings, another
        process writes in the folder, or a file of the user's is in the way.
    """
    keys = [case.key for case in cases]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInputError(f"two cases are both called {key!r}")
    results.folder.mkdir(parents=True, exist_ok=True)
    with nullcontext() if locked else results.locked():
        yield from _run(cases, results, resume, solver or _one_by_one(on_start, on_step))


def _one_by_one(on_start: Callable[[Case], None] | None, on_step: OnStep | None) -> Solver:
    def solver(cases: Sequence[Case]) -> Iterator[Ended]:
        for case in cases:
            if on_start is not None:
                on_start(case)
            outcome = solve(case, on_step)
            yield Ended(case, outcome.record, partial(save, outcome))

    return solver


def _run(cases: Sequence[Case], results: Results, resume: bool, solver: Solver) -> Iterator[Record]:
    remove_leftovers(results.folder)
    manifest = results.manifest
    manifest.check(_names(cases, results))
    rows = results.repaired() if resume else []
    done = _finished(cases, rows, results)
    yield from done.values()
    clean = resume
    for ended in solver([case for case in cases if case.key not in done]):
        record, key = ended.record, ended.case.key
        if not clean:
            results.set_aside()
            clean = True
        manifest.claim(*results.names(key))
        ended.save(results.result(record))
        if any(row.get("key") == key for row in rows):
            rows = [*(row for row in rows if row.get("key") != key), record]
            results.replace_all(rows)
        else:
            rows.append(record)
            results.append(record)
        yield record
        if record["status"] == INTERRUPTED:
            raise KeyboardInterrupt


def _names(cases: Sequence[Case], results: Results) -> list[str]:
    """What will be written for these cases."""
    return [RECORDS, *TABLES, *(name for case in cases for name in results.names(case.key))]


def save(outcome: Outcome, places: Result) -> None:
    """Write fields and history of an outcome; a solve that raised has none, nor keeps older ones."""
    solution = outcome.solution
    if solution is None:
        places.vtu.unlink(missing_ok=True)
        places.history.unlink(missing_ok=True)
        return
    write_whole(places.vtu, lambda path: write_solution(solution, path, "vtu", solution.certificate))
    steps = [step.row() for step in outcome.history]
    rows = [{name: row[name] for name in HISTORY_FIELDS} for row in steps]
    write_whole(places.history, lambda path: write_history(path, rows))


def _finished(cases: Sequence[Case], rows: Sequence[Record], results: Results) -> dict[str, Record]:
    """Rows of cases that need not be solved again."""
    by_key = {row.get("key"): row for row in rows if row["success"] and row["status"] != INTERRUPTED}
    done = {}
    for case in cases:
        row = by_key.get(case.key)
        if row is None:
            continue
        asked = {**row, **(row.get("asked") or {})}
        for name, value in case.identity.items():
            if asked.get(name) != value:
                raise BadInputError(
                    f"cannot resume {case.key}: it was solved with {name} {asked.get(name)}, not {value}"
                )
        often = row.get("repeats", 1) >= case.repeats
        if results.is_intact(row) and often and (not case.certify or "certificate_remark" in row):
            done[case.key] = row
    return done
