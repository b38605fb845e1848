"""Rows of the benchmark, kept as JSON lines as they are measured, and the table and the figure of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

GIVEN, ADAPTIVE = "linear, given mesh", "linear, h-adaptive"
STYLES = {
    GIVEN: ("#000000", "o", "-"),
    "quadratic, given mesh": ("#F0A000", "x", "-"),
    ADAPTIVE: ("#56B4E9", "D", "--"),
    "relocated, move limits": ("#999999", "v", "-"),
    "relocated": ("#D55E00", "^", "-"),
    "remeshed, relocated": ("#009E73", "*", "-"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers), marker and line of each method."""

MANY, NEAR = 6, 1e-3
"""Meshes of a method from which on a table leaves some out; how far beyond its ends a curve is read."""


@dataclass(frozen=True)
class Row:
    """One mesh of one method.

    Attributes
    ----------
    case, method, size : str
        Rows with the same three were measured together.
    nodes : int
        With the midpoints of edges for quadratic elements.
    error : float
        Of the energy, or half the squared error in the energy norm, as the case says.
    seconds : float
        Processor time to this mesh, model build included; NaN where it means nothing.
    status : str
        Of a relocation.
    """

    case: str
    method: str
    size: str
    nodes: int
    error: float
    seconds: float = float("nan")
    status: str = ""


class Store:
    """A file of rows: a run that is broken off goes on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = path.read_text().splitlines() if path.exists() else []
        self.rows = [Row(**json.loads(line)) for line in lines]

    def has(self, case: str, method: str, size: str) -> bool:
        """Whether these were measured before."""
        return any((r.case, r.method, r.size) == (case, method, size) for r in self.rows)

    def keep(self, rows: Iterable[Row]) -> None:
        """Append rows, and show them."""
        new = list(rows)
        with self._path.open("a") as file:
            file.writelines(json.dumps(asdict(row)) + "\n" for row in new)
        for row in new:
            print(
                f"{row.case:14} {row.method:24} {row.nodes:6} {row.error:.4g} {row.seconds:8.3f} s",
                row.status,
            )
        self.rows += new


def of(rows: Iterable[Row], case: str, method: str) -> list[Row]:
    """Rows of a method on a case, by number of nodes."""
    found = {r.nodes: r for r in rows if (r.case, r.method) == (case, method)}
    return [found[nodes] for nodes in sorted(found)]


def at(x: Sequence[float], y: Sequence[float], value: float) -> float:
    """The y that belongs to a value of x, log-log between neighbours; NaN beyond the ends; x rises."""
    if len(x) < 2 or not x[0] * (1 - NEAR) <= value <= x[-1] * (1 + NEAR):
        return float("nan")
    lx, ly = np.log(x), np.log(y)
    k = int(np.clip(np.searchsorted(lx, np.log(value)), 1, len(x) - 1))
    slope = (ly[k] - ly[k - 1]) / (lx[k] - lx[k - 1])
    return float(np.exp(ly[k - 1] + slope * (np.log(value) - lx[k - 1])))


def table(rows: Sequence[Row]) -> str:
    """A line for each method on each case, in Markdown."""
    lines = [
        "| problem | method | nodes | error | over the given mesh's | over h-adaptive's | seconds "
        "| over h-adaptive's |",
        "|:--|:--|--:|--:|--:|--:|--:|--:|",
    ]
    cases = dict.fromkeys(r.case for r in rows)
    for case, method in ((c, m) for c in cases for m in STYLES if of(rows, c, m)):
        own = of(rows, case, method)
        own = own[:: -(1 + len(own) // MANY)][::-1]  # the last one always
        given, adaptive = of(rows, case, GIVEN), of(rows, case, ADAPTIVE)
        by_nodes = [
            [r.error / at([o.nodes for o in other], [o.error for o in other], r.nodes) for r in own]
            for other in (given, adaptive)
        ]
        falling = adaptive[::-1]
        times = [
            r.seconds / at([o.error for o in falling], [o.seconds for o in falling], r.error) for r in own
        ]
        cells = [
            _figures([r.nodes for r in own], "d"),
            _figures([r.error for r in own], ".2g"),
            "" if method == GIVEN else _figures(by_nodes[0], ".2g"),
            "" if method == ADAPTIVE else _figures(by_nodes[1], ".2g"),
            _figures([r.seconds for r in own], ".2g"),
            "" if method == ADAPTIVE else _figures(times, ".2g"),
        ]
        lines.append(f"| {case} | {method} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _figures(values: Sequence[float], form: str) -> str:
    if not np.any(np.isfinite(values)):
        return ""
    return ", ".join(format(v, form) if np.isfinite(v) else "-" for v in values)


def picture(rows: Sequence[Row], case: str = "6.1") -> Figure:
    """Error against nodes and against time."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for method, (colour, marker, style) in STYLES.items():
        part = of(rows, case, method)
        look = {"color": colour, "marker": marker, "linestyle": style, "markersize": 5, "label": method}
        for axis, x in zip(axes, ("nodes", "seconds"), strict=True):
            if part:
                axis.loglog([getattr(r, x) for r in part], [r.error for r in part], **look)
    axes[0].set(xlabel="nodes", ylabel=f"error of the energy, Example {case}")
    axes[1].set(xlabel="processor time [s]")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=9)
    return figure
