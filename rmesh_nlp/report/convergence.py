"""Figures of the energy against iterations and against contact solves, strategies side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rmesh_nlp.io.results import Record, Result
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, label
from rmesh_nlp.report.style import TWO_COLUMNS, Look, look, new_figure

FEASIBLE = 1e-6
"""Primal residual up to which an iterate counts as one whose energy means something."""

FLOOR = 1e-8
"""Gaps are drawn no lower than this part of the best energy: below is the solvers' tolerance."""

MARKERS = 15
"""About as many markers are put on a curve."""


@dataclass(frozen=True)
class Curve:
    """The history of one solve.

    Attributes
    ----------
    name : str
    iteration, cost, energy : arrays
        Cost in units of one contact solve: counted where there are such solves, else wall time
        over that of one contact solve.
    feasible : array of bool
    """

    name: str
    iteration: NDArray[np.float64]
    cost: NDArray[np.float64]
    energy: NDArray[np.float64]
    feasible: NDArray[np.bool_]


def curve(result: Result) -> Curve | None:
    """The curve of a result; None without a history of the energy."""
    record, steps = result.record, result.steps()
    if not steps or record["objective"] != "energy" or record["formulation"] == RELOCATING_NOTHING:
        return None
    columns = {name: np.array([step[name] for step in steps]) for name in steps[0]}
    counted = columns["contact_solves"].max() > 0
    unit = record.get("contact_time_s") or np.nan  # a clock too coarse for it: the cost is not known
    cost = columns["contact_solves"] if counted else columns["seconds"] / unit
    feasible = ~(columns["primal_residual"] > FEASIBLE)
    iteration, energy = columns["iteration"], columns["energy"]
    if iteration[0] > 0:  # a strategy that reports whole solves: begin where it began
        iteration, energy = np.append(0.0, iteration), np.append(record["energy_initial"], energy)
        cost, feasible = np.append(1.0, cost), np.append(True, feasible)
    return Curve(label(record), iteration, np.maximum(cost, 1.0), energy, feasible)


def convergence_figure(curves: Sequence[Curve], best: Record) -> Figure:
    """Distance to the best energy, on the left over iterations, on the right over cost."""
    reference = float(best["energy"])
    figure = new_figure(TWO_COLUMNS, 3.1)
    left, right = figure.subplots(1, 2, sharey=True)
    for position, one in enumerate(curves, 1):
        gap = np.maximum(np.abs(one.energy - reference), FLOOR * abs(reference))
        _draw(left, one.iteration, gap, one, look(position))
        _draw(right, one.cost, gap, one, look(position))
    left.set_yscale("log")
    left.set_ylabel(f"|J − J*|,  J* = {reference:.6f} ({label(best)})")
    hollow = "" if all(one.feasible.all() for one in curves) else "\n(hollow: constraints not yet met)"
    left.set_xlabel(f"iteration{hollow}")
    right.set_xscale("log")
    right.set_xlabel("cost [contact solves]\n(all at once: wall time / time of a contact solve)")
    for axis in (left, right):
        axis.grid(color="0.9", linewidth=0.5)
        axis.minorticks_off()
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=min(len(names), 5))
    return figure


def _draw(axis: Axes, where: NDArray[np.float64], gap: NDArray[np.float64], one: Curve, style: Look) -> None:
    """A line with some markers, hollow where the iterate is not feasible."""
    common: Any = {"color": style.color, "marker": style.marker, "markersize": 4, "markeredgewidth": 0.8}
    axis.plot(where, gap, color=style.color, linestyle=style.linestyle)
    marked = np.zeros(where.size, dtype=bool)
    marked[:: max(1, where.size // MARKERS)] = marked[-1] = True
    for kept, face in ((one.feasible & marked, style.color), (~one.feasible & marked, "white")):
        axis.plot(where[kept], gap[kept], linestyle="none", markerfacecolor=face, **common)
    axis.plot([], [], linestyle=style.linestyle, label=one.name, **common)  # for the legend
