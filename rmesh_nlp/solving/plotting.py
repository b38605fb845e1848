"""Meshes, fields and curves on matplotlib axes: what ``Solution.plot`` and all figures draw with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.evaluation import ROUNDING, Array, Index
from rmesh_nlp.fem.sampling import along, edges_of, pieces, sampled
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.fem.stress import size_of_stress
from rmesh_nlp.meshes.curves import fitted_circle
from rmesh_nlp.meshes.geometry import lines_of
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.units import Units, bracketed
from rmesh_nlp.settings import Values

MAP, GRID_LINE = "viridis", "0.25"
FINE = 10_000  # elements above which lines are rasterised: as vectors they would fill tens of megabytes
WIDE = 1.6  # width over height of a body from which on its colour bar stands below it
STRAIGHT, FEWEST = 1e-4, 5  # deviation from a line or a circle, over the extent; points that tell a circle
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
    space, scalar, units = DisplacementSpace(problem), problem.components == 1, problem.units
    nodes, cells = space.points_on_body(X), space.elements
    length, stress = bracketed(units.length), bracketed("" if scalar else units.stress)
    title = "flux" if scalar and what == "stress" else what
    if what == "mesh":
        if np.any(problem.mesh.p != X):
            given = space.points_on_body(problem.mesh.p)
            draw_mesh(axes, given, cells, color="0.85", linewidth=0.6)
        draw_mesh(axes, nodes, cells, **{"color": "0.2", "linewidth": 0.7, **style})
    elif what == "stress":
        painted = draw_elements(axes, nodes, cells, size_of_stress(problem, X, u), **style)
        _bar(axes, painted, X, "|flux|" if scalar else f"von Mises stress{stress}")
    elif what == "displacement":
        painted = draw_nodal(axes, nodes, cells, u, **style)
        _bar(axes, painted, X, "$u$" if scalar else f"$|u|${length}")
    else:
        title = "contact pressure"
        if all(part.obstacle.boundary is not Place.INTERIOR for part in space.contact_sets):
            _plot_pressures(axes, space, nodes, pressure, style)
            axes.set(ylabel=f"{title}{stress}", title=title)
            return axes
        _bar(axes, draw_nodal(axes, nodes, cells, pressure, **style), X, title)
    axes.set(aspect="equal", xlabel=units.axes[0], ylabel=units.axes[1], title=title)
    return axes


def _plot_pressures(
    axes: Axes, space: DisplacementSpace, nodes: Array, pressure: Array, style: Values
) -> None:
    """The pressure along each contact boundary."""
    names = dict[str, None]()
    for part in space.contact_sets:
        edges = contact_edges(space.problem, part.obstacle)
        lines = lines_of(edges[:, np.any(np.isin(edges, part.nodes), axis=0)], nodes)
        name, over = course(nodes[:, np.concatenate(lines)], space.problem.units)
        names[name] = None
        look = {"marker": "o", "ms": 3, "label": part.obstacle.place, **style}
        draw_along(axes, nodes, lines, pressure, over, **look)
    if len(space.contact_sets) > 1:
        axes.legend()
    axes.set(xlabel=" or ".join(names))


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


def course(points: Array, units: Units) -> tuple[str, Callable[[Array], Array]]:
    """Over what values along a boundary are drawn: its name, and it at points (2, n) in their order.

    The coordinate where ``points`` are parallel to an axis, the angle where they are on an arc, else the arc
    length; in the unit of length.
    """
    extent, unit = np.ptp(points, axis=1), bracketed(units.length)
    if np.min(extent) <= STRAIGHT * np.max(extent):
        k = np.argmax(extent)
        return units.axes[k], lambda line: line[k]
    with suppress(BadInputError):  # too few points, or a line
        circle, size = fitted_circle(points), max(extent)
        centre = np.array(circle.centre)[:, None]
        off = np.ptp(np.hypot(*(points - centre)))
        if points.shape[1] >= FEWEST and off <= STRAIGHT * size and circle.radius <= 2 * size:
            x, y = np.round(centre[:, 0] / size, 4) * size + 0.0
            return f"angle about ({x:.3g}, {y:.3g}) [°]", lambda line: _angles(line - centre)
    x, y = points[:, 0]
    return f"arc length from ({x:.3g}, {y:.3g}){unit}", _lengths


def _lengths(line: Array) -> Array:
    return np.cumsum(np.append(0.0, np.hypot(*np.diff(line))))


def _angles(arms: Array) -> Array:
    """Angles of arms (2, n) without jumps, from -180 degrees on."""
    angles = np.degrees(np.unwrap(np.arctan2(*arms[::-1])))
    return angles - 360 * np.floor((np.min(angles) + 180) / 360 + ROUNDING)


def draw_along(
    axis: Axes,
    nodes: Array,
    lines: Sequence[Index],
    values: Array,
    over: Callable[[Array], Array],
    **pen: Any,
) -> None:
    """Values (nodes,), linear along lines, each by its nodes in their order, over a :func:`course`."""
    line = np.concatenate(lines)
    breaks = np.cumsum([each.size for each in lines])[:-1]
    axis.plot(*(np.insert(each, breaks, np.nan) for each in (over(nodes[:, line]), values[line])), **pen)
