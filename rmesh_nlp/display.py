"""Problems and solutions as short tables: in a terminal as plain text, in Jupyter as HTML."""

from __future__ import annotations

import math
import shutil
from abc import ABC, abstractmethod
from html import escape
from numbers import Real
from textwrap import fill

Rows = list[tuple[str, str]]

Spans = dict[str, list[list[float]]]
"""Intervals of x or y."""


def plain_table(title: str, rows: Rows) -> str:
    """A two-column table as plain text that fits a screen, long values in several lines."""
    width = max((len(label) for label, _ in rows), default=0)
    screen = shutil.get_terminal_size().columns
    indent = " " * (width + 4)
    lines = [fill(f"  {label:<{width}}  {value}", screen, subsequent_indent=indent) for label, value in rows]
    return "\n".join([title, *lines])


def html_table(title: str, rows: Rows) -> str:
    """The same as HTML, all text escaped."""
    lines = "".join(f"<tr><th>{escape(label)}</th><td>{escape(value)}</td></tr>" for label, value in rows)
    return f"<table><caption>{escape(title)}</caption>{lines}</table>"


class Shown(ABC):
    """What ``print`` and Jupyter show as a table."""

    @property
    @abstractmethod
    def title(self) -> str:
        """What it is, for people."""

    @abstractmethod
    def summary(self) -> Rows:
        """(label, value) rows for people."""

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
