"""Write the entries of records into docs/records.md by their declarations."""

from __future__ import annotations

from pathlib import Path

from rmesh_nlp.solving.entries import SECTIONS
from rmesh_nlp.solving.entry import Entry

PAGE = Path(__file__).parent.parent / "docs" / "records.md"
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


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))
    print(f"wrote {PAGE.name}")
