"""Figures of grids: contours, deformed grids, and the solution as a surface."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.report.style import FOUNDATION, GRID_LINE, MAP, TWO_COLUMNS, new_figure
from rmesh_nlp.vtu import Fields

LEVELS = 14
LARGEST_DEFORMATION = 0.08
"""Displacements are drawn no longer than this part of the body's extent."""


def grid_figure(panels: Mapping[str, Fields]) -> Figure:
    """Grids side by side with contours of the solution; below them, if elastic, the deformed grids.

    Parameters
    ----------
    panels : mapping from titles to Fields
    """
    fields = list(panels.values())
    elastic = fields[0].displacement.shape[0] == 2
    width = TWO_COLUMNS / len(panels)
    extent = np.ptp(fields[0].initial, axis=1)
    height = width * extent[1] / extent[0] * (2.2 if elastic else 1) + (1.4 if elastic else 0.35)
    figure = new_figure(TWO_COLUMNS if len(panels) > 1 else width + 1, height)
    axes = figure.subplots(2 if elastic else 1, len(panels), squeeze=False)
    values = [_magnitude(field.displacement) for field in fields]
    levels = _levels(values)
    magnification = _magnification(fields)
    for column, (title, field) in enumerate(panels.items()):
        top = axes[0, column]
        filled = top.tricontourf(_mesh(field.nodes, field), values[column], levels=levels, cmap=MAP)
        top.triplot(_mesh(field.nodes, field), color="white", linewidth=0.5)
        top.set_title(title)
        if elastic:
            _deformed(axes[1, column], field, magnification)
    bar = figure.colorbar(filled, ax=axes[0, :].tolist(), aspect=12 if elastic else 25, pad=0.02)
    bar.set_label("|u| [m]" if elastic else "u")
    if elastic:
        lows, highs = zip(*(axis.get_ylim() for axis in axes[1]), strict=True)
        for axis in axes[1]:
            axis.set_ylim(min(lows), max(highs))
    for axis in axes.ravel():
        axis.set_aspect("equal")
        axis.spines[["top", "right", "left", "bottom"]].set_visible(False)
        axis.set_xlabel(f"$x_1${' [m]' if elastic else ''}")
        axis.set_ylabel(f"$x_2${' [m]' if elastic else ''}")
    return figure


def surface_figure(panels: Mapping[str, Fields]) -> Figure:
    """The solution of a scalar problem as a surface over each grid."""
    figure = new_figure(TWO_COLUMNS, TWO_COLUMNS / max(len(panels), 2))
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
        )
        axis.set(xlabel="$x_1$", ylabel="$x_2$", zlabel="u", title=title, zlim=(low, high))
        axis.view_init(elev=28, azim=-130)
        axis.set_box_aspect(None, zoom=0.85)
    return figure


def _deformed(axis: Axes, field: Fields, magnification: float) -> None:
    """The grid moved by its magnified displacement, over the foundation.

    The initial distance to the foundation is magnified as well, so that what touches is seen to.
    """
    moved = field.nodes + magnification * field.displacement
    axis.triplot(_mesh(moved, field), color=GRID_LINE, linewidth=0.6)
    if field.contact.any():
        ground = field.nodes + magnification * (field.foundation - field.nodes)
        line = ground[:, field.contact]
        line = line[:, np.argsort(line[0])]
        axis.plot(*line, color=FOUNDATION, linewidth=2, label="rigid foundation")
        axis.legend(loc="lower left", bbox_to_anchor=(0, -0.02))
    axis.set_title(f"deformed, displacement x {magnification:g}")
    axis.margins(y=0.25)


def _mesh(nodes: NDArray[np.float64], field: Fields) -> Triangulation:
    return Triangulation(*nodes, triangles=field.triangles.T)


def _magnitude(displacement: NDArray[np.float64]) -> NDArray[np.float64]:
    """The displacement of a scalar problem, or its length."""
    return displacement[0] if displacement.shape[0] == 1 else np.linalg.norm(displacement, axis=0)


def _levels(values: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    low, high = min(map(np.min, values)), max(map(np.max, values))
    return np.linspace(low, high if high > low else low + 1, LEVELS + 1)


def _magnification(fields: list[Fields]) -> float:
    """The largest of 1, 2, 5, 10, ... that keeps displacements small against the body, or less."""
    largest = max(float(np.max(np.abs(field.displacement))) for field in fields)
    extent = float(np.max(np.ptp(fields[0].initial, axis=1)))
    if largest == 0:
        return 1.0
    wanted = LARGEST_DEFORMATION * extent / largest
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= wanted))
