"""Meshes compared at equal nodes and at equal error, and drawn, by the rows that were measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from best_mesh.methods import ADAPTIVE, LOOP, RELOCATED, REMESHED, UNIFORM
from rows import Row

LOOKS = {
    UNIFORM: ("#000000", "o"),
    ADAPTIVE: ("#56B4E9", "D"),
    LOOP: ("#0072B2", "s"),
    RELOCATED: ("#D55E00", "^"),
    REMESHED: ("#009E73", "*"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers) and marker."""

NEAR = 1e-3
"""How far beyond its ends a curve is read."""


def of(rows: Sequence[Row], case: str, method: str, order: int = 1) -> pd.DataFrame:
    """Rows of a method on a case, by number of nodes."""
    own = [r for r in rows if (r["case"], r["method"], r["order"]) == (case, method, order)]
    frame = pd.DataFrame(own, columns=["size", "nodes", "error", "seconds", "status"])
    return frame[np.isfinite(frame.error.astype(float))].sort_values("nodes", ignore_index=True)


def cases(rows: Sequence[Row]) -> list[str]:
    """Their names, as they were measured."""
    return list(dict.fromkeys(row["case"] for row in rows))


def at(x: Sequence[float], y: Sequence[float], value: float) -> float:
    """The y that belongs to a value of x, log-log between neighbours; NaN beyond the ends; x rises."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(x) < 2 or not x[0] * (1 - NEAR) <= value <= x[-1] * (1 + NEAR):
        return float("nan")
    return float(np.exp(np.interp(np.log(value), np.log(x), np.log(y))))


def error_at(frame: pd.DataFrame, nodes: float) -> float:
    """Error of meshes with a number of nodes."""
    return at(frame.nodes, frame.error, nodes)


def seconds_at(frame: pd.DataFrame, error: float) -> float:
    """Processor time of meshes with an error."""
    falling = frame[np.isfinite(frame.seconds.astype(float))][::-1]
    return at(falling.error, falling.seconds, error)


def draw(axis: Axes, frame: pd.DataFrame, x: str, method: str, **look: object) -> None:
    """Error against ``nodes`` or ``seconds``."""
    colour, marker = LOOKS[method]
    shown = frame[np.isfinite(frame[x].astype(float))]
    look = {"color": colour, "marker": marker, "markersize": 8 if marker == "*" else 5, **look}
    axis.loglog(shown[x], shown.error, **look)


def finished(sheet: Figure, axes: Mapping[str, Sequence[Axes]], first: Axes) -> Figure:
    """With names of the axes, a grid, and one legend below."""
    for name, group in axes.items():
        for axis in group:
            axis.set(xlabel=name)
            axis.grid(alpha=0.3)
    sheet.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    return sheet
