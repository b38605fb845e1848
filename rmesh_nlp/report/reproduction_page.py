"""The page of ``rmesh reproduce``: Markdown, and the same as HTML."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from html import escape
from pathlib import Path

from rmesh_nlp import __version__
from rmesh_nlp.examples.paper import MISPRINT_61
from rmesh_nlp.io.files import write_text
from rmesh_nlp.io.manifest import Manifest
from rmesh_nlp.report.html_page import resource
from rmesh_nlp.report.markup import markdown_table
from rmesh_nlp.study.environment import environment
from rmesh_nlp.study.reproduction import Statement

TITLE = "The paper's figures, printed and computed"
HEAD = ("example", "statement", "printed", "here", "verdict", "evidence")
NAMES = ("reproduction.md", "reproduction.html")

INTRODUCTION = (
    "Haslinger, Neittaanmäki and Salmenjoki, Applications of Mathematics 37 (1992) 105-122, section 6. "
    "The paper truncates its digits. Met: the same to the printed digits. Passed: a lower energy was found, "
    "which a minimisation may. Cannot be met: no descent tried here reaches it, which is evidence, no proof."
)


def rows_of(statements: Sequence[Statement]) -> list[list[str]]:
    """The cells of the table."""
    return [[s.example, s.what, s.printed, s.ours, s.verdict or "-", s.evidence] for s in statements]


def markdown(statements: Sequence[Statement], quick: bool) -> str:
    """The page as Markdown."""
    parts = [f"# {TITLE}\n", f"{INTRODUCTION}\n", markdown_table(HEAD, rows_of(statements))]
    parts.append("".join(f"- {line}\n" for line in _remarks(quick)))
    return "\n".join(parts)


def html(statements: Sequence[Statement], quick: bool) -> str:
    """The page as HTML, self-contained."""
    head = "".join(f'<th class="text">{escape(cell)}</th>' for cell in HEAD)
    lines = []
    for row in rows_of(statements):
        cells = "".join(f'<td class="text">{escape(cell)}</td>' for cell in row)
        lines.append(f"<tr>{cells}</tr>")
    remarks = "".join(f"<li>{escape(line)}</li>" for line in _remarks(quick))
    style = resource("html_page.css") + "\ntd { white-space: normal; min-width: 5em; vertical-align: top; }\n"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(TITLE)}</title><style>{style}</style></head><body><h1>{escape(TITLE)}</h1>"
        f'<p>{escape(INTRODUCTION)}</p><div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div><ul>{remarks}</ul></body></html>\n"
    )


def write_page(folder: Path, statements: Sequence[Statement], quick: bool) -> list[Path]:
    """Write ``reproduction.md`` and ``reproduction.html``; returns their paths."""
    Manifest(folder).claim(*NAMES)
    texts = (markdown(statements, quick), html(statements, quick))
    paths = [folder / name for name in NAMES]
    for path, text in zip(paths, texts, strict=True):
        write_text(path, text)
    return paths


def _remarks(quick: bool) -> list[str]:
    place = environment()
    made = f"Made by rmesh reproduce{' --quick' if quick else ''}, rmesh-nlp {__version__}, CasADi "
    made += f"{place['versions']['casadi']}, {platform.machine()}, {place['blas']}."
    remarks = [f"Example 6.1: {MISPRINT_61}", made]
    chaotic = (
        "Ends of descents depend in their last digits, and sometimes in which minimiser is found, on the "
    )
    remarks.insert(1, chaotic + "processor and its linear algebra.")
    if quick:
        remarks.append("The quick variant takes one random start; the full one takes 40.")
    return remarks
