"""What is solved, where a solver stopped, and what that is worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class Finish:
    """Where a solver of a relocation problem stopped: positions (2, nodes), its own word, seconds."""

    nodes: Array
    status: str
    seconds: float


@dataclass(frozen=True)
class Answer:
    """One judged line: an energy and a least area, or whether an MPCC is solved."""

    status: str
    seconds: float
    failed: bool = False
    energy: float | None = None
    least_area: float | None = None
    solved: bool | None = None


@dataclass(frozen=True)
class Case:
    """A relocation problem, the file its mesh is from, and the seconds a solver may take."""

    problem: ContactProblem
    mesh: Path | None = None
    limit: float = float("inf")


class OutOfTimeError(Exception):
    """Raised inside a solver of SciPy to end it."""
