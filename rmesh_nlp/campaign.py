"""Many solves, one row each: whatever happens to a solve, it leaves a row and the next one runs."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

from rmesh_nlp import strategies
from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.examples import EXAMPLES, Delta, Size
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.objectives import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.reference import with_reference
from rmesh_nlp.results import HISTORY_FIELDS, REQUIRED, Record, Result, Results, write_history, write_whole
from rmesh_nlp.solution import Solution, Step, versions
from rmesh_nlp.vtu import fields_of, write_vtu

OnStep = Callable[[Step], None]
Guard = Callable[[], AbstractContextManager[object]]


@dataclass(frozen=True)
class Case:
    """One solve to be done.

    Attributes
    ----------
    problem : ContactProblem
    formulation : str
        Name of an installed strategy.
    options : mapping
        Keyword arguments of the strategy's ``solve``: ``objective``, ``relaxation``, ``seed``, ...
    """

    problem: ContactProblem
    formulation: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """A name for files, such as ``6.2-12x6-joint`` or ``6.1-8-mpcc-seed3``."""
        options = [
            f"{name}{value}" if name == "seed" else str(value) for name, value in sorted(self.options.items())
        ]
        parts = [self.problem.name, self.problem.size, self.formulation, *options]
        return re.sub(r"[^\w.+-]+", "_", "-".join(part for part in parts if part))

    @property
    def identity(self) -> Record:
        """The entries of the record that say which solve it is."""
        return {
            "key": self.key,
            "example": self.problem.name,
            "formulation": self.formulation,
            "n": self.problem.size,
            "delta": self.problem.motion.delta_record(),
            "quadrature": self.problem.quadrature,
        }


@dataclass(frozen=True)
class Outcome:
    """The row of a solve, and its solution unless it raised."""

    record: Record
    solution: Solution | None


def make_cases(
    examples: Sequence[str],
    formulations: Sequence[str],
    *,
    n: Size | None = None,
    delta: Delta | None = None,
    quadrature: str | int = "midpoint",
    options: Mapping[str, Any] | None = None,
) -> list[Case]:
    """All pairs of examples and strategies, with the same settings.

    An option goes to those strategies that take it.

    Raises
    ------
    BadInputError
        If a name is unknown, a setting does not suit an example, or no strategy takes an option.
    """
    options = dict(options or {})
    _check_options(options)
    problems = [build_problem(name, n=n, delta=delta, quadrature=quadrature) for name in examples]
    if "objective" in options and parse_objective(options["objective"]).needs_exact:
        problems = [with_reference(problem) for problem in problems]
    taken = {name: strategies.accepted(strategies.load(name), options) for name in formulations}
    for option in options:
        if not any(option in names for names in taken.values()):
            raise BadInputError(f"--{option} {options[option]}: not an option of {', '.join(formulations)}")
    return [
        Case(problem, name, {option: options[option] for option in options if option in taken[name]})
        for problem in problems
        for name in formulations
    ]


def build_problem(
    name: str, *, n: Size | None = None, delta: Delta | None = None, quadrature: str | int = "midpoint"
) -> ContactProblem:
    """An example by name; by default of the paper's size.

    Raises
    ------
    BadInputError
        If the name is unknown or the example refuses the size or the delta.
    """
    if name not in EXAMPLES:
        raise unknown("example", name, EXAMPLES)
    given = {key: value for key, value in (("n", n), ("delta", delta)) if value is not None}
    try:
        return replace(EXAMPLES[name](**given), quadrature=quadrature)
    except (ValueError, MemoryError) as error:
        raise BadInputError(str(error)) from error


def _check_options(options: Mapping[str, Any]) -> None:
    if "objective" in options:
        try:
            parse_objective(options["objective"])
        except ValueError as error:
            raise BadInputError(str(error)) from error
    if options.get("relaxation", "scholtes") not in RELAXATIONS:
        raise unknown("relaxation", options["relaxation"], RELAXATIONS)


def solve(case: Case, on_step: OnStep | None = None) -> Outcome:
    """Run one case; an exception becomes a row with its message.

    Raises
    ------
    BadInputError
        If the strategy does not exist.
    """
    function = strategies.load(case.formulation)
    watch = dict.fromkeys(strategies.accepted(function, ("on_step",)), on_step)
    began = time.perf_counter()
    try:
        solution = function(case.problem, **case.options, **watch)
        record = {**case.identity, "message": solution.status.message, **solution.record(), "key": case.key}
    except ValueError as error:  # the strategy does not take this problem or option
        return Outcome(_failure(case, "refused", error, time.perf_counter() - began), None)
    except Exception as error:
        return Outcome(_failure(case, "failed", error, time.perf_counter() - began), None)
    return Outcome(record, solution)


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
    guard: Guard = nullcontext,
    on_start: Callable[[Case], None] | None = None,
    on_step: OnStep | None = None,
) -> Iterator[Record]:
    """Solve the cases one after the other and yield each record once it is on the disk.

    What an earlier run left in the folder is set aside when the first solve has ended, not
    before. With ``resume`` it stays, and cases that succeeded there are not solved again.

    Parameters
    ----------
    cases : sequence of Case
    results : Results
    resume : bool
    guard : callable, optional
        Makes a context in which each solve runs, and only it: nothing is written there.
    on_start, on_step : callable, optional
        Called before each solve, and after each of its iterations.

    Raises
    ------
    BadInputError
        If two cases have one key, or the rows to be resumed were solved with other settings.
    """
    keys = [case.key for case in cases]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInputError(f"two cases are both called {key!r}")
    rows = results.read() if resume and (results.folder / "records.jsonl").exists() else []
    done = _finished(cases, rows)
    results.folder.mkdir(parents=True, exist_ok=True)
    clean = False
    for case in cases:
        if case.key in done:
            yield done[case.key]
            continue
        if on_start is not None:
            on_start(case)
        with guard():
            outcome = solve(case, on_step)
        if not clean:
            _make_room(results, rows, keys, done, resume)
            clean = True
        save(outcome, results.result(outcome.record))
        results.append(outcome.record)
        yield outcome.record


def save(outcome: Outcome, places: Result) -> None:
    """Write fields and history of an outcome; a solve that raised has none, nor keeps older ones."""
    solution = outcome.solution
    if solution is None:
        places.vtu.unlink(missing_ok=True)
        places.history.unlink(missing_ok=True)
        return
    write_whole(places.vtu, lambda path: write_vtu(path, fields_of(solution)))
    rows = [{name: row[name] for name in HISTORY_FIELDS} for row in solution.history_rows()]
    write_whole(places.history, lambda path: write_history(path, rows))


def _finished(cases: Sequence[Case], rows: Sequence[Record]) -> dict[str, Record]:
    """Rows of cases that need not be solved again."""
    by_key = {row.get("key"): row for row in rows if row["success"]}
    done = {}
    for case in cases:
        row = by_key.get(case.key)
        if row is None:
            continue
        for name, value in case.identity.items():
            if row.get(name) != value:
                raise BadInputError(
                    f"cannot resume {case.key}: it was solved with {name} {row.get(name)}, not {value}"
                )
        done[case.key] = row
    return done


def _make_room(
    results: Results, rows: Sequence[Record], keys: Sequence[str], done: Mapping[str, Record], resume: bool
) -> None:
    if not resume:
        results.set_aside()
    elif rows:
        results.replace_all([row for row in rows if row.get("key") in done or row.get("key") not in keys])
