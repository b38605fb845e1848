"""What ``rmesh table``, ``figures``, ``report``, ``export`` and ``reproduce`` do."""

from __future__ import annotations

import sys
from pathlib import Path
from shutil import get_terminal_size

from rmesh_nlp.cli.folders import check_target, read_quietly, writable
from rmesh_nlp.cli.study import STUDY_FILE
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import Manifest, write_whole
from rmesh_nlp.io.problem_file import KEPT
from rmesh_nlp.io.results import RECORD
from rmesh_nlp.report.figures import figures as drawn
from rmesh_nlp.report.histories import with_common_costs
from rmesh_nlp.report.html_page import REPRODUCTION, write_report, write_reproduction
from rmesh_nlp.report.pictures import pictures
from rmesh_nlp.report.study_summary import is_study
from rmesh_nlp.report.style import Page, write
from rmesh_nlp.report.tables import frame, markdown, write_tables
from rmesh_nlp.study.reproduction import reproduce as derive
from rmesh_nlp.study.study_file import read_study

UNSOLVED = "no solve has a solution"
UNRANKED = "those of a study compare formulations that relocate, at least two"


def table(folder: Path, voice: str = "text", verbose: bool = False) -> None:
    """Write the tables of a folder and print the main columns, or with ``verbose`` all, to fit the screen."""
    results = read_quietly(folder)
    records = with_common_costs(results)
    write_tables(records, folder)
    if voice == "text":
        width = get_terminal_size((0, 0)).columns  # 0 in a file
        print(markdown(records, short=not verbose, width=width), end="")
        if not verbose:
            print(f"all columns: {folder / 'table.md'}, or --verbose", file=sys.stderr)


def figures(folder: Path, page: Page) -> None:
    """Draw what is in a folder again; of a problem file before and after."""
    if (folder / KEPT).exists() and (folder / RECORD).exists():
        with writable(folder):
            paths = draw_solve(folder, page)
        print(_made(paths, folder, UNSOLVED))
    else:
        draw_study(folder, page)


def draw_study(folder: Path, page: Page, voice: str = "text") -> None:
    """Write the figures of a folder and print where they are."""
    results = read_quietly(folder)
    paths = write(drawn(results, page), Manifest(folder), page)
    why = UNRANKED if is_study([result.record for result in results]) else UNSOLVED
    if voice == "text":
        print(_made(paths, folder, why), file=sys.stderr)


def _made(paths: list[Path], folder: Path, why: str) -> str:
    """How many figures there are, or why there are none."""
    return f"{len(paths)} files in {folder / 'figures'}" if paths else f"no figures of {folder}: {why}"


def draw_solve(folder: Path, page: Page) -> list[Path]:
    """Draw the one solve of a folder before and after, if it has a solution."""
    (result,) = read_quietly(folder)
    drawn = () if result.record["energy"] is None else pictures(result, page)
    return write(drawn, Manifest(folder), page)


def report(folder: Path) -> None:
    """Write the page of a folder and print where it is."""
    results = read_quietly(folder)
    path, question, title = folder / STUDY_FILE, "", ""
    if path.exists():
        stated = read_study(path)
        question, title = stated.question, stated.name or ""
    print(f"wrote {write_report(folder, results, question, title)}")


def export(folder: Path, path: Path) -> None:
    """Write the rows of a folder as Parquet."""
    check_target(path, ".parquet")
    table = frame([result.record for result in read_quietly(folder)])
    if "quadrature" in table:  # a column of Parquet holds values of one kind
        table["quadrature"] = table["quadrature"].map(str, na_action="ignore")
    try:
        write_whole(path, lambda aside: table.to_parquet(aside, index=False))
    except ImportError:
        raise BadInputError("--parquet needs pyarrow: pip install 'rmesh-nlp[study]'") from None
    print(f"wrote {path}: {len(table)} rows")


def reproduce(out: Path, quick: bool, quiet: bool) -> None:
    """Derive the statements about the paper again and write their page."""

    def say(text: str) -> None:
        if not quiet and sys.stderr.isatty():
            print(f"\r{text:<60}", end="", file=sys.stderr, flush=True)

    with writable(out, REPRODUCTION):
        statements = derive(quick=quick, say=say)
        paths = write_reproduction(out, statements, quick)
    if not quiet:
        for row in statements:
            print(f"{row.example}, {row.what}: printed {row.printed}, here {row.ours} {row.outcome}".rstrip())
        print("wrote", ", ".join(map(str, paths)))
