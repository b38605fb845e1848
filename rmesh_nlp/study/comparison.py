"""Comparisons: problems by formulations, a row each in ``records.jsonl``; a later run goes on with them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from itertools import product
from pathlib import Path
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import Delta, Size
from rmesh_nlp.examples.reference import with_reference
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.folder import Manifest, folder_aside
from rmesh_nlp.io.problem_file import load_problem, read_table
from rmesh_nlp.io.records import Record, Records
from rmesh_nlp.io.results import RECORDS, TABLES, Results
from rmesh_nlp.meshes.reading import FORMATS
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import as_tuple
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.settings import ByName, Values, from_texts
from rmesh_nlp.solving.formulation import check_taken, checked, taken
from rmesh_nlp.solving.plan import COMPARED, compared
from rmesh_nlp.study import engine
from rmesh_nlp.study.plan import PlannedSolve, build_example, planned
from rmesh_nlp.study.runner import INTERRUPTED

SUFFIX = ".toml", *FORMATS  # ends of names of files; those of meshes are refused with what is meant
REFINEMENTS = 2  # uniform refinements that the problem of a file is compared with
LARGEST = 20_000  # nodes that they may have


def plan_comparison(
    examples: Sequence[str],
    formulations: Sequence[str],
    *,
    n: Size | None = None,
    delta: Delta | None = None,
    order: int | None = None,
    quadrature: str | int | None = None,
    options: ByName | None = None,
    certify: bool = False,
    repeats: int = 1,
) -> list[PlannedSolve]:
    """All pairs of problems and formulations, with the same settings.

    Without ``formulations`` they are those of ``COMPARED`` that take the problem.

    An option goes to those formulations that take it; of ``objective`` and ``seed`` there may be several, as
    lists. A formulation may have options of its own, see :func:`formulation_options`. The problem of a file,
    whose name ends with ``.toml``, has the objective of its ``[solve]`` unless one is given; ``order`` takes
    the place of its own. Where energies compare it is solved on uniform refinements of its mesh as well,
    without motion.
    """
    options = dict(options or {})
    own = _file_problems(examples, order)  # with their objectives
    given: Values = {"n": n, "delta": delta, "order": order, "quadrature": quadrature}
    given = {key: value for key, value in given.items() if value is not None}
    if own:
        refuse_changes(given, "the files")
    problems: list[tuple[Values, ContactProblem, Values]] = [
        ({}, problem, {} if text == "energy" else {"objective": text}) for problem, text in own
    ]
    problems += [
        ({"kind": "example", "example": name, **given}, build_example(name, **given), {})
        for name in examples
        if not name.endswith(SUFFIX)
    ]
    errors = [text for text in as_tuple(options.get("objective", ())) if parse_objective(text).needs_exact]
    if errors and own:
        raise BadInputError(
            f"--objective {errors[0]}: needs an exact or reference solution, and {own[0][0].name!r} has none"
        )
    if errors:
        problems = [(stated, with_reference(problem), {}) for stated, problem, _ in problems]
    chosen = [formulation_options(text) for text in formulations or COMPARED]
    check_taken(options, [name for name, _ in chosen])
    several = {name: as_tuple(options[name]) for name in ("objective", "seed") if name in options}
    commons = [
        {**options, **dict(zip(several, values, strict=True))} for values in product(*several.values())
    ]
    solves = []
    for (stated, problem, default), common, (name, own_options) in product(problems, commons, chosen):
        asked = checked(name, {**taken(name, {**default, **common}), **own_options})
        if not formulations and name not in compared(problem, asked):
            continue
        limit = asked.get("limits", {}).get("seconds", math.inf)
        solves.append(
            planned(problem, name, asked, problem=stated, certify=certify, repeats=repeats, time_s=limit)
        )
    if len(commons) > 1:  # a formulation that takes no seed would be solved once for each of them
        solves = list({solve.key: solve for solve in solves}.values())
    finer = (fine for problem, _ in own for fine in _refinements(problem))
    return solves + [planned(fine, "fixed", certify=certify) for fine in finer]


def refuse_changes(given: ByName, file: str) -> None:
    """Raise a BadInputError for what is given of a problem and is for the examples alone."""
    for name in ("n", "delta", "quadrature"):
        if name in given:
            raise BadInputError(f"--{name} {given[name]} is for the examples: write it into {file}")


def formulation_options(text: str) -> tuple[str, Values]:
    """A formulation with options of its own, ``mpcc:start=joint`` or ``nested:iterations=20:seed=3``."""
    name, *parts = text.split(":")
    return name, checked(name, from_texts(parts, f"{text!r}: an option "))


def _file_problems(names: Sequence[str], order: int | None) -> list[tuple[ContactProblem, str]]:
    """The problems of those names that are files, and the objectives of their ``[solve]``."""
    problems = [
        (load_problem(Path(name), order), read_table(Path(name)).solve.objective)
        for name in names
        if name.endswith(SUFFIX)
    ]
    if name := _twice([problem.name for problem, _ in problems]):
        raise BadInputError(f"two problem files are both called {name!r}: give them a name of their own")
    return problems


def _twice(names: Sequence[str]) -> str:
    """The first of these names that is there twice; empty if each is there once."""
    counts = Counter(names)
    return next((name for name in names if counts[name] > 1), "")


def _refinements(problem: ContactProblem) -> Iterator[ContactProblem]:
    """The problem on uniformly refined meshes, coarsest first; none where there is no energy to compare."""
    for _ in range(0 if problem.design or not problem.has_energy else REFINEMENTS):
        if problem.n_vertices + problem.mesh.nfacets > LARGEST:
            return
        problem = refined(problem)
        yield problem


def run(
    plan: Sequence[PlannedSolve],
    results: Results,
    *,
    resume: bool = False,
    jobs: int = 1,
    **watched: Any,
) -> Iterator[Record]:
    """Solve and yield each row once it is on the disk, those that are there already first.

    What an earlier run left in the folder is set aside when the first solve has ended, not
    before. With ``resume`` it stays, and what succeeded there is not solved again, unless
    its fields or history are missing.

    The caller holds the lock of the folder. One job solves in this process and is ``watched`` by ``on_start``
    and ``on_step`` of :func:`rmesh_nlp.study.engine.ended`; several are processes of their own. After the row
    of an interrupted solve a KeyboardInterrupt is raised.
    """
    keys = [solve.key for solve in plan]
    if key := _twice(keys):
        raise BadInputError(f"two cases are both called {key!r}")
    results.folder.mkdir(parents=True, exist_ok=True)
    manifest = Manifest(results.folder)
    manifest.check([RECORDS, *TABLES, *(name for key in keys for name in results.names(key))])
    rows = results.read() if resume else []
    finished = _finished(plan, rows, results)
    yield from finished.values()
    todo, clean = [solve for solve in plan if solve.key not in finished], resume
    with folder_aside(results.folder) if jobs > 1 else nullcontext() as aside:
        for solve, done in engine.ended(todo, aside, jobs, **watched):
            row = done.row if "asked" in done.row else {**done.row, **solve.identity}
            if not clean:
                manifest.set_aside()
                clean = True
            manifest.claim(*results.names(solve.key))
            done.save(results.result(row))
            rows = [*(other for other in rows if other.get("key") != solve.key), row]
            results.write(rows)
            yield row
            if row["status"] == INTERRUPTED:
                raise KeyboardInterrupt


def _finished(plan: Sequence[PlannedSolve], rows: Records, results: Results) -> dict[str, Record]:
    """Rows of solves that need not be done again."""
    by_key = {row.get("key"): row for row in rows if row["success"] and row["status"] != INTERRUPTED}
    done = {}
    for solve in plan:
        row = by_key.get(solve.key)
        if row is None:
            continue
        asked = {**row, **(row.get("asked") or {})}
        for name, value in solve.identity.items():
            if asked.get(name) != value:
                raise BadInputError(
                    f"cannot resume {solve.key}: it was solved with {name} {asked.get(name)}, not {value}"
                )
        often = row.get("repeats", 1) >= solve.repeats
        if results.result(row).is_whole and often and (not solve.certify or "certificate_remark" in row):
            done[solve.key] = row
    return done
