"""Figures of grids: contours, deformed grids, and the solution as a surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.problem.units import NO_UNITS, Units, bracketed
from rmesh_nlp.report.foundations import FAR, displaced, magnification
from rmesh_nlp.report.style import FOUNDATION, GRID_LINE, MAP, TWO_COLUMNS, new_figure

LEVELS = 16
BESIDE = 2.1
"""Inches of the width that labels and the colour bar take."""

ABOVE = 0.75
"""Inches of the height that titles and labels of a row take."""


def grid_figure(panels: Mapping[str, Fields], units: Units = NO_UNITS) -> Figure:
    """Grids side by side with contours of the solution; below them, if elastic, the deformed grids.

    Parameters
    ----------
    panels : mapping from titles to Fields
    units : Units
        What stands in the labels of the axes.
    """
    fields = list(panels.values())
    elastic = fields[0].displacement.shape[0] == 2
    factor = _magnification(fields) if elastic else 1.0
    windows = [_window([field.nodes for field in fields], 0.0)]
    if elastic:
        ground = np.concatenate([_ground(field, factor) for field in fields], axis=2)
        windows.append(_window([ground.reshape(2, -1), *(_moved(field, factor) for field in fields)], 0.18))
    scale = (TWO_COLUMNS - BESIDE) / 2 / max(np.ptp(window[0]) for window in windows)
    heights = [float(np.ptp(window[1])) * scale for window in windows]
    width = TWO_COLUMNS if len(panels) > 1 else (TWO_COLUMNS + BESIDE) / 2
    figure = new_figure(width, sum(heights) + ABOVE * len(heights))
    axes = figure.subplots(len(windows), len(panels), squeeze=False, height_ratios=heights)
    values = [_magnitude(field.displacement) for field in fields]
    levels = MaxNLocator(LEVELS).tick_values(min(map(np.min, values)), max(map(np.max, values)))
    for column, (title, field) in enumerate(panels.items()):
        top = axes[0, column]
        filled = top.tricontourf(_mesh(field.nodes, field), values[column], levels=levels, cmap=MAP)
        top.triplot(_mesh(field.nodes, field), color="white", linewidth=_line_width(field))
        top.set_title(title)
        if elastic:
            _deformed(axes[1, column], field, factor, ground)
    bar = figure.colorbar(filled, ax=axes[0, :].tolist(), aspect=10 if elastic else 25, pad=0.02)
    bar.locator = MaxNLocator(5 if elastic else 8)
    bar.update_ticks()
    bar.set_label(f"|u|{bracketed(units.length)}" if elastic else "u")
    for row, window in zip(axes, windows, strict=True):
        for axis in row:
            _frame(axis, window, bracketed(units.length), first=axis is row[0])
    return figure


def surface_figure(panels: Mapping[str, Fields]) -> Figure:
    """The solution of a scalar problem as a surface over each grid."""
    figure = new_figure(TWO_COLUMNS, 2.9)
    low = min(float(field.displacement.min()) for field in panels.values())
    high = max(float(field.displacement.max()) for field in panels.values())
    for column, (title, field) in enumerate(panels.items(), 1):
        axis = figure.add_subplot(1, len(panels), column, projection="3d")
        axis.plot_trisurf(
            _mesh(field.nodes, field),
            field.displacement[0],
            cmap=MAP,
            vmin=low,
            vmax=high,
            edgecolor=GRID_LINE,
            linewidth=0.3,
            shade=False,
        )
        axis.set(xlabel="$x_1$", ylabel="$x_2$", zlim=(low, high))
        axis.set_title(f"u, {title}", y=0.98)
        axis.view_init(elev=28, azim=-130)
        axis.set_box_aspect((4, 4, 2.4), zoom=1.0)
    return figure


def _frame(axis: Axes, window: NDArray[np.float64], unit: str, *, first: bool) -> None:
    axis.set(xlim=window[0], ylim=window[1], xlabel=f"$x_1${unit}")
    axis.set_aspect("equal")
    axis.spines[:].set_visible(False)
    axis.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    if first:
        axis.set_ylabel(f"$x_2${unit}")


def _deformed(axis: Axes, field: Fields, factor: float, ground: NDArray[np.float64]) -> None:
    """The grid moved by its magnified displacement, over the foundation (2, 2, edges)."""
    axis.triplot(_mesh(_moved(field, factor), field), color=GRID_LINE, linewidth=_line_width(field))
    axis.set_title(f"deformed, u and gap × {factor:g}" if factor > 1 else "deformed, true scale")
    if ground.size:
        lines = list(ground.transpose(2, 1, 0))
        axis.add_collection(LineCollection(lines, color=FOUNDATION, linewidth=2.5, capstyle="round"))
        axis.annotate(
            "rigid foundation",
            tuple(ground[:, 0, np.argmin(ground[0, 0])]),
            xytext=(0, -4),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=FOUNDATION,
        )


def _moved(field: Fields, factor: float) -> NDArray[np.float64]:
    """The nodes after the magnified displacement."""
    return field.nodes + factor * field.displacement


def _way(field: Fields) -> NDArray[np.float64]:
    """(2, contact nodes) from the contact nodes to the foundation; none if it is too far off to be drawn."""
    way = (field.foundation - field.nodes)[:, field.contact]
    far = way.size and np.min(np.linalg.norm(way, axis=0)) > FAR * np.max(np.ptp(field.initial, axis=1))
    return way[:, :0] if far else way


def _ground(field: Fields, factor: float) -> NDArray[np.float64]:
    """(2, 2, edges) the foundation from node to node of the contact boundary, where it is drawn."""
    way = _way(field)
    if not way.size:
        return np.zeros((2, 2, 0))
    edges = np.sort(np.hstack([field.triangles[[i, j]] for i, j in ((0, 1), (1, 2), (2, 0))]), axis=0)
    edges, times = np.unique(edges, axis=1, return_counts=True)
    edges = edges[:, (times == 1) & np.all(field.contact[edges], axis=0)]
    return displaced(field.foundation[:, edges], way, factor)


def _window(points: Sequence[NDArray[np.float64]], margin: float) -> NDArray[np.float64]:
    """The smallest box around all points as (2, 2) limits, higher by a part of its height at both ends."""
    every = np.hstack(points)
    low, high = every.min(axis=1), every.max(axis=1)
    extra = np.array([0.01 * (high[0] - low[0]), max(margin, 0.01) * (high[1] - low[1])])
    return np.stack([low - extra, high + extra], axis=1)


def _mesh(nodes: NDArray[np.float64], field: Fields) -> Triangulation:
    return Triangulation(nodes[0], nodes[1], field.triangles.T)


def _line_width(field: Fields) -> float:
    """Thinner lines on finer grids."""
    return float(min(0.6, 8 / np.sqrt(field.triangles.shape[1])))


def _magnitude(displacement: NDArray[np.float64]) -> NDArray[np.float64]:
    """The displacement of a scalar problem, or its length."""
    return displacement[0] if displacement.shape[0] == 1 else np.linalg.norm(displacement, axis=0)


def _magnification(fields: Sequence[Fields]) -> float:
    """By how much displacements are drawn larger than they are."""
    extent = float(np.max(np.ptp(fields[0].initial, axis=1)))
    return magnification(
        [field.displacement for field in fields], [np.hstack([_way(field) for field in fields])], extent
    )
