"""Put what was measured into the README.

rmesh compare
python scripts/benchmark_scaling.py --large
python scripts/benchmark_peers.py --plate plate_484.msh --collection mpcc_problems.py
python scripts/update_readme.py results --scaling scaling --peers peers
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURE = "6.1-8-joint-grid.png"


def with_block(readme: str, name: str, text: str) -> str:
    """The README with ``text`` between the two marks of that name."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->\n"
    before, rest = readme.split(begin)
    after = rest.split(end)[1]
    return f"{before}{begin}\n{text.strip()}\n\n{end}{after}"


def with_table(readme: str, table: str) -> str:
    """The README with what ``rmesh compare`` prints, headings two levels down."""
    return with_block(readme, "table", table.split("\n", 1)[1].replace("## ", "#### "))


def main(arguments: Sequence[str] | None = None) -> int:
    """Update README.md and the pictures in docs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", help="results of rmesh compare")
    parser.add_argument("--scaling", type=Path, help="folder of benchmark_scaling.py")
    parser.add_argument("--peers", type=Path, help="folder of benchmark_peers.py")
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout; default: this one")
    options = parser.parse_args(arguments)
    path, docs = options.root / "README.md", options.root / "docs"
    readme = path.read_text()
    if options.folder:
        readme = with_table(readme, (options.folder / "table.md").read_text())
        shutil.copyfile(options.folder / "figures" / PICTURE, docs / "grid.png")
    if options.scaling:
        readme = with_block(readme, "scaling", (options.scaling / "scaling.md").read_text())
        shutil.copyfile(options.scaling / "scaling.png", docs / "scaling.png")
    if options.peers:
        readme = with_block(readme, "peers", (options.peers / "peers.md").read_text())
    path.write_text(readme)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
