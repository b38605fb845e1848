"""Put the table and the picture of a comparison into the README.

rmesh compare
python scripts/update_readme.py results
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- table: begin -->\n", "<!-- table: end -->\n"
PICTURE = "6.1-8-joint-grid.png"


def with_table(readme: str, table: str) -> str:
    """The README with what ``rmesh compare`` prints between the two marks, headings two levels down."""
    before, rest = readme.split(BEGIN)
    after = rest.split(END)[1]
    printed = table.split("\n", 1)[1].strip().replace("## ", "#### ")
    return f"{before}{BEGIN}\n{printed}\n\n{END}{after}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Update README.md and docs/grid.png from a folder of results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout; default: this one")
    options = parser.parse_args(arguments)
    readme = options.root / "README.md"
    readme.write_text(with_table(readme.read_text(), (options.folder / "table.md").read_text()))
    shutil.copyfile(options.folder / "figures" / PICTURE, options.root / "docs" / "grid.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
