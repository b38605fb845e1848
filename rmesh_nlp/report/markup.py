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


COLUMN = 240.0
"""Points of the width of one of two columns of a printed page."""

DIGIT = 4.3
"""Points of a digit in footnote size."""

GAP = 5.0
"""Points between two columns of a table."""


def latex_table(
    head: Sequence[str], groups: Sequence[tuple[str, Rows]], caption: str, notes: Sequence[str] = ()
) -> str:
    r"""A ``table`` with booktabs rules that fits a column; each group has a title over its rows.

    A table that is too wide is split into several below each other, each with the first column.
    Notes stand below as ``tablenotes`` of ``threeparttable``, no wider than the table.

    ``head`` and ``caption`` are LaTeX already, titles, cells and notes are plain text.
    """
    lines = [
        r"\begin{table}[htbp]",
        r"\centering\footnotesize\setlength{\tabcolsep}{2.5pt}",
        r"\begin{threeparttable}",
        rf"\caption{{{caption}}}",
    ]
    for number, columns in enumerate(split_columns(head, groups)):
        lines += [r"", r"\medskip"] if number else []
        lines += _tabular(head, groups, columns)
    if notes:
        # a hyphen before a number is a minus sign
        items = [re.sub(r"(?<![\w.])-(?=\d)", "$-$", rf"\item {latex_text(note)}") for note in notes]
        lines += [r"\begin{tablenotes}\scriptsize", *items, r"\end{tablenotes}"]
    return "\n".join([*lines, r"\end{threeparttable}", r"\end{table}"]) + "\n"


def split_columns(head: Sequence[str], groups: Sequence[tuple[str, Rows]]) -> list[list[int]]:
    """Numbers of the columns of each part that fits ``COLUMN``; the first column is in all."""
    widths = [
        DIGIT * max(_letters(head[i]), *(len(row[i]) for _, rows in groups for row in rows), 1) + GAP
        for i in range(len(head))
    ]
    parts: list[list[int]] = [[0]]
    for i in range(1, len(head)):
        if sum(widths[k] for k in parts[-1]) + widths[i] > COLUMN and len(parts[-1]) > 1:
            parts.append([0])
        parts[-1].append(i)
    return parts


def _letters(head: str) -> int:
    """Letters of the longest line of a heading."""
    lines = re.sub(r"\\shortstack\[r\]|\\(?!\\)\w+|[{}$]", "", head).split(r"\\")
    return max(len(line.strip()) for line in lines)


def _tabular(head: Sequence[str], groups: Sequence[tuple[str, Rows]], columns: Sequence[int]) -> list[str]:
    lines = [
        rf"\begin{{tabular}}{{@{{}}l{'r' * (len(columns) - 1)}@{{}}}}",
        r"\toprule",
        " & ".join(head[i] for i in columns) + r" \\",
    ]
    for title, rows in groups:
        span = rf"\multicolumn{{{len(columns)}}}{{@{{}}l}}"
        lines += [r"\midrule", rf"{span}{{\emph{{{latex_title(title)}}}}} \\"]
        lines += [" & ".join(latex_cell(row[i]) for i in columns) + r" \\" for row in rows]
    return [*lines, r"\bottomrule", r"\end{tabular}"]


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
