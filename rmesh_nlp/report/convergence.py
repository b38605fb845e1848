"""Figures of the energy against iterations and against contact solves, formulations side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, StrMethodFormatter
from numpy.typing import NDArray

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.problem.units import bracketed, units_of
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, label
from rmesh_nlp.report.style import TWO_COLUMNS, Look, legend_columns, look, new_figure

FEASIBLE = 1e-6
"""Primal residual up to which an iterate counts as one whose energy means something."""

FLOOR = 1e-8
"""Gaps are drawn no lower than this part of the best energy: below is the solvers' tolerance."""

NAMES = ("iteration", "energy", "objective", "seconds", "primal_residual")
"""Columns of a history that are drawn."""

MARKERS = 15
"""About as many markers are put on a curve."""


@dataclass(frozen=True)
class Curve:
    """The history of one solve.

    Attributes
    ----------
    name : str
    iteration, cost, energy : arrays
        Cost: seconds of build and solve over those of one contact solve, for all formulations alike.
        Energy: the objective that was minimised.
    feasible : array of bool
    """

    name: str
    iteration: NDArray[np.float64]
    cost: NDArray[np.float64]
    energy: NDArray[np.float64]
    feasible: NDArray[np.bool_]


def curve(result: Result, unit: float | None = None) -> Curve | None:
    """The curve of a result, in the objective that was minimised; None without a history of it.

    Parameters
    ----------
    result : Result
    unit : float, optional
        Seconds of a contact solve, where several results are compared; by default what this one measured.
    """
    record, steps = result.record, result.steps()
    if not steps or record["formulation"] == RELOCATING_NOTHING:
        return None
    columns = {name: np.array([step.get(name, np.nan) for step in steps]) for name in (*NAMES, *steps[0])}
    of_energy = record["objective"] == "energy"
    value = columns["energy"] if of_energy else columns["objective"]
    if not np.any(np.isfinite(value)):
        return None
    unit = unit or record.get("contact_time_s") or np.nan  # a clock too coarse for it: no cost is known
    cost = columns["seconds"] / unit
    feasible = ~(columns["primal_residual"] > FEASIBLE)
    return Curve(label(record), columns["iteration"], np.maximum(cost, 1.0), value, feasible)


def convergence_figure(curves: Sequence[Curve], best: Record) -> Figure:
    """Distance to the best objective, on the left over iterations, on the right over cost.

    Drawn is the value by the problem's own rule. Energies are per unit of depth, so their unit is that of
    force.
    """
    of_energy = best["objective"] == "energy"
    unit = bracketed(units_of(best.get("units")).force) if of_energy else ""
    symbol = "J" if of_energy else "F"
    ends = [float(one.energy[-1]) for one in curves if one.feasible[-1]]
    reference = min(ends, default=float(best["energy" if of_energy else "objective_value"]))
    figure = new_figure(TWO_COLUMNS, 3.1)
    left, right = figure.subplots(1, 2, sharey=True)
    largest = max(float(np.nanmax(np.abs(one.energy - reference))) for one in curves)
    floor = FLOOR * (abs(reference) or largest or 1.0)
    for position, one in enumerate(curves, 1):
        gap = np.maximum(np.abs(one.energy - reference), floor)
        _draw(left, one.iteration, gap, one, look(position))
        _draw(right, one.cost, gap, one, look(position))
    left.set_yscale("log")
    least = f"{reference:.6g}".replace("-", "−")
    left.set_ylabel(f"|{symbol} − {symbol}*|{unit},  {symbol}* = {least}")
    hollow = "" if all(one.feasible.all() for one in curves) else "\nhollow: constraints not yet met"
    left.set_xlabel(f"iteration\ndrawn down to {_power(FLOOR)} |{symbol}*|{hollow}")
    right.set_xscale("log")
    right.set_xlabel("cost: time of build and solve\nover that of one contact solve")
    for axis in (left, right):
        axis.grid(color="0.9", linewidth=0.5)
        axis.minorticks_off()
    # costs often span less than a decade: without these there would be no label
    right.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    right.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=legend_columns(names))
    return figure


def _power(value: float) -> str:
    """A power of ten as mathematics."""
    return f"$10^{{{round(np.log10(value))}}}$"


def _draw(axis: Axes, where: NDArray[np.float64], gap: NDArray[np.float64], one: Curve, style: Look) -> None:
    """A line with some markers, hollow where the iterate is not feasible."""
    common: Any = {"color": style.color, "marker": style.marker, "markersize": 4, "markeredgewidth": 0.8}
    axis.plot(where, gap, color=style.color, linestyle=style.linestyle)
    marked = np.zeros(where.size, dtype=bool)
    marked[:: max(1, where.size // MARKERS)] = marked[-1] = True
    for kept, face in ((one.feasible & marked, style.color), (~one.feasible & marked, "white")):
        axis.plot(where[kept], gap[kept], linestyle="none", markerfacecolor=face, **common)
    axis.plot([], [], linestyle=style.linestyle, label=one.name, **common)  # for the legend
