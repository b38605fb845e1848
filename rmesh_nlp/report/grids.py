"""Figures of grids: contours, deformed grids, and the solution as a surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.problem.units import NO_UNITS, Units, bracketed
from rmesh_nlp.report.style import FOUNDATION, GRID_LINE, MAP, TWO_COLUMNS, new_figure

LEVELS = 16
LARGEST_DEFORMATION = 0.08
"""Displacements are drawn no longer than this part of the body's extent."""

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
    magnification = _magnification(fields)
    windows = [_window([field.nodes for field in fields], 0.0)]
    if elastic:
        moved = [
            part for field in fields for part in (_moved(field, magnification), _ground(field, magnification))
        ]
        windows.append(_window(moved, 0.18))
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
            _deformed(axes[1, column], field, magnification)
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


def _deformed(axis: Axes, field: Fields, magnification: float) -> None:
    """The grid moved by its magnified displacement, over the foundation.

    The initial distance to the foundation is magnified as well, so that what touches is seen to.
    """
    axis.triplot(_mesh(_moved(field, magnification), field), color=GRID_LINE, linewidth=_line_width(field))
    axis.set_title(f"deformed, displacement × {magnification:g}")
    if field.contact.any():
        line = _ground(field, magnification)
        axis.plot(*line, color=FOUNDATION, linewidth=2.5, solid_capstyle="butt")
        axis.annotate(
            "rigid foundation",
            (line[0, 0], line[1, 0]),
            xytext=(0, -4),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=FOUNDATION,
        )


def _moved(field: Fields, magnification: float) -> NDArray[np.float64]:
    """The nodes after the magnified displacement."""
    return field.nodes + magnification * field.displacement


def _ground(field: Fields, magnification: float) -> NDArray[np.float64]:
    """The foundation below the contact nodes, its distance magnified, from left to right."""
    ground = (field.nodes + magnification * (field.foundation - field.nodes))[:, field.contact]
    return ground[:, np.argsort(ground[0])]


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
    """The largest of 1, 2, 5, 10, ... that keeps displacements small against the body, or less."""
    largest = max(float(np.max(np.abs(field.displacement))) for field in fields)
    extent = float(np.max(np.ptp(fields[0].initial, axis=1)))
    if largest == 0:
        return 1.0
    wanted = LARGEST_DEFORMATION * extent / largest
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= wanted))
