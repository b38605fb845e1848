"""Problems and solutions as short tables: in a terminal through rich, in Jupyter as HTML."""

from __future__ import annotations

import math
import shutil
from abc import ABC, abstractmethod
from html import escape
from numbers import Real
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

Rows = list[tuple[str, str]]

Spans = dict[str, list[list[float]]]
"""Intervals of x or y."""


def rich_table(title: str, rows: Rows) -> Table:
    """A two-column table for rich."""
    from rich.table import Table  # these and meshio would take a quarter of the time to import the package
    from rich.text import Text

    table = Table(title=Text(title), show_header=False, title_justify="left")
    for label, value in rows:
        table.add_row(Text(label), Text(value))  # what stands in brackets is no markup
    return table


def plain_table(title: str, rows: Rows) -> str:
    """The same as plain text that fits a screen: one line per row, long values cut."""
    width = max((len(label) for label, _ in rows), default=0)
    screen = shutil.get_terminal_size().columns
    room = screen - width - 4
    lines = [
        f"  {label:<{width}}  {value if len(value) <= room else value[: room - 3] + '...'}"
        for label, value in rows
    ]
    return "\n".join([title[:screen], *lines])


def html_table(title: str, rows: Rows) -> str:
    """The same as HTML, all text escaped."""
    lines = "".join(f"<tr><th>{escape(label)}</th><td>{escape(value)}</td></tr>" for label, value in rows)
    return f"<table><caption>{escape(title)}</caption>{lines}</table>"


class Shown(ABC):
    """What a terminal, ``print`` and Jupyter show as a table."""

    @property
    @abstractmethod
    def title(self) -> str:
        """What it is, for people."""

    @abstractmethod
    def summary(self) -> Rows:
        """(label, value) rows for people."""

    def __rich__(self) -> Table:
        return rich_table(self.title, self.summary())

    def __repr__(self) -> str:
        return plain_table(self.title, self.summary())

    def _repr_html_(self) -> str:
        return html_table(self.title, self.summary())


FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
"""What spreadsheets take for the beginning of a formula."""


def for_spreadsheet(value: object) -> object:
    """A value for a CSV file: a text that a spreadsheet would run as a formula begins with an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def figure(value: float) -> str:
    """A number with six digits."""
    return f"{value:.6g}"


def bounds_in_words(lower: object, upper: object) -> str:
    """Bounds as text, numbers or expressions; one that is infinite, or None, is none."""
    low, high = (
        None if bound is None or (isinstance(bound, Real) and math.isinf(bound)) else describe(bound)
        for bound in (lower, upper)
    )
    if low == high:
        return f"equal to {low}"
    return f"at most {high}" if low is None else f"at least {low}" if high is None else f"{low} to {high}"


def within_in_words(within: Spans | None) -> str:
    """Where nearly all of a force acts."""
    spans = [
        f"{axis} from {bounds_in_words(*ends)}" for axis, each in (within or {}).items() for ends in each
    ]
    return f", at least 95 % of it on {' and '.join(spans)}" if spans else ""


def describe(coefficient: object) -> str:
    """A coefficient as text: its expression if it has one."""
    if callable(coefficient):
        return str(getattr(coefficient, "text", "f(x, y)"))
    if coefficient is None:
        return "free"
    return figure(float(coefficient)) if isinstance(coefficient, Real) else str(coefficient)
