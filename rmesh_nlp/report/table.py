"""One table: headings, rows of cells, and what Markdown, LaTeX and HTML make of them."""

from __future__ import annotations

import re
from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import zip_longest

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

Rows = Sequence[Sequence[str]]

MISSING = "-"  # what stands for a figure that is not known
COLUMN, PAGE = 229.0, 345.0  # points of a column of the class ``article`` with two columns, and with one
LINES = 34  # most rows of one table, so that it fits a page with its caption and notes
GAP = 5.0  # points between two columns of a table
LABEL = 60.0  # points that the first column keeps at least; longer labels are set in several lines

_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?")
_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_ESCAPED = str.maketrans(_SPECIAL | {character: "\\" + character for character in "&%$#_{}"})
_SYMBOLS = {
    r"\|J\|": "$|J|$",
    r"(?<!\|)\bJ\b(?![-(])": "$J$",
    r"\bI([123])\b": r"$I_\1$",
    r"\bu (min|max)\b": r"$u_{\\\1}$",
    r"\bn = ": "$n$ = ",
    r"\bdelta = ": r"$\\delta$ = ",
    r"(?<=\d) ?x ?(?=\d)": r" $\\times$ ",
    r"(?<![\w.])-(?=\d)": "$-$",
}
"""Symbols and signs in words, and how LaTeX sets them."""


@dataclass(frozen=True)
class Table:
    """A table of plain text.

    Attributes
    ----------
    head : sequence of str
        Headings, whose lines are separated by a bar.
    rows : sequence of sequences of str
        Cells, one for each heading.
    caption : str
        What it shows and how to read it.
    title : str
        Its heading in Markdown; empty for none.
    is_detail : bool
        Whether it is in ``table.md`` alone, and not among what is printed.
    texts : int
        How many columns from the first on are texts, in HTML.
    failed : set of int
        Numbers of the rows that HTML marks.
    """

    head: Sequence[str]
    rows: Rows
    caption: str = ""
    title: str = ""
    is_detail: bool = False
    texts: int = 1
    failed: Set[int] = frozenset()

    @property
    def headings(self) -> list[str]:
        """Each on one line."""
        return [text.replace("|", " ") for text in self.head]

    def markdown(self, width: int = 0) -> str:
        """All rows below each other, columns padded, the first to the left, the others to the right.

        Columns that do not fit the ``width`` of a screen follow below, beside the first one again.
        """
        heads = [text.split("|") for text in self.head] if width else [[text] for text in self.headings]
        above = [*zip_longest(*heads, fillvalue="")]
        cells = [[cell.replace("|", "\\|") for cell in row] for row in (*above, *self.rows)]
        widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
        parts = [[0]]
        for place in range(1, len(widths)):
            used = sum(widths[i] + 3 for i in (*parts[-1], place)) + 1
            if width and used > width and len(parts[-1]) > 1:
                parts.append([0])
            parts[-1].append(place)
        texts = []
        for part in parts:
            lines = [" | ".join(f"{row[i]:{'>' if i else '<'}{widths[i]}}" for i in part) for row in cells]
            marks = ["-" * widths[i] + "-:|" for i in part[1:]]
            ruled = [f"| {line} |" for line in lines]
            ruled.insert(len(above), f"|:{'-' * widths[0]}-|{''.join(marks)}")
            texts.append("\n".join([*ruled, ""]))
        return "\n".join(texts)

    def section(self, width: int = 0) -> str:
        """Markdown with the title and the caption."""
        heading = [f"## {self.title}\n"] if self.title else []
        caption = [f"{self.caption}\n"] if self.caption else []
        return "\n".join([*heading, self.markdown(width), *caption])

    def latex(self, notes: Sequence[str] = ()) -> str:
        r"""Tables with booktabs rules, as wide as a column of the page if they fit, else as the text.

        A ``table`` becomes a ``table*`` if its columns need more than ``COLUMN``; where pages have one column
        the two are the same. A table of more than ``LINES`` lines is continued in a second one.
        """
        columns = [*zip(self.head, *self.rows, strict=True)]
        widths = [max(map(_width, (*head.split("|"), *cells))) for head, *cells in columns]
        room = PAGE - sum(widths[1:]) - GAP * (len(widths) - 1)
        label = max(LABEL, room)
        whole = min(widths[0], label) + PAGE - room
        return LATEX.get_template("table.tex").render(
            table=self,
            notes=notes,
            parts=[self.rows[first : first + LINES] for first in range(0, len(self.rows), LINES)],
            place="table" if whole <= COLUMN else "table*",
            size="footnotesize" if whole <= PAGE else "scriptsize",
            gap=GAP,
            first=label,  # longer labels are set in several lines
        )


def _width(text: str) -> float:
    """Points of a cell in footnote size, estimated from above."""
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        return 4.4 * len(text)
    mantissa, _, exponent = text.lower().partition("e")
    return 4.3 * len(mantissa) + 2.4 * text.startswith("-") + (17 + 3.8 * len(exponent) if exponent else 0)


def latex_cell(text: str) -> str:
    """A cell; numbers become formulas, so that minus signs and exponents are set as such."""
    if text == MISSING:
        return "--"
    if not _NUMBER.fullmatch(text):
        return latex_text(text)
    mantissa, _, exponent = text.lower().partition("e")
    return f"${mantissa}$" if not exponent else rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"


def latex_words(text: str) -> str:
    """Plain text whose symbols and minus signs are set as such."""
    text = latex_text(text)
    for symbol, formula in _SYMBOLS.items():
        text = re.sub(symbol, formula, text)
    return text


def latex_text(text: str) -> str:
    """Plain text with LaTeX's special characters escaped."""
    return text.translate(_ESCAPED)


TEMPLATES = Environment(
    loader=PackageLoader("rmesh_nlp.report", ""),
    autoescape=select_autoescape(),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
LATEX = TEMPLATES.overlay(
    block_start_string="<%",
    block_end_string="%>",
    variable_start_string="<<",
    variable_end_string=">>",
    comment_start_string="<#",
    comment_end_string="#>",
)
LATEX.filters |= {"words": latex_words, "cell": latex_cell, "width": _width}
"""Templates in which braces and per cent signs are those of LaTeX."""
