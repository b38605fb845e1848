"""Curves: convergence of solves and of designs, bounds of the energy over the mesh, profiles of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, StrMethodFormatter

from rmesh_nlp.io.records import Record, Records, objective_of
from rmesh_nlp.problem.units import bracketed, units_of
from rmesh_nlp.report.blocks import grouped, label, order_of, with_order
from rmesh_nlp.report.histories import is_feasible
from rmesh_nlp.report.study_summary import Chart
from rmesh_nlp.report.style import LETTERS, MARKERS, Page, add_legend, new_figure, pen_of
from rmesh_nlp.solving.parts import DESIGN, FEW

FLOOR = 1e-8  # part of the best objective down to which distances are drawn: the solvers' tolerance
UNMET = "open markers: constraints not yet met"

SPREAD = 10.0  # objectives, and lengths of solves, that differ by more have a logarithmic axis


def convergence_figure(
    curves: Sequence[tuple[str, pd.DataFrame]],
    best: Record,
    page: Page,
    positions: Mapping[str, int] | None = None,
) -> Figure:
    """Distance to the best objective over iterations and over cost; on one column over the cost alone.

    ``curves`` have a name and the steps that :func:`rmesh_nlp.report.histories.curve` gives. Drawn is the
    value by the problem's own rule. ``best``
    has the lowest objective, for curves without a feasible end; ``positions`` are those of the names in other
    figures.
    """
    of_energy = objective_of(best) == "energy"
    unit = bracketed(units_of(best).energy) if of_energy else ""
    symbol = "J" if of_energy else "F"
    last = (one.iloc[-1] for _, one in curves)
    ends = [float(end["value"]) for end in last if end["feasible"]]
    reference = min(ends, default=float(best["energy" if of_energy else "objective_value"]))
    figure = new_figure(page.width, 3.1)
    axes = figure.subplots(1, page.columns, sharey=True, squeeze=False)[0]
    gaps = [(one["value"] - reference).abs() for _, one in curves]
    largest = max(float(gap.max()) for gap in gaps) or 1.0
    # a sum of squares may end at rounding: parts of that would span thirty decades
    ends_at_zero = abs(reference) < FLOOR * largest
    floor = FLOOR * (largest if ends_at_zero else abs(reference))
    for position, ((name, one), gap) in enumerate(zip(curves, gaps, strict=True), 1):
        pen = pen_of(position if positions is None else positions[name])
        for axis, where in zip(axes[::-1], ("cost", "iteration"), strict=False):
            _draw(axis, one[where], gap.clip(lower=floor), one["feasible"], pen, name)
    least = f"{reference:.6g}".replace("-", "−")
    drawn_to = f"{symbol}* = {least}, drawn down to $10^{{{round(np.log10(FLOOR))}}}$ "
    drawn_to += "of the largest" if ends_at_zero else f"|{symbol}*|"
    if not all(one["feasible"].all() for _, one in curves):
        drawn_to += f"\n{UNMET}"
    axes[0].xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes[-1].set(xscale="log", xlabel="cost: time of build and solve\nover that of one contact solve")
    axes[0].set(yscale="log", ylabel=f"|{symbol} − {symbol}*|{unit}")
    axes[0].set_xlabel(f"{'iteration' if len(axes) > 1 else 'cost [contact solves]'}\n{drawn_to}")
    for axis in axes:
        axis.grid(visible=True)
        axis.minorticks_off()
    _label_in_numbers(axes[-1])
    add_legend(figure, [axes[0]])
    return figure


def _draw(
    axis: Axes, where: pd.Series, values: pd.Series, met: pd.Series, pen: dict[str, Any], name: str
) -> None:
    """A line over iterations or costs with some markers, filled where an iterate meets its constraints."""
    marked = sorted({*range(0, where.size, max(1, where.size // MARKERS)), where.size - 1})
    common = {**pen, "markersize": 4, "markeredgewidth": 0.8}
    axis.plot(where, values, **common, markevery=marked, markerfacecolor="white")
    full = {**common, "linestyle": "none", "markerfacecolor": pen["color"]}
    axis.plot(where, values.where(met), **full, markevery=marked)
    axis.plot([], [], **{**full, "linestyle": pen["linestyle"]}, label=name)  # for the legend


def _label_in_numbers(axis: Axes) -> None:
    """Labels 1, 2, 5, 10 where an axis spans few decades, and even ones where it spans less than one."""
    axis.minorticks_off()
    low, high = axis.get_xlim()
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high > SPREAD * low else MaxNLocator(5))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def design_figure(
    curves: Mapping[str, pd.DataFrame], bounds: Mapping[str, Sequence[float]], objective: str, page: Page
) -> Figure | None:
    """Objective and design variables over the iterations of solves by name; None if no history has a design.

    ``bounds`` (least, largest) by the names of the design variables are dashed lines.
    """
    solves = {name: steps for name, steps in curves.items() if DESIGN + next(iter(bounds)) in steps}
    if not solves:
        return None
    panels: list[tuple[str, list[str], Sequence[float]]] = [("objective", ["objective"], ())]
    if len(bounds) <= FEW:
        panels += [(name, [DESIGN + name], ends) for name, ends in bounds.items()]
    else:
        names, (low, high) = [DESIGN + name for name in bounds], np.transpose([*bounds.values()])
        parts = {name: (steps[names] - low) / (high - low) for name, steps in solves.items()}
        solves = {name: steps.assign(**parts[name]) for name, steps in solves.items()}
        panels.append(("design variables,\nparts of their bounds", names, (0.0, 1.0)))
    across = 1 + page.columns
    down = -(-len(panels) // across)
    figure = new_figure(page.width, 0.6 + 1.55 * down)
    axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
    for axis, (title, names, ends) in zip(axes, panels, strict=False):
        for end in ends:
            axis.axhline(end, color="0.55", linestyle=(0, (4, 3)), linewidth=0.8)
        for position, (name, steps) in enumerate(solves.items(), 1):
            for column in names:
                _draw(axis, steps["iteration"], steps[column], is_feasible(steps), pen_of(position), name)
        axis.set(xlabel="iteration", ylabel=title)
        axis.grid(visible=True)
        axis.tick_params(labelbottom=True)
    for axis in axes[len(panels) :]:
        axis.remove()
    every, lengths = pd.concat([*solves.values()]), [len(steps) for steps in solves.values()]
    if max(lengths) > SPREAD * min(lengths):  # of all panels
        axes[0].set_xscale("symlog", linthresh=1)
        axes[0].set_xlim(left=-0.3)
    else:
        axes[0].xaxis.set_major_locator(MaxNLocator(4, integer=True))
    if 0 < SPREAD * every["objective"].min() < every["objective"].max():
        axes[0].set_yscale("log")
    said = fill(objective, int(LETTERS * page.width))
    figure.suptitle(said if is_feasible(every).all() else f"{said}\n{UNMET}", fontsize="medium")
    if len(solves) > 1:
        add_legend(figure, [axes[0]], "outside lower center")
    return figure


def profile_figure(chart: Chart, page: Page) -> Figure:
    """Shares of problems over the chart's quantity, one step function per formulation."""
    figure = new_figure(page.narrow, 2.9)
    axis = figure.add_subplot()
    every = np.concatenate([profile.at for profile in chart.profiles.values()])
    positive = every[every > 0]
    # values of zero stand at the left edge of a logarithmic axis
    low = float(max(positive.min(), 1e-6)) if positive.size else 1.0
    high = 1.1 * float(max(positive.max(), 2 * low)) if positive.size else 2.0
    for position, (name, profile) in enumerate(chart.profiles.items(), 1):
        at = np.concatenate([[low], np.maximum(profile.at, low), [high]])
        axis.step(at, profile(at), where="post", label=name, **{**pen_of(position), "marker": ""})
    axis.set(ylim=(None, 1.01), xlabel=chart.axis, ylabel="share of problems", xscale="log")
    _label_in_numbers(axis)
    axis.grid(visible=True)
    add_legend(figure, [axis])
    return figure


def bracket_figure(records: Records, page: Page) -> Figure:
    """Lower and upper bounds of the least energy against the size of the mesh, a band per formulation.

    The size is the number of nodes, and of unknowns where not all displacements are linear.
    """
    figure = new_figure(page.narrow, 2.8)
    axis = figure.subplots()
    size = "nodes" if all(order_of(record) == 1 for record in records) else "unknowns"
    bands = grouped(records, lambda record: with_order(label(record), record))
    for position, (name, own) in enumerate(bands.items()):
        rows = sorted(own, key=lambda record: int(record[size]))
        nodes = [row[size] for row in rows]
        low, high = ([row[f"energy_{side}_bound"] for row in rows] for side in ("lower", "upper"))
        look = {**pen_of(position), "markersize": 4}
        axis.fill_between(nodes, low, high, color=look["color"], alpha=0.15, linewidth=0)
        axis.plot(nodes, high, **{**look, "linestyle": "-"}, label=name)
        axis.plot(nodes, low, **{**look, "linestyle": "--"})
    axis.set(xscale="log", xlabel=size, ylabel="bounds of the least energy")
    _label_in_numbers(axis)
    axis.legend()
    return figure


def estimates_figure(meshes: Sequence[Record], page: Page) -> Figure:
    """Relative errors of quantities against nodes and seconds, with bars up to half the width of bounds."""
    figure = new_figure(page.width, 2.8)
    for axis, size in zip(figure.subplots(1, 2, sharey=True), ("nodes", "seconds"), strict=True):
        at = [mesh[size] for mesh in meshes]
        for position, text in enumerate(meshes[-1]["quantities"], 1):
            rows, pen = pd.DataFrame([mesh["quantities"][text] for mesh in meshes]), pen_of(position)
            parts = rows.filter(["error", "lower", "upper"]).astype(float).div(rows["value"].abs(), axis=0)
            axis.loglog(at, parts["error"], **pen, label=text if parts["error"].any() else "")
            if "lower" in parts:
                width = (parts["upper"] - parts["lower"]) / 2
                axis.vlines(at, parts["error"], width, color=pen["color"], alpha=0.5)
        axis.minorticks_off()
        _label_in_numbers(axis)
        axis.set(xlabel=size, ylabel="estimated error over value")
    add_legend(figure, figure.axes[:1])
    return figure
