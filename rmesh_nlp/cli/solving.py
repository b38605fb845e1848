"""What ``rmesh solve`` and ``rmesh compare`` do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from rmesh_nlp.cli import load
from rmesh_nlp.cli.folders import NO_SUCCESS, SUCCESS, notes, writable
from rmesh_nlp.cli.preparing import load_problem, solve_options
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io import kept_problem
from rmesh_nlp.io.export import Series, write_mesh
from rmesh_nlp.io.folder import safe_name, write_whole
from rmesh_nlp.io.problem_file import read_table
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.io.records import DamagedRecordsWarning, Record, to_json
from rmesh_nlp.io.results import RECORDS, TABLES, Results, write_single
from rmesh_nlp.optimize.budget import deferred
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.summary import contact_rows
from rmesh_nlp.study import comparison
from rmesh_nlp.study.plan import PlannedSolve, planned
from rmesh_nlp.study.progress import SolvesProgress
from rmesh_nlp.study.runner import INTERRUPTED, Done, perform

SINGLE = ("record.json", "solution.vtu", "history.csv")
FILES = (*SINGLE, "mesh.msh")  # of a problem file, the series of its iterates and the figures aside
SERIES, FIGURES = "iterations/x", "figures/x"  # one of the files of a folder, to check that it may be written
SERIES_NODES = 200_000  # of all frames of a series: with more, writing them takes longer than the solve


def solve(
    example: str, formulation: str, given: Mapping[str, Any], out: Path | None, voice: str = "text"
) -> int:
    """Solve an example; returns the exit code.

    ``given`` are keywords of :func:`rmesh_nlp.study.comparison.plan_comparison`. What is printed is "text",
    "json" (the record) or "quiet".
    """
    (plan,) = comparison.plan_comparison([example], [formulation], **given)
    folder = Path("results") / plan.key if out is None else out
    with writable(folder, SINGLE) as results, SolvesProgress(1, quiet=voice != "text") as progress:
        done = _performed(plan, progress)
        if done.row["status"] == "refused":
            raise BadInputError(done.row["message"])
        results.manifest.claim(*SINGLE)
        write_single(folder, done.row, done.save)
        progress.finish(done.row)
    if voice == "json":
        print(to_json(done.row))
    elif voice == "text":
        for what, value in [] if done.solution is None else contact_rows(done.solution):
            print(f"{what} {value}")
        _say_certificate(done)
        print("wrote", ", ".join(str(folder / name) for name in SINGLE if (folder / name).exists()))
    return _exit_code(done.row, folder)


def solve_file(
    path: Path,
    formulation: str | None,
    options: Mapping[str, Any],
    order: int | None,
    certify: bool,
    out: Path | None,
    voice: str = "text",
    columns: int = 2,
) -> int:
    """Solve the problem of a file; returns the exit code.

    Options given on the command line override ``[solve]``, which may ask to ``certify`` as well, and an
    ``order`` overrides that of the file. Figures are
    as wide as so many ``columns`` of a page; 0 for none.
    """
    stated = read_table(path)
    problem = load_problem(path, order, says=voice == "text")
    name, options = solve_options(path, formulation, options)
    plan = planned(problem, name, options, certify=certify or stated.solve.certify)
    series = Series(problem, most=max(2, SERIES_NODES // DisplacementSpace.of(problem).n_nodes))
    folder = Path("results") / safe_name(problem.name) if out is None else out
    with writable(folder, (*FILES, SERIES, *([FIGURES] if columns else []))) as results:
        with SolvesProgress(1, quiet=voice != "text") as progress:
            # then the iterates are on different meshes
            several = options.keys() & {"starts", "remesh"}
            done = _performed(plan, progress, None if several else series)
        if done.row["status"] == "refused":
            raise BadInputError(f"{path}: {done.row['message']}")
        with deferred() as interrupted:
            _write(results, done, series, path, stated)
        try:
            if interrupted():
                raise KeyboardInterrupt
            if columns and done.solution is not None and done.row["status"] != INTERRUPTED:
                reporting = load("cli.reporting")  # matplotlib and pandas: as long as a small solve
                reporting.draw_solution(results, done.solution, reporting.Page(columns))
        except KeyboardInterrupt:
            raise InterruptedSolveError(
                f"all but the figures is kept in {folder}; rmesh figures {folder} draws them"
            ) from None
        names = [name for name in (*FILES, "iterations", "figures") if (folder / name).exists()]
    if voice == "json":
        print(to_json(done.row))
    elif voice == "text":
        if done.solution is None:
            print(f"{plan.name} {plan.formulation}: {done.row['status']}: {done.row['message']}")
        else:
            Console().print(done.solution)
            for warning in done.row.get("warnings") or []:
                print(f"warning: {warning}")
            _say_certificate(done)
        print(f"wrote {folder}: {', '.join(names)}")
    return _exit_code(done.row, folder)


def _performed(plan: PlannedSolve, progress: SolvesProgress, series: Series | None = None) -> Done:
    """A solve with its progress shown, and its iterates noted."""

    def watch(step: Step) -> None:
        progress.step(step)
        if series is not None:
            series(step)

    progress.start(plan)
    try:
        return perform(plan, watch)
    except KeyboardInterrupt:
        raise InterruptedSolveError("nothing was written") from None


def _write(results: Results, done: Done, series: Series, path: Path, stated: ProblemTable) -> None:
    """Put the files of a solve in place, the result first; what an earlier solve left goes before."""
    folder, solution, manifest = results.folder, done.solution, results.manifest
    manifest.remove(name for name in manifest.names() if name.startswith(("iterations/", "figures/")))
    manifest.claim(*FILES, *kept_problem.names(stated))
    kept_problem.keep(path, stated, folder)
    write_single(folder, done.row, done.save)
    if solution is not None:
        write_whole(folder / "mesh.msh", lambda aside: write_mesh(solution.mesh, aside))
        if series.frames:
            manifest.claim(*(f"iterations/{name}" for name in series.names()))
            series.write(folder / "iterations", pressure=np.asarray(solution.pressure))


def _say_certificate(done: Done) -> None:
    """Print what a certificate says of the error, or why there is none."""
    certificate = None if done.solution is None else done.solution.certificate
    if certificate is not None:
        print(
            f"{certificate.sentence}; least energy between "
            f"{certificate.lower:.7g} and {certificate.upper:.7g}"
        )
    if remark := done.row.get("certificate_remark"):
        print(f"note: {remark}")


def _exit_code(row: Record, folder: Path) -> int:
    """0 if the solve succeeded; InterruptedSolveError if it was interrupted."""
    if row["status"] == INTERRUPTED:
        raise InterruptedSolveError(f"the best mesh so far is kept in {folder}")
    return SUCCESS if row["success"] else NO_SUCCESS


def compare(
    examples: Sequence[str],
    formulations: Sequence[str],
    given: Mapping[str, Any],
    out: Path,
    resume: bool,
    jobs: int = 1,
    voice: str = "text",
    figures: bool = True,
    verbose: bool = False,
) -> int:
    """Many solves by so many ``jobs``, tables and figures; returns the exit code.

    ``given`` are keywords of :func:`rmesh_nlp.study.comparison.plan_comparison`; ``verbose`` prints the whole
    of ``table.md`` instead of its main table.
    """
    if jobs > 1 and any(name.endswith(comparison.SUFFIX) for name in examples):
        raise BadInputError("--jobs is for the examples: put problem files into a study (rmesh new --study)")
    if jobs > 1 and given.get("repeats", 1) > 1:
        raise BadInputError("--repeats is for times, which solves side by side would spoil: leave out --jobs")
    plan = comparison.plan_comparison(examples or list(EXAMPLES), formulations, **given)
    rows: list[Record] = []
    with writable(out, (RECORDS, *TABLES, *([FIGURES] if figures else []))) as results:
        with SolvesProgress(len(plan), quiet=voice != "text") as progress:
            watched: dict[str, Any] = {"on_start": progress.start, "on_step": progress.step}
            solved = comparison.run(plan, results, resume=resume, locked=True, jobs=jobs, **watched)
            try:
                with notes(DamagedRecordsWarning, "rmesh: warning"):
                    for row in solved:
                        rows.append(row)
                        progress.finish(row)
            except KeyboardInterrupt:
                whole = sum(row["status"] != INTERRUPTED for row in rows)
                kept = f"{whole} of {len(plan)} solves are kept in {out}"
                hint = "--resume goes on, rmesh table and rmesh figures show them"
                raise InterruptedSolveError(f"{kept}; {hint}") from None
        reporting = load("cli.reporting")
        reporting.table(out, voice, verbose)
        if figures:
            reporting.draw_study(out, voice)
    if voice == "json":
        print(f"[{', '.join(to_json(row) for row in rows)}]")
    asked = [row for row in rows if not does_not_apply(row)]
    return SUCCESS if asked and all(row["success"] for row in asked) else NO_SUCCESS


def does_not_apply(row: Record) -> bool:
    """Whether a formulation refused an objective that is not the energy: a dash in the table, no failure."""
    return bool(row["status"] == "refused" and row["objective"] != "energy")
