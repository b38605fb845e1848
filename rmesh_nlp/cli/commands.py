"""What the commands of ``rmesh`` do, with everything heavy loaded; see :mod:`rmesh_nlp.cli.app`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rmesh_nlp.campaign import run as campaign
from rmesh_nlp.campaign.cases import make_cases
from rmesh_nlp.campaign.progress import CampaignProgress
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.io.results import Record, Results, read_results, single_result, to_json, write_text
from rmesh_nlp.report.figures import write_figures
from rmesh_nlp.report.tables import write_tables

SUCCESS, NO_SUCCESS = 0, 1


def solve(example: str, formulation: str, settings: Mapping[str, Any], out: Path | None) -> int:
    """One solve; returns the exit code."""
    (case,) = make_cases([example], [formulation], **settings)
    with (
        _writable(Path("results") / case.key if out is None else out) as folder,
        CampaignProgress(1) as progress,
    ):
        progress.start(case)
        try:
            outcome = campaign.solve(case, progress.step)
        except KeyboardInterrupt:
            raise InterruptedSolveError("nothing was written") from None
        if outcome.record["status"] == "refused":
            raise BadInputError(outcome.record["message"])
        campaign.save(outcome, single_result(folder, outcome.record))
        text = to_json(outcome.record, indent=2) + "\n"
        write_text(folder / "record.json", text)
        progress.finish(outcome.record)
    names = [name for name in ("record.json", "solution.vtu", "history.csv") if (folder / name).exists()]
    print("wrote", ", ".join(str(folder / name) for name in names))
    return SUCCESS if outcome.record["success"] else NO_SUCCESS


def compare(
    examples: Sequence[str],
    formulations: Sequence[str],
    settings: Mapping[str, Any],
    out: Path,
    resume: bool,
) -> int:
    """Many solves, tables and figures; returns the exit code."""
    cases = make_cases(examples or list(EXAMPLES), formulations, **settings)
    records: list[Record] = []
    with _writable(out), CampaignProgress(len(cases)) as progress:
        rows = campaign.run(
            cases,
            Results(out),
            resume=resume,
            on_start=progress.start,
            on_step=progress.step,
        )
        try:
            for record in rows:
                records.append(record)
                progress.finish(record)
        except KeyboardInterrupt:
            kept = f"{len(records)} of {len(cases)} solves are kept in {out}"
            hint = "--resume goes on, rmesh table and rmesh figures show them"
            raise InterruptedSolveError(f"{kept}; {hint}") from None
    table(out)
    figures(out)
    return SUCCESS if all(record["success"] for record in records) else NO_SUCCESS


def table(folder: Path) -> None:
    """Write the tables of a folder and print the Markdown one."""
    results = read_results(folder)
    print(write_tables([result.record for result in results], folder), end="")


def figures(folder: Path) -> None:
    """Write the figures of a folder and say where they are."""
    paths = write_figures(read_results(folder), folder / "figures")
    print(f"\n{len(paths)} files in {folder / 'figures'}", file=sys.stderr)


@contextmanager
def _writable(folder: Path) -> Iterator[Path]:
    """The folder, made if need be before time is spent on solving.

    If what happens in this context fails and leaves it empty, what was made is taken away again.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"cannot write to {str(folder)!r}: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise BadInputError(f"cannot write to {str(folder)!r}: permission denied")
    try:
        yield folder
    except BaseException:
        with suppress(OSError):  # not empty: keep it
            for path in made:
                path.rmdir()
        raise
