"""What an entry of a record is: its name and type, what it means, and its column in tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Literal

from pydantic import Field

Digits = str | Callable[[float], str]
"""A format of numbers, or what chooses one for a number."""


def of_energies(value: float) -> str:
    """Six decimals, or seven digits where an energy is very large or very small."""
    return ".6f" if value == 0 or 1e-3 <= abs(value) < 1e3 else ".7g"


def of_seconds(value: float) -> str:
    """Two digits, and all of them before the point."""
    return ".2g" if value < 10 else ".0f"


def attribute(thing: Any, path: str) -> Any:
    """The attribute at the end of a path with dots; None where the path has an end before."""
    for name in path.split("."):
        thing = None if thing is None else getattr(thing, name)
    return thing


class Presence(Enum):
    """In which records an entry stands.

    EVERY: in each one; what is not known is null.
    SOLVED: in each one of a solve that ended, also as null.
    KNOWN: where there is something to say.
    """

    EVERY = "every"
    SOLVED = "solved"
    KNOWN = "known"


EVERY, SOLVED, KNOWN = Presence


@dataclass(frozen=True)
class Entry:
    """One entry.

    Attributes
    ----------
    name : str
    type : type
        What pydantic checks, strictly; null may stand for everything but texts and flags of ``EVERY`` record.
    meaning : str
        In Markdown.
    of : str or callable, optional
        Where a Solution has its value, such as ``assessment.tolerance``, or what makes it of a Solution;
        without one, formulations, comparisons or studies write it.
    presence : Presence
    unit : str
        "energy" and "length" are those of the problem; empty where there is none.
    heading, digits : str
        Of its column; lines of a heading are separated by a bar, and by default it is the name.
    """

    name: str
    type: object
    meaning: str
    of: str | Callable[[Any], object] | None = None
    presence: Presence = KNOWN
    unit: str = ""
    heading: str = ""
    digits: Digits = "d"

    def value(self, solution: Any) -> object:
        """Its value for a Solution, None where there is none."""
        return self.of(solution) if callable(self.of) else attribute(solution, str(self.of))


Number = float | None
Count = Annotated[int, Field(lt=2**63)] | None
Seconds = Annotated[float, Field(ge=0)] | None
Widths = Annotated[list[float], Field(min_length=2, max_length=2)] | dict[Literal["relative"], float] | None
Text = str | None
Named = dict[str, Number] | None
