"""Figures from the solutions of a folder.

    python scripts/make_figures.py results
    python scripts/make_figures.py results --out paper/figures

For a figure of one's own take the fields of a solution: ``rmesh_nlp.io.vtu.read_vtu(path)``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import read_results
from rmesh_nlp.report.figures import write_figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Write all figures as PNG and PDF and print their names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="default: FOLDER/figures")
    options = parser.parse_args(arguments)
    try:
        paths = write_figures(read_results(options.folder), options.out or options.folder / "figures")
    except BadInputError as error:
        parser.error(str(error))
    print("\n".join(map(str, paths)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
