"""What ``rmesh solve`` and ``rmesh compare`` do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from rmesh_nlp.cli import Exit, load
from rmesh_nlp.cli.folders import notes, writable
from rmesh_nlp.cli.preparing import load_problem, solve_options
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.export import Series, write_mesh
from rmesh_nlp.io.folder import Manifest, safe_name, write_text, write_whole
from rmesh_nlp.io.problem_file import keep, kept_files, read_table
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.io.records import DamagedRecordsWarning, Record, to_json
from rmesh_nlp.io.results import RECORD, RECORDS, SINGLE, TABLES, Results, single_result
from rmesh_nlp.optimize.budget import deferred
from rmesh_nlp.settings import ByName, Values
from rmesh_nlp.solving.formulation import ACCURACY
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.summary import contact_rows, mesh_table, step_table
from rmesh_nlp.study import comparison
from rmesh_nlp.study.plan import PlannedSolve, planned
from rmesh_nlp.study.progress import SolvesProgress
from rmesh_nlp.study.runner import INTERRUPTED, Done, perform

FILES = (*SINGLE, "mesh.msh")  # of a problem file, the series of its iterates and the figures aside
SERIES, FIGURES = "iterations/x", "figures/x"  # one of the files of a folder, to check that it may be written
SERIES_NODES = 200_000  # of all frames of a series: with more, writing them takes longer than the solve


def solve(
    name: str,
    formulation: str | None,
    given: ByName,
    out: Path | None,
    voice: str = "text",
    columns: int = 2,
) -> int:
    """Solve an example, or the problem of a file; returns the exit code.

    ``given`` are keywords of :func:`rmesh_nlp.study.comparison.plan_comparison`. They override ``[solve]`` of
    a file, which may ask to ``certify`` as well. What is printed is "text", "json" (the record) or "quiet".
    Figures, of a file alone, are as wide as so many ``columns`` of a page; 0 for none.
    """
    says, stated, series = voice == "text", None, None
    if name.endswith(comparison.SUFFIX):
        comparison.refuse_changes(given, name)
        stated = read_table(name)
        plan, series = _of_file(stated, formulation, given, says)
    else:
        (plan,) = comparison.plan_comparison([name], [formulation or "auto"], **given)
    folder = Path("results") / (plan.key if stated is None else safe_name(plan.name)) if out is None else out
    kept = {} if stated is None else kept_files(stated)
    with writable(folder, (*FILES, *kept, SERIES, *[FIGURES][:columns]) if kept else SINGLE) as manifest:
        with SolvesProgress(1, quiet=not says) as progress:
            done = _performed(plan, progress, series)
            if done.row["status"] == "refused":
                raise BadInputError(f"{'' if stated is None else f'{name}: '}{done.row['message']}")
            progress.finish(done.row)
        with deferred() as interrupted:
            _write(manifest, done, series, kept)
        try:
            if interrupted():
                raise KeyboardInterrupt
            if stated and columns and done.solution is not None and done.row["status"] != INTERRUPTED:
                reporting = load("cli.reporting")  # matplotlib and pandas: as long as a small solve
                reporting.draw_solve(folder, reporting.Page(columns))
        except KeyboardInterrupt:
            raise InterruptedSolveError(
                f"all but the figures is kept in {folder}; rmesh figures {folder} draws them"
            ) from None
    if voice == "json":
        print(to_json(done.row))
    elif says:
        _say(done, in_full=stated is not None)
        own = (name for name in manifest.names() if (folder / name).exists())
        names = dict.fromkeys(name.split("/")[0] for name in own)
        print(f"wrote {folder}: {', '.join(names)}")
    if done.row["status"] == INTERRUPTED:
        raise InterruptedSolveError(f"the best mesh so far is kept in {folder}")
    return Exit.SUCCESS if done.row["success"] else Exit.NO_SUCCESS


def _of_file(
    stated: ProblemTable, formulation: str | None, given: ByName, says: bool
) -> tuple[PlannedSolve, Series | None]:
    """The solve of a problem file, and what notes its iterates unless they are on different meshes."""
    path = stated.source.path
    problem = load_problem(path, given.get("order"), says=says)
    name, options = solve_options(path, formulation, given["options"])
    adapts = name == "adaptive" or options.keys() & set(ACCURACY)
    if adapts and ("order" in stated.model_fields_set or "order" in given):
        options["own_order"] = True
    plan = planned(problem, name, options, certify=given.get("certify", stated.solve.certify))
    if adapts or options.keys() & {"starts", "remesh"}:
        return plan, None
    return plan, Series(problem, most=max(2, SERIES_NODES // DisplacementSpace(problem).n_nodes))


def _performed(plan: PlannedSolve, progress: SolvesProgress, series: Series | None) -> Done:
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


def _write(manifest: Manifest, done: Done, series: Series | None, kept: Mapping[str, Path]) -> None:
    """Put the files of a solve in place, the result first; what an earlier solve left goes before.

    Of a problem file copies are ``kept``, and the relocated mesh and the iterates are written as well. A
    comparison is set aside.
    """
    folder, solution = manifest.folder, done.solution
    older = manifest.names()
    if RECORDS in older:
        manifest.set_aside()
    manifest.claim(*(FILES if kept else SINGLE), *kept)
    keep(kept, folder)  # its mesh may be one that an earlier solve left
    manifest.remove(name for name in older if name not in kept)
    write_text(folder / RECORD, to_json(done.row, indent=2) + "\n")  # small, if the disk is full it fits
    done.save(single_result(folder, done.row))
    if solution is not None and kept:
        write_whole(folder / "mesh.msh", lambda aside: write_mesh(solution.mesh, aside))
    if solution is not None and series is not None and series.frames:
        manifest.claim(*(f"iterations/{name}" for name in series.names()))
        series.write(folder / "iterations")


def _say(done: Done, *, in_full: bool) -> None:
    """Print a solution, in full or what contact carries, and what a certificate says of its error."""
    if (solution := done.solution) is None:
        return
    if in_full:
        print(solution)
    else:
        for what, value in contact_rows(solution):
            print(f"{what} {value}")
    for name, table in (("meshes", mesh_table), ("steps", step_table)):
        if rows := solution.details.get(name):
            Console().print(table(rows))
    for warning in solution.warnings:
        print(f"warning: {warning}")
    if (certificate := solution.certificate) is not None:
        print(
            f"{certificate.sentence}; least energy between "
            f"{certificate.lower:.7g} and {certificate.upper:.7g}"
        )
        for sentence in certificate.sentences:
            print(sentence)
    for remark in filter(None, (solution.safe, done.row.get("certificate_remark"))):
        print(f"note: {remark}")


def compare(
    examples: Sequence[str],
    formulations: Sequence[str],
    given: ByName,
    out: Path,
    resume: bool,
    jobs: int = 1,
    voice: str = "text",
    figures: bool = True,
    verbose: bool = False,
) -> int:
    """Many solves by so many ``jobs``, tables and figures; returns the exit code.

    ``given`` are keywords of :func:`rmesh_nlp.study.comparison.plan_comparison`; ``verbose`` prints
    all columns of ``table.md`` and not the main ones.
    """
    if jobs > 1 and any(name.endswith(comparison.SUFFIX) for name in examples):
        raise BadInputError("--jobs is for the examples: put problem files into a study (rmesh new --study)")
    if jobs > 1 and given.get("repeats", 1) > 1:
        raise BadInputError("--repeats is for times, which solves side by side would spoil: leave out --jobs")
    plan = comparison.plan_comparison(examples or list(EXAMPLES), formulations, **given)
    rows: list[Record] = []
    with writable(out, (RECORDS, *TABLES, *([FIGURES] if figures else []))):
        with SolvesProgress(len(plan), quiet=voice != "text") as progress:
            watched: Values = {"on_start": progress.start, "on_step": progress.step}
            solved = comparison.run(plan, Results(out), resume=resume, jobs=jobs, **watched)
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
            reporting.draw_study(out, reporting.Page(), voice)
    if voice == "json":
        print(f"[{', '.join(to_json(row) for row in rows)}]")
    asked = [row for row in rows if not does_not_apply(row)]
    good = asked and all(row["success"] for row in asked)
    return Exit.SUCCESS if good else Exit.NO_SUCCESS


def does_not_apply(row: Record) -> bool:
    """Whether a formulation refused an objective that is not the energy: a dash in the table, no failure."""
    return bool(row["status"] == "refused" and row["objective"] != "energy")
