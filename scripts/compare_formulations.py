"""Compare formulations on refined grids, with tables and figures: the starting point of a study of one's own.

For each size the move limits shrink with the mesh width, so that a node may move by the same part of its
neighbourhood. Run it twice: the second time only what is missing is solved.

    python scripts/compare_formulations.py 6.1 --sizes 8 16 32 --formulations nested joint --out study

The data frame behind ``table.csv`` is at hand for one's own tables, the fields of each solution for one's own
figures: ``rmesh_nlp.io.vtu.read_vtu(path)``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.cli.options import parse_size
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import Results, read_results
from rmesh_nlp.report.figures import write_figures
from rmesh_nlp.report.tables import frame, write_tables
from rmesh_nlp.study.comparison import plan_comparison, run


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, write tables and figures; 0 if every solve succeeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("example", nargs="?", default="6.1")
    parser.add_argument("--sizes", nargs="+", default=["8", "16"], metavar="SIZE")
    parser.add_argument("--formulations", nargs="+", default=["fixed", "nested", "joint"], metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("study"))
    options = parser.parse_args(arguments)
    try:
        plan = [
            solve
            for size in options.sizes
            for solve in plan_comparison([options.example], options.formulations, n=parse_size(size))
        ]
    except BadInputError as error:
        parser.error(str(error))
    records = list(run(plan, Results(options.out), resume=True))
    write_tables(records, options.out)
    write_figures(read_results(options.out), options.out / "figures")
    table = frame(records)
    table["share of the best gain"] = table["gain"] / table.groupby(["example", "n"])["gain"].transform("max")
    columns = ["example", "n", "formulation", "energy", "iterations", "share of the best gain"]
    print(table[columns].to_string(index=False))
    return 0 if all(record["success"] for record in records) else 1


if __name__ == "__main__":
    raise SystemExit(main())
