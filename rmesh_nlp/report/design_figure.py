"""The way of a design: objective and design variables over the iterations, one curve per solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rmesh_nlp.evaluation import Array
from rmesh_nlp.report.histories import FEASIBLE
from rmesh_nlp.report.style import LETTERS, TWO_COLUMNS, add_legend, look, new_figure
from rmesh_nlp.solving.parts import DESIGN

History = Sequence[Mapping[str, Any]]
"""Steps as ``history.csv`` has them."""

PANELS = 8
"""Design variables that have a panel each; more share one, as parts of the ranges of their bounds."""

DECADES = 100.0  # an objective that spans more than this factor has a logarithmic axis
UNEQUAL = 10.0  # so are iterations, if one solve takes this many times those of another
MARKERS = 12  # about as many markers on a curve
ROOM = 0.06  # beyond the bounds, as a part of their range


def design_figure(
    curves: Mapping[str, History],
    bounds: Mapping[str, Sequence[float]],
    objective: str,
    *,
    width: float = TWO_COLUMNS,
    first: int = 1,
) -> Figure | None:
    """Objective and design variables of solves by name; None where no history has a design.

    ``bounds`` (least, largest) by the names of the design variables are dashed lines; ``first`` is the
    position of the first curve among the looks.
    """
    some = DESIGN + next(iter(bounds))
    drawn = {name: steps for name, steps in curves.items() if steps and some in steps[0]}
    if not drawn:
        return None
    few = len(bounds) <= PANELS
    count, across = 1 + (len(bounds) if few else 1), 3 if width > TWO_COLUMNS / 2 + 1 else 2
    down = -(-count // across)
    figure = new_figure(width, 0.6 + 1.55 * down)
    axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
    for axis in axes[count:]:
        axis.remove()
    for position, (name, steps) in enumerate(drawn.items(), first):
        pen: dict[str, Any] = {**look(position).line(scale=0.7), "markeredgewidth": 0.7}
        _draw(axes[0], steps, "objective", {**pen, "label": name})
        for axis, variable in zip(axes[1:], bounds if few else (), strict=False):
            _draw(axis, steps, DESIGN + variable, pen)
        if not few:
            _draw_all(axes[1], steps, bounds, pen)
    axes[0].set_ylabel("objective")
    _scale(axes[0], list(drawn.values()))
    figure.suptitle(fill(objective, int(LETTERS * width)), fontsize="medium")
    for axis, (variable, ends) in zip(axes[1:], bounds.items() if few else (), strict=False):
        for end in ends:
            axis.axhline(end, color="0.55", linestyle=(0, (4, 3)), linewidth=0.8)
        room = ROOM * (ends[1] - ends[0])
        axis.set(ylabel=variable, ylim=(ends[0] - room, ends[1] + room))
    if not few:
        axes[1].set_ylabel("design variables,\nparts of their bounds")
    _finish(list(axes[:count]), across, [len(steps) for steps in drawn.values()])
    if len(drawn) > 1:
        add_legend(figure, [axes[0]], "outside lower center")
    return figure


def _finish(axes: Sequence[Axes], across: int, lengths: Sequence[int]) -> None:
    """Ticks, and the label of the last panel of each column."""
    for number, axis in enumerate(axes):
        axis.yaxis.set_major_locator(MaxNLocator(4)) if axis.get_yscale() == "linear" else None
        axis.grid(color="0.92", linewidth=0.5)
        if number + across >= len(axes):
            axis.set_xlabel("iteration")
            axis.tick_params(labelbottom=True)
        if max(lengths) > UNEQUAL * min(lengths):
            axis.set_xscale("symlog", linthresh=1)
            axis.set_xlim(left=-0.3)
        else:
            axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))


def _draw(axis: Axes, steps: History, name: str, pen: dict[str, Any]) -> None:
    """A column over the iterations, faint where constraints, or the contact conditions, are not met."""
    iteration, value = _column(steps, "iteration"), _column(steps, name)
    met = ~(_column(steps, "primal_residual") > FEASIBLE)
    axis.plot(iteration, value, color=pen["color"], alpha=0.35, linewidth=0.8)
    axis.plot(iteration, np.where(met, value, np.nan), **pen, markevery=max(1, len(steps) // MARKERS))
    end = {**pen, "markerfacecolor": pen["color"], "linestyle": "none", "label": None}
    axis.plot(iteration[-1:], value[-1:], **end)


def _scale(axis: Axes, curves: Sequence[History]) -> None:
    """A logarithmic axis for an objective that spans decades."""
    values = np.concatenate([_column(steps, "objective") for steps in curves])
    shown = values[np.isfinite(values)]
    if shown.size and shown.min() > 0 and shown.max() > DECADES * shown.min():
        axis.set_yscale("log")


def _draw_all(axis: Axes, steps: History, bounds: Mapping[str, Sequence[float]], pen: dict[str, Any]) -> None:
    iteration = _column(steps, "iteration")
    for variable, (low, high) in bounds.items():
        part = (_column(steps, DESIGN + variable) - low) / (high - low)
        axis.plot(iteration, part, color=pen["color"], linewidth=0.5, alpha=0.6)
    axis.set_ylim(-ROOM, 1 + ROOM)


def _column(steps: History, name: str) -> Array:
    values = [step.get(name) for step in steps]
    return np.array([np.nan if value is None else value for value in values], dtype=float)
