"""Meshes, fields and curves on matplotlib axes: what ``Solution.plot`` and all figures draw with."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.sampling import ALONG, along, edges_of, pieces, points_of, sampled
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.fem.stress import size_of_stress
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.settings import Values

MAP, GRID_LINE = "viridis", "0.25"
FINE = 10_000  # elements above which lines are rasterised: as vectors they would fill tens of megabytes
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
        raise unknown("picture", what, PICTURES)
    if what == "pressure" and not problem.contact_sets:
        raise BadInputError(f"the problem {problem.name!r} has no contact, and so no pressure")
    if axes is None:
        from matplotlib import pyplot  # the windows that it can open are for this alone

        _, axes = pyplot.subplots(layout="constrained")
    space, scalar = DisplacementSpace(problem), problem.components == 1
    nodes, cells = points_of(space, X), space.elements
    title = "flux" if scalar and what == "stress" else what
    if what == "mesh":
        if np.any(problem.mesh.p != X):
            given = points_of(space, problem.mesh.p)
            draw_mesh(axes, given, cells, color="0.85", linewidth=0.6)
        draw_mesh(axes, nodes, cells, **{"color": "0.2", "linewidth": 0.7, **style})
    elif what == "stress":
        painted = draw_elements(axes, nodes, cells, size_of_stress(problem, X, u), **style)
        _bar(axes, painted, X, "|flux|" if scalar else "von Mises stress")
    elif what == "displacement":
        painted = draw_nodal(axes, nodes, cells, u, **style)
        _bar(axes, painted, X, "$u$" if scalar else "$|u|$")
    else:
        title = "contact pressure"
        if all(part.obstacle.boundary is not Place.INTERIOR for part in space.contact_sets):
            _plot_pressures(axes, space, nodes, pressure, style)
            return axes
        _bar(axes, draw_nodal(axes, nodes, cells, pressure, **style), X, title)
    axes.set(aspect="equal", xlabel="$x_1$", ylabel="$x_2$", title=title)
    return axes


def _plot_pressures(
    axes: Axes, space: DisplacementSpace, nodes: Array, pressure: Array, style: Values
) -> None:
    """The pressure along each contact boundary."""
    coordinate = direction(nodes[:, space.contact_nodes])
    for part in space.contact_sets:
        look = {"marker": "o", "ms": 3, "label": str(part.obstacle.boundary), **style}
        edges = space.nodes_of(contact_edges(space.problem, part.obstacle))
        draw_along(axes, nodes, (part.nodes, edges), pressure, coordinate, **look)
    if len(space.contact_sets) > 1:
        axes.legend()
    axes.set(xlabel=f"$x_{coordinate + 1}$", ylabel="contact pressure", title="contact pressure")


def _bar(axes: Axes, painted: Any, X: Array, label: str) -> None:
    wide = np.ptp(X[0]) > WIDE * np.ptp(X[1])
    place: Values = {"location": "bottom", "aspect": 30} if wide else {"location": "right", "shrink": 0.8}
    axes.figure.colorbar(painted, ax=axes, label=label, **place)


def share_colours(painted: list[Any]) -> None:
    """One range of values for all of them."""
    limits = np.array([each.get_clim() for each in painted])
    for each in painted:
        each.set_clim(limits[:, 0].min(), limits[:, 1].max())


def size_of(u: Array) -> Array:
    """(nodes,) a scalar displacement itself, or the length of one with two components."""
    return u[0] if u.shape[0] == 1 else np.linalg.norm(u, axis=0)


def is_fine(triangles: NDArray) -> bool:
    """Whether a mesh (nodes per element, elements) is too fine for vectors."""
    return bool(triangles.shape[1] > FINE)


def triangulation(nodes: Array, cells: NDArray) -> Triangulation:
    """Matplotlib's mesh of the pieces of a mesh with its nodes at (2, nodes), cell by cell."""
    cut = pieces(cells)
    x, y = sampled(cells, nodes, cut.shares).reshape(2, -1)
    first = cut.shares.shape[1] * np.arange(cells.shape[1])
    return Triangulation(x, y, (first[:, None] + cut.triangles[:, None]).reshape(3, -1).T)


def draw_mesh(axis: Axes, nodes: Array, cells: NDArray, **options: Any) -> None:
    """The edges of a mesh, with thinner lines on finer meshes; those with a node in the middle are bent."""
    width = float(np.clip(8 / np.sqrt(cells.shape[1]), 0.08, 0.5))
    pen = {"color": GRID_LINE, "linewidth": width, "rasterized": is_fine(cells), **options}
    lines = along(edges_of(cells), nodes)
    axis.plot(*np.pad(lines, ((0, 0), (0, 0), (0, 1)), constant_values=np.nan).reshape(2, -1), **pen)


def draw_nodal(axis: Axes, nodes: Array, cells: NDArray, values: Array, **options: Any) -> Any:
    """The size of a field (nodes,) or (components, nodes), smooth and so always rasterised.

    Returned for its colour bar.
    """
    look = {"cmap": MAP, "shading": "gouraud", "rasterized": True, **options}
    at_points = sampled(cells, np.atleast_2d(values), pieces(cells).shares)
    return axis.tripcolor(triangulation(nodes, cells), size_of(at_points).ravel(), **look)


def draw_elements(axis: Axes, nodes: Array, cells: NDArray, values: Array, **options: Any) -> Any:
    """A field (elements,) or (elements, pieces), constant on each; returned for its colour bar."""
    look = {"cmap": MAP, "rasterized": True, **options}
    each = pieces(cells).triangles.shape[1]
    of_pieces = np.broadcast_to(values.reshape(len(values), -1), (len(values), each)).ravel()
    return axis.tripcolor(triangulation(nodes, cells), facecolors=of_pieces, **look)


def direction(points: Array) -> int:
    """The coordinate along which points (2, n) run."""
    return int(np.argmax(np.ptp(points, axis=1)))


def draw_along(
    axis: Axes,
    nodes: Array,
    where: tuple[Index, Index],
    values: Array,
    coordinate: int,
    **pen: Any,
) -> None:
    """Values (nodes,) along a part of the boundary as a curve over one coordinate, with marks at its nodes.

    ``where`` are its nodes and the nodes (2 or 3, edges) of edges. Along an edge whose nodes are all there
    the curve is the polynomial through them, cut off at the largest and the least of their values: a pressure
    is nowhere negative, and friction within its bound.
    """
    which, edges = where
    whole = edges[:, np.all(np.isin(edges, which), axis=0)]
    parts, degree = ALONG[len(edges)], len(edges) - 1
    inside = [k for k in range(parts + 1) if k * degree % parts]  # between the nodes
    at_nodes, curve, places = values[whole], along(whole, values), along(whole, nodes[coordinate])
    curve = np.clip(curve.T, at_nodes.min(axis=0), at_nodes.max(axis=0)).T
    x = np.concatenate([nodes[coordinate, which], places[:, inside].ravel()])
    y = np.concatenate([values[which], curve[:, inside].ravel()])
    order = np.argsort(x)
    axis.plot(x[order], y[order], **{"markevery": np.flatnonzero(order < which.size).tolist(), **pen})
