"""Meshes, fields and curves on matplotlib axes: what ``Solution.plot`` and all figures draw with."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.problem import ContactProblem, Place

MAP, GRID_LINE = "viridis", "0.25"
FINE = 10_000  # triangles above which lines are rasterised: as vectors they would fill tens of megabytes
WIDE = 1.6  # width over height of a body from which on its colour bar stands below it
PICTURES = ("mesh", "displacement", "stress", "pressure")


def plot(
    problem: ContactProblem,
    X: Array,
    u: Array,
    pressure: Array,
    what: str,
    axes: Axes | None = None,
    **style: Any,
) -> Axes:
    """Draw one of ``PICTURES`` of a solution and return the axes, those of a new figure if none are given.

    Vertices are at ``X`` (2, vertices); ``u`` (components, nodes) and ``pressure`` (nodes,) are at the nodes
    of the displacement space.
    """
    if what not in PICTURES:
        raise ValueError(f"unknown picture {what!r}: choose from {', '.join(PICTURES)}")
    if what == "pressure" and not problem.contact_sets:
        raise ValueError(f"the problem {problem.name!r} has no contact, and so no pressure")
    if axes is None:
        from matplotlib import pyplot  # the windows that it can open are for this alone

        _, axes = pyplot.subplots(layout="constrained")
    space, scalar = DisplacementSpace.of(problem), problem.components == 1
    nodes, title = space.points(X), "flux" if scalar and what == "stress" else what
    if what == "mesh":
        if np.any(problem.mesh.p != X):
            draw_mesh(axes, problem.mesh.p, problem.triangles, color="0.85", linewidth=0.6)
        draw_mesh(axes, X, problem.triangles, **{"color": "0.2", "linewidth": 0.7, **style})
    elif what == "stress":
        painted = draw_elements(axes, X, problem.triangles, size_of_stress(problem, X, u), **style)
        _bar(axes, painted, X, "|flux|" if scalar else "von Mises stress")
    elif what == "displacement":
        painted = draw_nodal(axes, nodes, space.elements, size_of(u), **style)
        _bar(axes, painted, X, "u" if scalar else "|u|")
    else:
        title = "contact pressure"
        if all(part.obstacle.boundary is not Place.INTERIOR for part in space.contact_sets):
            _plot_pressures(axes, space, nodes, pressure, style)
            return axes
        _bar(axes, draw_nodal(axes, nodes, space.elements, pressure, **style), X, title)
    axes.set(aspect="equal", xlabel="$x_1$", ylabel="$x_2$", title=title)
    return axes


def _plot_pressures(
    axes: Axes, space: DisplacementSpace, nodes: Array, pressure: Array, style: dict[str, Any]
) -> None:
    """The pressure along each contact boundary."""
    along = direction(nodes[:, space.contact_nodes])
    for part in space.contact_sets:
        look = {"marker": "o", "ms": 3, "label": str(part.obstacle.boundary), **style}
        draw_along(axes, nodes, part.nodes, pressure, along, **look)
    if len(space.contact_sets) > 1:
        axes.legend()
    axes.set(xlabel=f"$x_{along + 1}$", ylabel="contact pressure", title="contact pressure")


def _bar(axes: Axes, painted: Any, X: Array, label: str) -> None:
    wide = np.ptp(X[0]) > WIDE * np.ptp(X[1])
    place: dict[str, Any] = (
        {"location": "bottom", "aspect": 30} if wide else {"location": "right", "shrink": 0.8}
    )
    axes.figure.colorbar(painted, ax=axes, label=label, **place)


def size_of(u: Array) -> Array:
    """(nodes,) a scalar displacement itself, or the length of one with two components."""
    return u[0] if u.shape[0] == 1 else np.linalg.norm(u, axis=0)


def size_of_stress(problem: ContactProblem, X: Array, u: Array) -> Array:
    """(elements,) von Mises stress, or the length of the flux of a scalar problem."""
    stress = stresses(problem, X, u)
    return np.linalg.norm(stress, axis=0) if problem.components == 1 else von_mises(stress)


def is_fine(triangles: NDArray[Any]) -> bool:
    """Whether a mesh (3, elements) is too fine for vectors."""
    return bool(triangles.shape[1] > FINE)


def triangulation(nodes: Array, triangles: NDArray[Any]) -> Triangulation:
    """Matplotlib's mesh, of the corners where elements have further nodes."""
    return Triangulation(nodes[0], nodes[1], triangles[:3].T)


def draw_mesh(axis: Axes, nodes: Array, triangles: NDArray[Any], thin: float = 1.0, **options: Any) -> None:
    """The edges of a mesh, with thinner lines on finer meshes."""
    width = thin * float(np.clip(8 / np.sqrt(triangles.shape[1]), 0.08, 0.5))
    pen = {"color": GRID_LINE, "linewidth": width, "rasterized": is_fine(triangles), **options}
    axis.triplot(triangulation(nodes, triangles), **pen)


def draw_nodal(axis: Axes, nodes: Array, triangles: NDArray[Any], values: Array, **options: Any) -> Any:
    """A field (nodes,), smooth and so always rasterised; returned for its colour bar."""
    look = {"cmap": MAP, "shading": "gouraud", "rasterized": True, **options}
    return axis.tripcolor(triangulation(nodes, triangles), values, **look)


def draw_elements(axis: Axes, nodes: Array, triangles: NDArray[Any], values: Array, **options: Any) -> Any:
    """A field (elements,), constant on each; returned for its colour bar."""
    look = {"cmap": MAP, "rasterized": True, **options}
    return axis.tripcolor(triangulation(nodes, triangles), facecolors=values, **look)


def direction(points: Array) -> int:
    """The coordinate along which points (2, n) run."""
    return int(np.argmax(np.ptp(points, axis=1)))


def draw_along(
    axis: Axes, nodes: Array, which: NDArray[np.int64], values: Array, along: int, **pen: Any
) -> None:
    """Values (nodes,) at some of the nodes as a curve over one of their coordinates."""
    ordered = which[np.argsort(nodes[along, which])]
    axis.plot(nodes[along, ordered], values[ordered], **pen)
