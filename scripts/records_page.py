"""Write the entries of records into docs/records.md, and the meanings of public names into docs/api.md."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from pydoc import locate

from rmesh_nlp.solving.entries import SECTIONS
from rmesh_nlp.solving.entry import Entry

PAGE = Path(__file__).parent.parent / "docs" / "records.md"
NAMES = PAGE.with_name("api.md")
BEGIN, END = "<!-- entries: written by scripts/records_page.py -->\n", "<!-- end of entries -->\n"


def tables() -> str:
    """A table of entries with units and meanings for each section."""
    return "\n".join(f"### {title}\n\n{_table(entries)}" for title, entries in SECTIONS.items())


def _table(entries: tuple[Entry, ...]) -> str:
    rows = (f"| `{entry.name}` | {entry.unit} | {entry.meaning} |\n" for entry in entries)
    return "".join(["| entry | unit | meaning |\n|---|---|---|\n", *rows])


def page(text: str) -> str:
    """The page with its tables as they are declared."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{tables()}\n{END}{rest.split(END)[1]}"


def names(text: str) -> str:
    """The page of public names, each with the summary of its docstring."""
    row = r"^\| `([\w.]+)` \|.*"
    return re.sub(row, lambda found: f"| `{found[1]}` | {_summary(found[1])} |", text, flags=re.M)


def _summary(name: str) -> str:
    text = inspect.getdoc(locate(re.sub(r"^rm\.", "rmesh_nlp.", name))) or ""
    line = " ".join(text.split("\n\n")[0].split()).replace("|", r"\|")
    return re.sub(r"(?::[a-z]+:)?`+~?([^`]+)`+", r"`\1`", line)


WRITTEN = {PAGE: page, NAMES: names}
"""Pages, and what makes their text from the present one."""

if __name__ == "__main__":
    for path, write in WRITTEN.items():
        path.write_text(write(path.read_text()))
        print(f"wrote {path.name}")
