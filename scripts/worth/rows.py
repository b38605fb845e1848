"""Rows of the benchmark, kept as JSON lines as they are measured: a run that is broken off goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Row:
    """One mesh of one method.

    Attributes
    ----------
    case, method, size : str
        Rows with the same three were measured together.
    nodes : int
    error : float
        Of the energy, or half the squared error in the energy norm, as the case says.
    seconds : float
        Processor time to this mesh, statement of the programs included.
    units : float
        The same in cold contact solves on this mesh.
    least_area : float
        Smallest ratio of an element's area to its initial one; NaN without relocation.
    least_angle : float
        In degrees.
    figures : dict
        What else was measured.
    """

    case: str
    method: str
    size: str
    nodes: int
    error: float
    seconds: float = float("nan")
    units: float = float("nan")
    least_area: float = float("nan")
    least_angle: float = float("nan")
    figures: dict[str, Any] = field(default_factory=dict)


class Store:
    """A file of rows."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = path.read_text().splitlines() if path.exists() else []
        self.rows = [Row(**json.loads(line)) for line in lines]

    def measured(self, case: str, method: str, size: str, rows: Callable[[], Iterable[Row]]) -> None:
        """Measure and keep, unless that was done before."""
        if any((r.case, r.method, r.size) == (case, method, size) for r in self.rows):
            return
        new = list(rows())
        with self._path.open("a") as file:
            for row in new:
                file.write(json.dumps(asdict(row)) + "\n")
                print(
                    f"{row.case:14} {row.method:32} {row.nodes:6} nodes  error {row.error:.4g}  "
                    f"{row.seconds:7.2f} s  {row.figures or ''}",
                    flush=True,
                )
        self.rows += new
