"""What ``rmesh study`` does."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.cli import Exit
from rmesh_nlp.cli.folders import writable
from rmesh_nlp.errors import InterruptedSolveError
from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.results import ROWS, SOLUTIONS, read_rows
from rmesh_nlp.study import engine
from rmesh_nlp.study.plan import PlannedSolve, make_plan, seconds_of_plan
from rmesh_nlp.study.progress import SolvesProgress, in_words
from rmesh_nlp.study.study_file import read_study

STUDY_FILE = "study.toml"

DETAILS = ("family", "size", "variant", "formulation", "options", "repeat")


def study(
    path: Path, out: Path, jobs: int, scheduler: str | None, retry_failed: bool, voice: str = "text"
) -> int:
    """Perform a study; returns the exit code. What is printed is "text", "json" (the counts) or "quiet"."""
    plan = make_plan(read_study(path), path)
    with writable(out, (STUDY_FILE, f"{ROWS}/records", f"{SOLUTIONS}/x")) as manifest:
        manifest.claim(STUDY_FILE)
        if path.resolve() != (out / STUDY_FILE).resolve():
            write_whole(out / STUDY_FILE, lambda aside: shutil.copyfile(path, aside))
        done = len(plan) - len(engine.missing(plan, out))
        with SolvesProgress(len(plan), done, quiet=voice != "text", each=False) as progress:
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
    if voice == "json":
        counts = {"planned": len(plan), "rows": len(ours), "succeeded": good, "refused": refused}
        print(json.dumps({"folder": str(out), **counts, "failed": len(ours) - good - refused}))
    elif voice == "text":
        print(f"{len(ours)} solves in {out}: {good} succeeded, {refused} refused, next: rmesh table {out}")
    return Exit.SUCCESS if good + refused == len(ours) and good else Exit.NO_SUCCESS


def dry_run(path: Path, out: Path, jobs: int, voice: str) -> None:
    """Print what a study would do, as JSON with its keys or in short."""
    stated = read_study(path)
    plan = make_plan(stated, path)
    todo = engine.missing(plan, out)
    if voice == "json":
        content = {
            "study": stated.name or path.stem,
            "solves": [solve.key for solve in plan],
            "missing": [solve.key for solve in todo],
            "details": [
                {"key": solve.key, "problem": solve.name, **{name: getattr(solve, name) for name in DETAILS}}
                for solve in plan
            ],
            "guess_s": seconds_of_plan(todo, read_rows(out)) / jobs,
        }
        print(json.dumps(content))
    else:
        print_plan(plan, todo, jobs, out)


def check(path: Path) -> None:
    """Validate a study file and print its plan in short."""
    stated = read_study(path)
    plan = make_plan(stated, path)
    print(f"{path}: study {stated.name or path.stem!r} is in order")
    print_plan(plan, plan, 1)


def print_plan(
    plan: Sequence[PlannedSolve], todo: Sequence[PlannedSolve], jobs: int, out: Path | None = None
) -> None:
    """Print how many solves there are, how many are to be done, and about how long they take."""
    names = list(dict.fromkeys(solve.variant for solve in plan))
    problems = len({json.dumps(solve.problem, sort_keys=True) for solve in plan})
    print(f"{len(plan)} solves: {problems} problems, formulations {', '.join(names)}")
    for name in names:
        print(f"  {name}: {sum(solve.variant == name for solve in plan)} solves")
    if len(todo) < len(plan):
        print(f"{len(plan) - len(todo)} of them have a row in {out}")
    rows = [] if out is None else read_rows(out)
    said = "about, by the rows there" if rows else "at most, by its limits"
    seconds = seconds_of_plan(todo, rows) / jobs
    print(f"time {said}: {in_words(seconds)} with {jobs} process{'es' * (jobs > 1)}")
