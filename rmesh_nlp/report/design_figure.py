"""The way of a design: objective and design variables over the iterations, one curve per solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rmesh_nlp.report.histories import FEASIBLE
from rmesh_nlp.report.style import LETTERS, MARKERS, Page, add_legend, new_figure, pen_of
from rmesh_nlp.solving.parts import DESIGN

History = Sequence[Mapping[str, Any]]
"""Steps as ``history.csv`` has them."""

PANELS = 8
"""Design variables that have a panel each; more share one, as parts of the ranges of their bounds."""

SPREAD = 10.0  # objectives, and lengths of solves, that differ by more have a logarithmic axis


def design_figure(
    curves: Mapping[str, History], bounds: Mapping[str, Sequence[float]], objective: str, page: Page
) -> Figure | None:
    """Objective and design variables of solves by name; None where no history has a design.

    ``bounds`` (least, largest) by the names of the design variables are dashed lines.
    """
    solves = {name: pd.DataFrame(steps, dtype=float) for name, steps in curves.items()}
    solves = {name: steps for name, steps in solves.items() if DESIGN + next(iter(bounds)) in steps}
    if not solves:
        return None
    panels = {name: ([DESIGN + name], ends) for name, ends in bounds.items()}
    if len(bounds) > PANELS:
        for name, (low, high) in bounds.items():
            for steps in solves.values():
                steps[DESIGN + name] = (steps[DESIGN + name] - low) / (high - low)
        panels = {
            "design variables,\nparts of their bounds": ([DESIGN + name for name in bounds], (0.0, 1.0))
        }
    across = 1 + page.columns
    down = -(-(1 + len(panels)) // across)
    figure = new_figure(page.width, 0.6 + 1.55 * down)
    axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
    for axis in axes[1 + len(panels) :]:
        axis.remove()
    for axis, (name, (columns, ends)) in zip(axes[1:], panels.items(), strict=False):
        for end in ends:
            axis.axhline(end, color="0.55", linestyle=(0, (4, 3)), linewidth=0.8)
        axis.set_ylabel(name)
        _draw(axis, solves, columns)
    axes[0].set_ylabel("objective")
    _draw(axes[0], solves, ["objective"])
    values = pd.concat([steps["objective"] for steps in solves.values()]).dropna()
    if values.size and values.min() > 0 and values.max() > SPREAD * values.min():
        axes[0].set_yscale("log")
    figure.suptitle(fill(objective, int(LETTERS * page.width)), fontsize="medium")
    lengths = [len(steps) for steps in solves.values()]
    for number, axis in enumerate(axes[: 1 + len(panels)]):
        axis.grid(color="0.92", linewidth=0.5)
        if max(lengths) > SPREAD * min(lengths):
            axis.set_xscale("symlog", linthresh=1)
            axis.set_xlim(left=-0.3)
        else:
            axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        if number + across > len(panels):  # the last panel of its column
            axis.set_xlabel("iteration")
            axis.tick_params(labelbottom=True)
    if len(solves) > 1:
        add_legend(figure, [axes[0]], "outside lower center")
    return figure


def _draw(axis: Axes, solves: Mapping[str, pd.DataFrame], columns: Sequence[str]) -> None:
    """Columns over the iterations, faint where constraints, or the contact conditions, are not met."""
    for position, (name, steps) in enumerate(solves.items(), 1):
        pen = {**pen_of(position), "markersize": 4, "markeredgewidth": 0.7, "markerfacecolor": "white"}
        iteration, met = steps["iteration"], ~(steps["primal_residual"] > FEASIBLE)
        for column in columns:
            value = steps[column]
            axis.plot(iteration, value, color=pen["color"], alpha=0.35, linewidth=0.8)
            axis.plot(iteration, value.where(met), **pen, markevery=max(1, len(steps) // MARKERS), label=name)
            end = {**pen, "markerfacecolor": pen["color"], "linestyle": "none"}
            axis.plot(iteration[-1:], value[-1:], **end)
