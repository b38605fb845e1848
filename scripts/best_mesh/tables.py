"""Meshes compared at equal nodes and at equal error, and drawn, by the rows that were measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from best_mesh.methods import ADAPTIVE, LOOP, RELOCATED, REMESHED, UNIFORM
from rows import Row, figure, markdown

LOOKS = {
    UNIFORM: ("#000000", "o"),
    ADAPTIVE: ("#56B4E9", "D"),
    LOOP: ("#0072B2", "s"),
    RELOCATED: ("#D55E00", "^"),
    REMESHED: ("#009E73", "*"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers) and marker."""

Curve = tuple[str, int, dict[str, object]]
"""Method, order, and how it is drawn."""

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
    """The y that belongs to a value of x, log-log between neighbours; NaN beyond the ends."""
    x, y = (np.asarray(values, dtype=float)[np.argsort(x)] for values in (x, y))
    if len(x) < 2 or not x[0] * (1 - NEAR) <= value <= x[-1] * (1 + NEAR):
        return float("nan")
    return float(np.exp(np.interp(np.log(value), np.log(x), np.log(y))))


def draw(axis: Axes, frame: pd.DataFrame, x: str, method: str, **look: object) -> None:
    """Error against ``nodes`` or ``seconds``."""
    colour, marker = LOOKS[method]
    shown = frame[np.isfinite(frame[x].astype(float))]
    look = {"color": colour, "marker": marker, "markersize": 8 if marker == "*" else 5, **look}
    axis.loglog(shown[x], shown.error, **look)


def side_by_side(rows: Sequence[Row], case: str, curves: Iterable[Curve]) -> tuple[Figure, Axes]:
    """Errors against nodes and against time, by method, order and look; and the axis of nodes."""
    sheet = Figure(figsize=(8, 4.4), layout="constrained")
    left, right = sheet.subplots(1, 2, sharey=True)
    for method, order, look in curves:
        for axis, x in ((left, "nodes"), (right, "seconds")):
            draw(axis, of(rows, case, method, order), x, method, **look)
    return sheet, left


def finished(sheet: Figure, unknowns: str = "nodes") -> Figure:
    """With names of the axes, a grid, and one legend below."""
    for axis in sheet.axes:
        axis.grid(alpha=0.3)
    half = len(sheet.axes) // 2
    for name, axes in ((unknowns, sheet.axes[:half]), ("processor time [s]", sheet.axes[half:])):
        for axis in axes:
            axis.set(xlabel=name)
    handles = sheet.axes[0].get_legend_handles_labels()
    sheet.legend(*handles, loc="outside lower center", ncols=3, fontsize=9)
    return sheet


def times(
    rows: Sequence[Row], order: int, methods: Sequence[str], peers: Sequence[str], many: int
) -> pd.DataFrame:
    """Processor times of meshes of ``many`` nodes over those of plain meshes of scikit-fem at equal error.

    Where no mesh that was measured reaches the error, the last ones are continued: with the rate of the
    error, and with a time in proportion to the nodes, so that the ratio is a bound.
    """
    lines = []
    for case in cases(rows):
        curves = {peer: of(rows, case, peer, order).dropna(subset="seconds") for peer in peers}
        for method in methods if any(map(len, curves.values())) else ():
            for mesh in of(rows, case, method, order).query("nodes >= @many").itertuples():
                line = {"problem": case, "method": method, "nodes": mesh.nodes, "s": mesh.seconds}
                for peer, own in curves.items():
                    line[f"over {peer}"] = figure(mesh.seconds / at(own.error, own.seconds, mesh.error))
                    if len(own) > 1 and mesh.error < own.error.iloc[-1]:
                        (_, before), (_, last) = own[-2:].iterrows()
                        rate = np.log(before.error / last.error) / np.log(last.nodes / before.nodes)
                        least = last.seconds * (last.error / mesh.error) ** (1 / rate)
                        line[f"over {peer}"] = f"< {figure(mesh.seconds / least)}"
                lines.append(line)
    columns = ["problem", "method", "nodes", "s", *(f"over {peer}" for peer in peers)]
    return pd.DataFrame(lines, columns=columns)


def written(folder: Path, tables: Iterable[pd.DataFrame], sheet: Figure, name: str) -> None:
    """Print tables, and write them and a figure into a folder."""
    text = "\n".join(map(markdown, tables))
    (folder / "table.md").write_text(text)
    sheet.savefig(folder / name, dpi=150)
    print(text)
