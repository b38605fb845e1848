"""What the commands of ``rmesh`` do, with everything heavy loaded; see :mod:`rmesh_nlp.cli.app`."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rmesh_nlp.cli.folders import writable
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.io.files import remove_leftovers
from rmesh_nlp.io.manifest import Manifest
from rmesh_nlp.io.records import DamagedRecordsWarning, Record, to_json
from rmesh_nlp.io.results import RECORDS, TABLES, Result, read_results, write_single
from rmesh_nlp.report.figures import write_figures
from rmesh_nlp.report.histories import with_common_costs
from rmesh_nlp.report.tables import markdown, short_markdown, write_tables
from rmesh_nlp.study import comparison as campaign
from rmesh_nlp.study.cases import plan_comparison
from rmesh_nlp.study.parallel import in_parallel
from rmesh_nlp.study.progress import CampaignProgress

SUCCESS, NO_SUCCESS = 0, 1
SINGLE = ("record.json", "solution.vtu", "history.csv")
"""What a single solve writes."""


def solve(
    example: str, formulation: str, settings: Mapping[str, Any], out: Path | None, voice: str = "text"
) -> int:
    """One solve; returns the exit code.

    Parameters
    ----------
    voice : str
        What is printed: "text", "json" (the record) or "quiet".
    """
    (case,) = plan_comparison([example], [formulation], **settings)
    folder = Path("results") / case.key if out is None else out
    with writable(folder, SINGLE) as results, CampaignProgress(1, quiet=voice != "text") as progress:
        progress.start(case)
        try:
            outcome = campaign.solve(case, progress.step)
        except KeyboardInterrupt:
            raise InterruptedSolveError("nothing was written") from None
        if outcome.record["status"] == "refused":
            raise BadInputError(outcome.record["message"])
        results.manifest.claim(*SINGLE)
        write_single(folder, outcome.record, lambda places: campaign.save(outcome, places))
        progress.finish(outcome.record)
    if voice == "text":
        say_certificate(outcome)
        names = [name for name in SINGLE if (folder / name).exists()]
        print("wrote", ", ".join(str(folder / name) for name in names))
    elif voice == "json":
        print(to_json(outcome.record))
    return exit_code([outcome.record], folder)


def exit_code(records: Sequence[Record], folder: Path) -> int:
    """0 if all solves succeeded; Ctrl-C is said to have been one.

    Raises
    ------
    InterruptedSolveError
        If a solve was interrupted.
    """
    if any(record["status"] == campaign.INTERRUPTED for record in records):
        raise InterruptedSolveError(f"the best mesh so far is kept in {folder}")
    return SUCCESS if all(record["success"] for record in records) else NO_SUCCESS


def does_not_apply(record: Record) -> bool:
    """Whether a formulation refused an objective that is not the energy: a dash in the table, no failure."""
    return bool(record["status"] == "refused" and record["objective"] != "energy")


def say_certificate(outcome: campaign.Outcome) -> None:
    """Print what a certificate says of the error, or why there is none."""
    remark = outcome.record.get("certificate_remark")
    if outcome.solution is not None and outcome.solution.certificate is not None:
        found = outcome.solution.certificate
        print(f"{found.sentence}; least energy between {found.lower:.7g} and {found.upper:.7g}")
    if remark:
        print(f"note: {remark}")


def compare(
    examples: Sequence[str],
    formulations: Sequence[str],
    settings: Mapping[str, Any],
    out: Path,
    resume: bool,
    jobs: int = 1,
    voice: str = "text",
    draw: bool = True,
    verbose: bool = False,
) -> int:
    """Many solves, tables and figures; returns the exit code.

    Parameters
    ----------
    jobs : int
        Processes that solve.
    voice : str
        What is printed: "text", "json" (a list of the records) or "quiet".
    draw : bool
        Whether to write figures.
    verbose : bool
        Print the whole of ``table.md`` instead of its main table.
    """
    if jobs > 1 and any(name.endswith(".toml") for name in examples):
        raise BadInputError("--jobs is for the examples: put problem files into a study (rmesh new --study)")
    if jobs > 1 and settings.get("repeats", 1) > 1:
        raise BadInputError("--repeats is for times, which solves side by side would spoil: leave out --jobs")
    cases = plan_comparison(examples or list(EXAMPLES), formulations, **settings, trace=jobs == 1)
    records: list[Record] = []
    with writable(out, (RECORDS, *TABLES)) as results:
        with CampaignProgress(len(cases), quiet=voice != "text") as progress:
            rows = campaign.run(
                cases,
                results,
                resume=resume,
                locked=True,
                on_start=progress.start,
                on_step=progress.step,
                solver=in_parallel(out, settings, jobs) if jobs > 1 else None,
            )
            try:
                with _warnings_as_notes():
                    for record in rows:
                        records.append(record)
                        progress.finish(record)
            except KeyboardInterrupt:
                whole = sum(record["status"] != campaign.INTERRUPTED for record in records)
                kept = f"{whole} of {len(cases)} solves are kept in {out}"
                hint = "--resume goes on, rmesh table and rmesh figures show them"
                raise InterruptedSolveError(f"{kept}; {hint}") from None
        table(out, voice, verbose)
        if draw:
            figures(out, voice)
    if voice == "json":
        print(f"[{', '.join(to_json(record) for record in records)}]")
    asked = [record for record in records if not does_not_apply(record)]
    return SUCCESS if asked and all(record["success"] for record in asked) else NO_SUCCESS


def table(folder: Path, voice: str = "text", verbose: bool = False) -> None:
    """Write the tables of a folder and print the main one, or with ``verbose`` all of them."""
    results = read_quietly(folder)
    remove_leftovers(folder)
    records = with_common_costs(results)
    write_tables(records, folder)
    if voice == "text":
        print(markdown(records) if verbose else short_markdown(records), end="")
        if not verbose:
            print(f"all columns: {folder / 'table.md'}, or --verbose", file=sys.stderr)


def figures(folder: Path, voice: str = "text") -> None:
    """Write the figures of a folder and say where they are."""
    results = read_quietly(folder)
    remove_leftovers(folder)
    paths = write_figures(results, folder / "figures", Manifest(folder))
    if voice == "text":
        print(f"\n{len(paths)} files in {folder / 'figures'}", file=sys.stderr)


def read_quietly(folder: Path) -> list[Result]:
    """The results of a folder; what is passed over is said in one line each."""
    with _warnings_as_notes():
        return read_results(folder)


@contextmanager
def _warnings_as_notes() -> Iterator[None]:
    """Say what is passed over in one line each, as the command line says everything."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DamagedRecordsWarning)
        try:
            yield
        finally:
            for warning in caught:
                print(f"rmesh: warning: {warning.message}", file=sys.stderr)
