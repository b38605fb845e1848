"""Put what was measured into the README and the pages of docs.

rmesh compare
python scripts/benchmark_scaling.py --large
python scripts/benchmark_peers.py --plate plate_484.msh --collection mpcc_problems.py
python scripts/update_readme.py results --scaling scaling --peers peers
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from rmesh_nlp import read_records
from rmesh_nlp.report.tables import main_table

ROOT = Path(__file__).resolve().parent.parent
PICTURE = "6.1-8-joint-grid.png"


def with_block(page: str, name: str, text: str) -> str:
    """The page with ``text`` between the two marks of that name."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->\n"
    before, rest = page.split(begin)
    after = rest.split(end)[1]
    return f"{before}{begin}\n{text.strip()}\n\n{end}{after}"


def with_table(page: str, table: str) -> str:
    """The page with ``table.md`` below its title."""
    return with_block(page, "table", table.split("\n", 1)[1])


def change(path: Path, edit: Callable[[str], str]) -> None:
    """Edit a text file."""
    path.write_text(edit(path.read_text()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Update README.md, and the pages and pictures in docs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", help="results of rmesh compare")
    parser.add_argument("--scaling", type=Path, help="folder of benchmark_scaling.py")
    parser.add_argument("--peers", type=Path, help="folder of benchmark_peers.py")
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout; default: this one")
    options = parser.parse_args(arguments)
    docs = options.root / "docs"
    if options.folder:
        whole = (options.folder / "table.md").read_text()
        short = main_table(read_records(options.folder))
        change(docs / "results.md", lambda page: with_table(page, whole))
        change(options.root / "README.md", lambda page: with_block(page, "table", short))
        shutil.copyfile(options.folder / "figures" / PICTURE, docs / "grid.png")
    if options.scaling:
        table = (options.scaling / "scaling.md").read_text()
        change(docs / "cost.md", lambda page: with_block(page, "scaling", table))
        shutil.copyfile(options.scaling / "scaling.png", docs / "scaling.png")
    if options.peers:
        peers = (options.peers / "peers.md").read_text()
        change(docs / "cost.md", lambda page: with_block(page, "peers", peers))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
