"""Quick pictures of a solution on matplotlib axes, for notebooks and scripts.

The figures for print are made by :mod:`rmesh_nlp.report` from files.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.problem import ContactProblem, Place

MAP = "viridis"

WIDE = 1.6
"""Ratio of width to height from which on the colour bar stands below the body."""


class Drawn(Protocol):
    """What is drawn: a solution. ``displacement`` is (components, nodes), ``pressure`` (nodes,)."""

    @property
    def problem(self) -> ContactProblem:
        """The problem on the mesh as given."""

    @property
    def mesh(self) -> MeshTri:
        """The relocated mesh."""

    @property
    def displacement(self) -> Array:
        """In units of length."""

    @property
    def pressure(self) -> Array:
        """Of the contact."""


def plot(drawn: Drawn, what: str, axes: Axes | None = None, **style: Any) -> Axes:
    """Draw one of ``PICTURES`` and return the axes, those of a new figure if none are given.

    Raises
    ------
    ValueError
        If ``what`` is not a picture.
    """
    if what not in PICTURES:
        raise ValueError(f"unknown picture {what!r}: choose from {', '.join(PICTURES)}")
    if axes is None:
        _, axes = pyplot.subplots(layout="constrained")
    PICTURES[what](axes, drawn, style)
    return axes


def _mesh(axes: Axes, drawn: Drawn, style: dict[str, Any]) -> None:
    """The given mesh in light grey below the relocated one."""
    initial = drawn.problem.mesh.p
    triangles = drawn.problem.triangles.T
    if np.any(initial != drawn.mesh.p):
        axes.triplot(*initial, triangles, color="0.85", linewidth=0.6)
    axes.triplot(*drawn.mesh.p, triangles, **{"color": "0.2", "linewidth": 0.7, **style})
    _in_plane(axes, "mesh")


def _displacement(axes: Axes, drawn: Drawn, style: dict[str, Any]) -> None:
    u = drawn.displacement
    scalar = u.shape[0] == 1
    values = u[0] if scalar else np.linalg.norm(u, axis=0)
    _coloured(axes, drawn, values, {"shading": "gouraud", **style}, "u" if scalar else "|u|")
    _in_plane(axes, "displacement")


def _stress(axes: Axes, drawn: Drawn, style: dict[str, Any]) -> None:
    """Von Mises stress, or the size of the flux of a scalar problem, constant on each element."""
    stress = stresses(drawn.problem, drawn.mesh.p, drawn.displacement)
    scalar = drawn.problem.components == 1
    values = np.linalg.norm(stress, axis=0) if scalar else von_mises(stress)
    _coloured(axes, drawn, values, style, "|flux|" if scalar else "von Mises stress")
    _in_plane(axes, "flux" if scalar else "stress")


def _pressure(axes: Axes, drawn: Drawn, style: dict[str, Any]) -> None:
    """Along the contact boundary; over the plane for an obstacle in the interior."""
    sets = drawn.problem.contact_sets
    if not sets:
        raise ValueError(f"the problem {drawn.problem.name!r} has no contact, and so no pressure")
    if any(part.obstacle.boundary is Place.INTERIOR for part in sets):
        _coloured(axes, drawn, drawn.pressure, {"shading": "gouraud", **style}, "contact pressure")
        _in_plane(axes, "contact pressure")
        return
    direction = _along(drawn.mesh.p[:, drawn.problem.contact_nodes])
    for part in sets:
        ordered = part.nodes[np.argsort(drawn.mesh.p[direction, part.nodes])]
        look = {"marker": "o", "ms": 3, "label": str(part.obstacle.boundary), **style}
        axes.plot(drawn.mesh.p[direction, ordered], drawn.pressure[ordered], **look)
    if len(sets) > 1:
        axes.legend()
    axes.set(xlabel=f"$x_{direction + 1}$", ylabel="contact pressure", title="contact pressure")


PICTURES = {"mesh": _mesh, "displacement": _displacement, "stress": _stress, "pressure": _pressure}
"""What can be drawn, by name."""


def _along(points: Array) -> int:
    """The coordinate along which the points run."""
    return int(np.argmax(np.ptp(points, axis=1)))


def _coloured(axes: Axes, drawn: Drawn, values: Array, style: dict[str, Any], label: str) -> None:
    """Values at nodes or of elements as colours, with their bar."""
    x, y = drawn.mesh.p
    painted = axes.tripcolor(x, y, values, **{"triangles": drawn.problem.triangles.T, "cmap": MAP, **style})
    wide = np.ptp(x) > WIDE * np.ptp(y)
    place: dict[str, Any] = (
        {"location": "bottom", "aspect": 30} if wide else {"location": "right", "shrink": 0.8}
    )
    axes.figure.colorbar(painted, ax=axes, label=label, **place)


def _in_plane(axes: Axes, title: str) -> None:
    axes.set(aspect="equal", xlabel="$x_1$", ylabel="$x_2$", title=title)
