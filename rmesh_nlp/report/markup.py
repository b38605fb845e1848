"""Cells to Markdown and to LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence

Rows = Sequence[Sequence[str]]

_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?")
_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_SPECIAL |= {character: "\\" + character for character in "&%$#_{}"}


def markdown_table(head: Sequence[str], rows: Rows) -> str:
    """A Markdown table with its columns padded, the first to the left, the others to the right."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (head, *rows)]
    widths = [max(3, *(len(row[i]) for row in cells)) for i in range(len(head))]
    lines = [
        "| "
        + " | ".join(_pad(cell, width, i) for i, (cell, width) in enumerate(zip(row, widths, strict=True)))
        + " |"
        for row in cells
    ]
    rule = (
        "|"
        + "|".join(":" + "-" * (w + 1) if i == 0 else "-" * (w + 1) + ":" for i, w in enumerate(widths))
        + "|"
    )
    return "\n".join([lines[0], rule, *lines[1:]]) + "\n"


def latex_table(head: Sequence[str], groups: Sequence[tuple[str, Rows]], caption: str) -> str:
    r"""A ``table`` with booktabs rules; each group has a title over its rows.

    ``head`` and ``caption`` are LaTeX already, titles and cells are plain text.
    """
    columns = len(head)
    lines = [
        r"\begin{table}[htbp]",
        r"\centering\footnotesize\setlength{\tabcolsep}{2.5pt}",
        rf"\caption{{{caption}}}",
        rf"\begin{{tabular}}{{@{{}}l{'r' * (columns - 1)}@{{}}}}",
        r"\toprule",
        " & ".join(head) + r" \\",
    ]
    for title, rows in groups:
        lines += [r"\midrule", rf"\multicolumn{{{columns}}}{{@{{}}l}}{{\emph{{{latex_title(title)}}}}} \\"]
        lines += [" & ".join(latex_cell(cell) for cell in row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"]) + "\n"


def latex_list(notes: Sequence[str]) -> str:
    """Notes as an itemized list in small type."""
    # a hyphen before a number is a minus sign
    items = [re.sub(r"(?<![\w.])-(?=\d)", "$-$", rf"  \item {latex_text(note)}") for note in notes]
    return "\n".join([r"{\footnotesize", r"\begin{itemize}", *items, r"\end{itemize}", r"}"]) + "\n"


def latex_cell(text: str) -> str:
    """A cell; numbers become formulas, so that minus signs and exponents are set as such."""
    if text == "-":
        return "--"
    if not _NUMBER.fullmatch(text):
        return latex_text(text)
    mantissa, _, exponent = text.lower().partition("e")
    return f"${mantissa}$" if not exponent else rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"


def latex_title(title: str) -> str:
    """Settings in words, their symbols as formulas."""
    text = re.sub(r"(?<=\d) ?x ?(?=\d)", r" $\\times$ ", latex_text(title))
    return text.replace("n = ", "$n$ = ").replace("delta = ", r"$\delta$ = ")


def latex_text(text: str) -> str:
    """Plain text with LaTeX's special characters escaped."""
    return "".join(_SPECIAL.get(character, character) for character in text)


def _pad(cell: str, width: int, column: int) -> str:
    return cell.ljust(width) if column == 0 else cell.rjust(width)
