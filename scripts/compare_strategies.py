"""Compare strategies on refined grids: the starting point of a study of one's own.

For each size the boxes shrink with the mesh width, so that a node may move by the same part of
its neighbourhood. Run it twice: the second time only what is missing is solved.

    python scripts/compare_strategies.py 6.1 --sizes 8 16 32 --formulations nested joint --out study
    python scripts/make_tables.py study
    python scripts/make_figures.py study
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.campaign import run as campaign
from rmesh_nlp.campaign.cases import make_cases
from rmesh_nlp.campaign.progress import CampaignProgress
from rmesh_nlp.cli.inputs import parse_size
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import Record, Results
from rmesh_nlp.report.tables import short_markdown, write_tables


def compare(example: str, sizes: Sequence[str], formulations: Sequence[str], out: Path) -> list[Record]:
    """Solve one example on every grid by every strategy; returns the records."""
    cases = [case for size in sizes for case in make_cases([example], formulations, n=parse_size(size))]
    with CampaignProgress(len(cases)) as progress:
        rows = campaign.run(
            cases,
            Results(out),
            resume=True,
            on_start=progress.start,
            on_step=progress.step,
        )
        records = []
        for record in rows:
            progress.finish(record)
            records.append(record)
    return records


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the command line, solve, write the tables; 0 if every solve succeeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("example", nargs="?", default="6.1")
    parser.add_argument("--sizes", nargs="+", default=["8", "16"], metavar="SIZE")
    parser.add_argument("--formulations", nargs="+", default=["fixed", "nested", "joint"], metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("study"))
    options = parser.parse_args(arguments)
    try:
        records = compare(options.example, options.sizes, options.formulations, options.out)
    except BadInputError as error:
        parser.error(str(error))
    write_tables(records, options.out)
    print(short_markdown(records), end="")
    return 0 if all(record["success"] for record in records) else 1


if __name__ == "__main__":
    raise SystemExit(main())
