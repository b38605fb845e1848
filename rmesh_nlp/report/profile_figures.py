"""Figures of profiles for print."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, StrMethodFormatter

from rmesh_nlp.report.study_summary import Chart
from rmesh_nlp.report.style import TWO_COLUMNS, look, new_figure

FEW = 100
"""Axes that span a smaller factor are labelled with numbers in place of powers."""


def profile_figures(charts: Sequence[Chart]) -> Iterator[tuple[str, Figure]]:
    """Names and figures, one per chart."""
    for chart in charts:
        yield f"profile-{chart.name}", profile_figure(chart)


def profile_figure(chart: Chart) -> Figure:
    """Shares of problems over the chart's quantity, one step function per formulation."""
    figure = new_figure(0.6 * TWO_COLUMNS, 2.9)
    axis = figure.add_subplot()
    every = np.concatenate([profile.at for profile in chart.profiles.values()])
    positive = every[every > 0]
    low = float(max(positive.min(), 1e-6)) if positive.size else 1.0
    high = 1.1 * float(max(positive.max(), 2 * low)) if positive.size else 2.0
    for position, (name, profile) in enumerate(chart.profiles.items(), 1):
        at = np.concatenate([[low], np.maximum(profile.at, low), [high]])
        style = look(position)
        axis.step(
            at,
            profile(at),
            where="post",
            label=name,
            color=style.color,
            linestyle=style.linestyle,
        )
    axis.set(ylim=(-0.02, 1.02), xlabel=chart.axis, ylabel="share of problems", title=chart.title)
    if chart.logarithmic:
        axis.set_xscale("log")
        if high < FEW * low:  # less than two powers of ten would be labelled
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.minorticks_off()
    axis.grid(color="0.9", linewidth=0.5)
    axis.legend(loc="lower right")
    return figure
