"""The solution of a scalar problem as a surface over its grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import along, edges_of, pieces
from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.report.style import TWO_COLUMNS, new_figure
from rmesh_nlp.solving import plotting
from rmesh_nlp.solving.plotting import GRID_LINE, MAP

VIEW, BOX = (28, -130), (4, 4, 2.4)  # elevation and azimuth of the eye, shape of the box of the axes
NEARER = 0.1  # in the units of the box, by so much edges are nearer to the eye than their surface


def surface_figure(panels: Mapping[str, Fields]) -> Figure:
    """The solution of a scalar problem as a surface over each grid."""
    figure = new_figure(TWO_COLUMNS, 2.9)
    low = min(float(field.displacement.min()) for field in panels.values())
    high = max(float(field.displacement.max()) for field in panels.values())
    for column, (title, field) in enumerate(panels.items(), 1):
        axis = figure.add_subplot(1, len(panels), column, projection="3d")
        parts = pieces(field.triangles, field.nodes.shape[1])
        surface = axis.plot_trisurf(
            plotting.triangulation(field.nodes, parts),
            parts(field.displacement[0]),
            **{"cmap": MAP, "vmin": low, "vmax": high, "edgecolor": GRID_LINE, "linewidth": 0.3},
            **{"shade": False, "rasterized": plotting.is_fine(parts.triangles)},
        )
        if parts.triangles.shape[1] > field.triangles.shape[1]:
            corners = parts(np.vstack([field.nodes, field.displacement]))[:, parts.triangles]
            _draw_edges(axis, surface, corners.transpose(2, 1, 0), field)
        axis.set(xlabel="$x_1$", ylabel="$x_2$", zlim=(low, high))
        axis.set_title(f"u, {title}", y=0.98)
        axis.view_init(*VIEW)
        axis.set_box_aspect(BOX, zoom=1.0)
    return figure


def _draw_edges(axis: Any, surface: Any, corners: Array, field: Fields) -> None:
    """The edges of the mesh on a surface, in the place of those of its pieces.

    They are flat polygons among those of the surface, drawn from the farthest to the nearest. So they are
    nearer to the eye by more than a piece is long.
    """
    lines = along(edges_of(field.triangles), np.vstack([field.nodes, field.displacement]))
    high, round_ = np.deg2rad(VIEW)
    eye = np.array([np.cos(high) * np.cos(round_), np.cos(high) * np.sin(round_), np.sin(high)])
    lines += (NEARER * eye / BOX * np.ptp(corners, axis=(0, 1)))[:, None, None]
    pairs = np.stack([lines[:, :, :-1], lines[:, :, 1:]]).reshape(2, 3, -1).transpose(2, 0, 1)
    colours = surface.cmap(surface.norm(surface.get_array()))
    faces = np.vstack([colours, np.zeros((len(pairs), 4))])
    edges = np.vstack([colours, np.tile(to_rgba(GRID_LINE), (len(pairs), 1))])
    surface.remove()
    limits = axis.get_w_lims()
    pen: dict[str, Any] = {"linewidths": 0.4, "rasterized": surface.get_rasterized()}
    polygons = np.concatenate([corners, pairs[:, [0, 1, 1]]])
    axis.add_collection3d(Poly3DCollection(polygons, facecolors=faces, edgecolors=edges, **pen))
    axis.set(xlim=limits[:2], ylim=limits[2:4])
