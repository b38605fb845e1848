"""Tables from the records of a folder, with a row per strategy and the paper's values beside ours.

    python scripts/make_tables.py results

The data frame behind ``table.csv`` is at hand for one's own tables:
``rmesh_nlp.report.tables.frame(records)``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import read_results
from rmesh_nlp.report.tables import frame, write_tables


def main(arguments: Sequence[str] | None = None) -> int:
    """Write ``table.md``, ``table.tex``, ``table.csv`` and print a summary of one's own."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(arguments).folder
    try:
        records = [result.record for result in read_results(folder)]
    except BadInputError as error:
        parser.error(str(error))
    write_tables(records, folder)
    table = frame(records)
    table["share of the best gain"] = table["gain"] / table.groupby(["example", "n"])["gain"].transform("max")
    print(table[["example", "n", "formulation", "energy", "share of the best gain"]].to_string(index=False))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
