"""The figure of the benchmark: error against nodes and against time."""

from __future__ import annotations

from matplotlib.figure import Figure
from worth.goals import of
from worth.rows import Row

STYLES = {
    "uniform": ("#000000", "o", "-"),
    "h-adaptive, oracle": ("#0072B2", "s", "-"),
    "h-adaptive, residual estimator": ("#56B4E9", "D", "--"),
    "boxes": ("#999999", "v", "-"),
    "large moves": ("#D55E00", "^", "-"),
    "large moves, flips": ("#CC79A7", "P", "-"),
    "hr": ("#009E73", "*", "--"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers), marker and line of each method."""


def picture(rows: list[Row], case: str = "6.1") -> Figure:
    """Error against nodes and against time."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for method, (colour, marker, style) in STYLES.items():
        part = of(rows, case, method)
        if not part:
            continue
        for axis, x in zip(axes, ("nodes", "seconds"), strict=True):
            axis.loglog(
                [getattr(r, x) for r in part],
                [r.error for r in part],
                color=colour,
                marker=marker,
                linestyle=style,
                markersize=5,
                linewidth=1.4,
                label=method,
            )
    axes[0].set(xlabel="nodes", ylabel=f"error of the energy, Example {case}")
    axes[1].set(xlabel="processor time in seconds, with the statement of the programs")
    for axis in axes:
        axis.grid(which="major", alpha=0.35)
        axis.grid(which="minor", alpha=0.12)
    axes[0].legend(fontsize=9)
    return figure
