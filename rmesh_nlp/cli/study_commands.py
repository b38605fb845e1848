"""What ``rmesh study`` and ``rmesh new --study`` do."""

from __future__ import annotations

import json
import shutil
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.cli.commands import read_quietly
from rmesh_nlp.cli.folders import writable
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.io.files import remove_leftovers, safe_name, write_new, write_whole
from rmesh_nlp.io.results import ROWS, SOLUTIONS, read_rows
from rmesh_nlp.report.html_page import REPRODUCTION, write_report, write_reproduction
from rmesh_nlp.report.tables import frame
from rmesh_nlp.study import engine
from rmesh_nlp.study.guess import seconds_of_plan
from rmesh_nlp.study.plan import PlannedSolve, make_plan
from rmesh_nlp.study.reproduction import reproduce as derive
from rmesh_nlp.study.schema import StudyTable
from rmesh_nlp.study.study_file import read_study
from rmesh_nlp.study.study_progress import StudyProgress
from rmesh_nlp.study.template import template

SUCCESS, NO_SUCCESS = 0, 1
STUDY_FILE = "study.toml"


def new(path: Path) -> int:
    """Write the commented template; an existing file is never replaced."""
    try:
        if not path.parent.is_dir():
            raise BadInputError(f"cannot write {path}: there is no folder {str(path.parent)!r}")
        write_new(path, template(safe_name(path.stem), path.name))
    except FileExistsError:
        raise BadInputError(f"{path} exists: choose another name") from None
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror}") from error
    print(f"wrote {path}; next: rmesh study {path} --out {safe_name(path.stem)} --dry-run")
    return SUCCESS


def check(path: Path) -> int:
    """Validate a study file and print its plan in short."""
    table = _read(path)
    plan = make_plan(table, path)
    print(f"{path}: study {table.name or path.stem!r} is in order")
    _print_plan(plan, plan, 1)
    return SUCCESS


def study(
    path: Path,
    out: Path,
    jobs: int,
    scheduler: str | None,
    dry_run: bool,
    as_json: bool,
    quiet: bool,
    retry_failed: bool = False,
) -> int:
    """Perform a study, or say what it would do; returns the exit code."""
    table = _read(path)
    plan = make_plan(table, path)
    if dry_run:
        return _dry_run(table, path, plan, out, jobs, as_json)
    with writable(out, (STUDY_FILE,)) as results:
        results.manifest.check((f"{ROWS}/records", f"{SOLUTIONS}/x"))
        results.manifest.claim(STUDY_FILE)
        if path.resolve() != (out / STUDY_FILE).resolve():
            write_whole(out / STUDY_FILE, lambda aside: shutil.copyfile(path, aside))
        done = len(plan) - len(engine.missing(plan, out))
        with StudyProgress(len(plan), done, quiet=quiet or as_json) as progress:
            try:
                for row in engine.run(plan, out, jobs=jobs, scheduler=scheduler, retry_failed=retry_failed):
                    progress.finish(row)
            except KeyboardInterrupt:
                kept = len(plan) - len(engine.missing(plan, out))
                raise InterruptedSolveError(
                    f"{kept} of {len(plan)} solves are kept in {out}; the same command goes on"
                ) from None
        rows = {row.get("key"): row for row in read_rows(out)}
    ours = [rows[solve.key] for solve in plan]
    good = sum(row["success"] for row in ours)
    refused = sum(row["status"] == "refused" for row in ours)
    if as_json:
        figures = {"planned": len(plan), "rows": len(ours), "succeeded": good, "refused": refused}
        print(json.dumps({"folder": str(out), **figures, "failed": len(ours) - good - refused}))
    elif not quiet:
        print(f"{len(ours)} solves in {out}: {good} succeeded, {refused} refused, next: rmesh table {out}")
    return SUCCESS if good + refused == len(ours) and good else NO_SUCCESS


def _read(path: Path) -> StudyTable:
    """The tables of a study; what is spelled as of old is noted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DeprecationWarning)
        table = read_study(path)
    for warning in caught:
        print(f"note: {warning.message}", file=sys.stderr)
    return table


def report(folder: Path) -> None:
    """Write the page of a folder and say where it is."""
    results = read_quietly(folder)
    remove_leftovers(folder)
    path, question, title = folder / STUDY_FILE, "", ""
    if path.exists():
        table = _read(path)
        question, title = table.question, table.name or ""
    print(f"wrote {write_report(folder, results, question, title)}")


def export(folder: Path, path: Path) -> None:
    """Write the rows of a folder as Parquet."""
    records = [result.record for result in read_quietly(folder)]
    try:
        write_whole(path, lambda aside: frame(records).to_parquet(aside, index=False))
    except ImportError:
        raise BadInputError("--parquet needs pyarrow: pip install 'rmesh-nlp[study]'") from None
    print(f"wrote {path}: {len(records)} rows")


def reproduce(out: Path, quick: bool, quiet: bool) -> int:
    """Derive the statements about the paper again and write their page."""
    with writable(out, REPRODUCTION):
        statements = derive(quick=quick, say=(lambda text: None) if quiet else _note)
        paths = write_reproduction(out, statements, quick)
    if not quiet:
        for one in statements:
            print(f"{one.example}, {one.what}: printed {one.printed}, here {one.ours} {one.verdict}".rstrip())
        print("wrote", ", ".join(map(str, paths)))
    return SUCCESS


def _note(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text:<60}", end="", file=sys.stderr, flush=True)


def _dry_run(
    table: StudyTable, path: Path, plan: Sequence[PlannedSolve], out: Path, jobs: int, as_json: bool
) -> int:
    todo = engine.missing(plan, out)
    if as_json:
        left = {solve.key for solve in todo}
        content = {
            "study": table.name or path.stem,
            "solves": [solve.key for solve in plan],
            "missing": [solve.key for solve in plan if solve.key in left],
            "details": [
                {
                    "key": solve.key,
                    "problem": solve.name,
                    "family": solve.family,
                    "size": solve.size,
                    "variant": solve.variant,
                    "formulation": solve.formulation,
                    "options": solve.options,
                    "repeat": solve.repeat,
                }
                for solve in plan
            ],
            "guess_s": seconds_of_plan(todo, read_rows(out)) / jobs,
        }
        print(json.dumps(content))
    else:
        _print_plan(plan, todo, jobs, out)
    return SUCCESS


def _print_plan(
    plan: Sequence[PlannedSolve], todo: Sequence[PlannedSolve], jobs: int, out: Path | None = None
) -> None:
    names = list(dict.fromkeys(solve.variant for solve in plan))
    problems = len({json.dumps(solve.problem, sort_keys=True) for solve in plan})
    print(f"{len(plan)} solves: {problems} problems, formulations {', '.join(names)}")
    for name in names:
        print(f"  {name}: {sum(solve.variant == name for solve in plan)} solves")
    if len(todo) < len(plan):
        print(f"{len(plan) - len(todo)} of them have a row in {out}")
    seconds = seconds_of_plan(todo, [] if out is None else read_rows(out)) / jobs
    print(f"a rough guess: {_duration(seconds)} with {jobs} process{'es' * (jobs > 1)}", file=sys.stdout)


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
