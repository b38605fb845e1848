"""The commands of studies, and those that make tables, figures and pages of what was solved."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rmesh_nlp.cli import work
from rmesh_nlp.cli.options import Columns, Folder, Jobs, Json, Quiet, Verbose


def study(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A study file.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")],
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="A running dask scheduler: tls://host:8786."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the plan and a guess of its time.")
    ] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Solve again what has a row that is a failure.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Solve every problem of a study by every formulation: many solves, one row each.

    Writes rows to DIR/rows, one file per worker, and fields to DIR/solutions. Run the same command
    again after any end: it goes on where it was. Then rmesh table DIR, figures DIR and report DIR.

    \b
    rmesh new --study study.toml
    rmesh study study.toml --out first --dry-run
    rmesh study study.toml --out first --jobs 2
    rmesh study study.toml --out first --scheduler tls://login1:8786
    rmesh study study.toml --out first --retry-failed
    """
    given = (file, out, jobs, scheduler, dry_run, json, quiet, retry_failed)
    raise typer.Exit(work.study_commands().study(*given))


def table(folder: Folder, verbose: Verbose = False) -> None:
    """Make the tables of DIR again.

    Writes DIR/table.md, DIR/table.tex and DIR/table.csv from the records, without solving, and prints
    the main table.

    \b
    rmesh table results
    rmesh table results --verbose
    """
    work.commands().table(folder, verbose=verbose)


def mpcc(context: typer.Context) -> None:
    """Solve mathematical programs with complementarity constraints from files.

    \b
    rmesh mpcc --help
    rmesh mpcc problem.nl
    """
    raise typer.Exit(work.mpcc_commands().main(context.args))


def report(folder: Folder) -> None:
    """Make one self-contained HTML page of DIR: tables, profiles, convergence, meshes with a slider.

    Writes DIR/report.html, without solving; it needs no network and no server.

    \b
    rmesh report results
    """
    work.study_commands().report(folder)


def reproduce(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")] = Path(
        "reproduction"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="One random start instead of 40.")] = False,
    quiet: Quiet = False,
) -> None:
    """Derive again every statement about the paper's figures: printed value, ours, met or not, and why.

    Writes DIR/reproduction.md and DIR/reproduction.html. Exit code 0 if all statements could be
    examined, also where a printed value cannot be met.

    \b
    rmesh reproduce --out reproduction
    rmesh reproduce --quick --out reproduction
    """
    raise typer.Exit(work.study_commands().reproduce(out, quick, quiet))


def export(
    folder: Folder,
    parquet: Annotated[Path, typer.Option("--parquet", metavar="FILE", help="The Parquet file to write.")],
) -> None:
    """Write the rows of DIR, joined by key, as a Parquet file for pandas, DuckDB or R.

    \b
    rmesh export results --parquet rows.parquet
    """
    work.study_commands().export(folder, parquet)


def figures(folder: Folder, columns: Columns = 2) -> None:
    """Make the figures of DIR again.

    Writes PNG and PDF files to DIR/figures from the saved solutions, without relocating again. Of a
    problem file they are those of rmesh solve, before and after.

    \b
    rmesh figures results
    rmesh figures results/my --columns 1
    """
    raise typer.Exit(work.problem_commands().figures(folder, columns))
