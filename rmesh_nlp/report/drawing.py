"""Bodies over rigid foundations, side by side, and what contact carries.

All pictures of meshes draw what a :class:`DrawnBody` holds, by :func:`side_by_side` and
:func:`contact_figure`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from rmesh_nlp.evaluation import Array, Index, largest_side, magnitude
from rmesh_nlp.fem.sampling import along, edges_of
from rmesh_nlp.io.vtu import MeshState
from rmesh_nlp.meshes.geometry import lines_of
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.style import FOUNDATION, IN_CONTACT, Page, add_legend, new_figure, pen_of
from rmesh_nlp.solving import plotting

Painter = Callable[[Axes, "DrawnBody"], Any]
"""Draws a body; returns what a colour bar is made of, or None."""

# parts of the extent of the body
REACH = 0.3  # foundations are drawn up to this far outside the body, and not at all where they are farther
LARGEST_DEFORMATION = 0.08  # displacements are magnified up to this
SEEN = 0.003  # about the width of a line
MARGIN = 0.02  # stays free around everything


@dataclass(frozen=True, eq=False)
class Contact:
    """A contact boundary: its name, nodes that may meet a foundation, and ``along`` it lines of nodes.

    Points ``starts`` (2, edges, points) of its edges would meet ``lines`` of a foundation that ``is_rigid``,
    or the other side of a pair.
    """

    name: str
    nodes: Index
    along: list[Index]
    starts: Array
    lines: Array
    is_rigid: bool

    def displaced(self, factor: float) -> Array:
        """The foundation (2, edges, points) beside a body whose displacement is drawn ``factor`` times."""
        return self.lines + (factor - 1) * self.ways.mean(axis=1)[:, None, None]

    @property
    def ways(self) -> Array:
        """(2, points) from the contact boundary to the foundation."""
        return (self.lines - self.starts).reshape(2, -1)

    @property
    def distance(self) -> float:
        """The least one between them; infinite without edges."""
        return float(np.min(np.linalg.norm(self.ways, axis=0), initial=np.inf))


@dataclass(frozen=True)
class DrawnBody:
    """A body on one mesh (nodes per element, elements) with the title of its pictures."""

    title: str
    triangles: Index
    state: MeshState

    @property
    def nodes(self) -> Array:
        """(2, nodes) positions."""
        return self.state.nodes

    @property
    def elastic(self) -> bool:
        """Whether the displacement has two components."""
        return self.state.displacement.shape[0] == 2

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The contact boundaries; none for an obstacle in the interior."""
        outer, found = edges_of(self.triangles, outer=True), []
        _, place, times = np.unique(self.nodes, axis=1, return_inverse=True, return_counts=True)
        doubled = times[place.ravel()] > 1
        for name, feet in self.state.feet.items():
            on = np.isfinite(feet[0])
            edges = outer[:, np.all(on[outer], axis=0)]
            lines = along(edges, self.nodes), along(edges, feet)
            meets = on & np.isfinite(self.state.gap)  # not those that are given
            paths = lines_of(edges[:2, np.any(meets[edges], axis=0)], self.nodes)
            is_rigid = not np.all(doubled[meets])  # two nodes at one place are a pair
            found.append(Contact(name, np.flatnonzero(meets), paths, *lines, is_rigid))
        return tuple(found)

    @property
    def near(self) -> list[Contact]:
        """Those whose foundations are drawn: none for scalar problems."""
        reach = REACH * largest_side(self.nodes)
        rigid = (one for one in self.contacts if self.elastic and one.is_rigid)
        return [one for one in rigid if one.distance <= reach]

    @property
    def closed(self) -> Index:
        """Numbers of the elements in contact with an obstacle in the interior: all of their nodes touch."""
        touching = self.state.gap <= ZERO * magnitude(self.state.displacement)
        return np.flatnonzero(np.all(touching[self.triangles], axis=0) & (not self.contacts))

    def moved(self, factor: float) -> Array:
        """The nodes (2, nodes) after ``factor`` times the displacement."""
        return self.nodes + factor * self.state.displacement if self.elastic else self.nodes


def magnification(bodies: Sequence[DrawnBody]) -> float:
    """The factor by which displacements are drawn: the largest of 1, 2, 5, 10, ... that pictures allow.

    A foundation is drawn as the curve that it is in space. Where the displacement is drawn ``f`` times as
    large, a node that touches, ``u = w``, is drawn at ``X + f w``, beside its place ``X + w`` on the
    foundation by ``(f - 1) w``. If ``w`` is the same for the whole boundary, the foundation is drawn
    displaced by that (:meth:`Contact.displaced`), and touching nodes touch it. If the gap varies by more
    than ``SEEN`` there is no such place, and displacements are drawn as they are.
    """
    extent = largest_side(bodies[0].nodes)
    largest = max(magnitude(body.state.displacement) for body in bodies)
    ways = [one.ways.T for body in bodies for one in body.near]
    varies = max((magnitude(way - way.mean(axis=0)) for way in ways), default=0.0)
    wanted = (step * 10.0**decade for decade in range(12 if largest else 0) for step in (1, 2, 5))
    shown = (f for f in wanted if f * largest <= LARGEST_DEFORMATION * extent)
    return max((f for f in shown if (f - 1) * varies <= SEEN * extent), default=1.0)


def window(bodies: Sequence[DrawnBody], factor: float = 0.0) -> Array:
    """Limits (2, 2) around the bodies; of ``factor`` times the displacement, and around near foundations."""
    points = np.hstack([body.moved(f) for body in bodies for f in {0.0, factor}])
    low, high = points.min(axis=1), points.max(axis=1)
    reach = REACH * np.max(high - low)
    for one in (one for body in bodies for one in body.near if factor):
        lines = one.displaced(factor).reshape(2, -1)
        low = np.minimum(low, np.maximum(lines.min(axis=1), low - reach))
        high = np.maximum(high, np.minimum(lines.max(axis=1), high + reach))
    extra = MARGIN * np.max(high - low)
    return np.stack([low - extra, high + extra], axis=1)


def draw_lines(axis: Axes, points: Array, **options: Any) -> None:
    """Lines through points (2, lines, points)."""
    axis.add_collection(LineCollection(list(points.transpose(1, 2, 0)), **options))


def draw_nodes(axis: Axes, nodes: Array, kinds: Iterable[tuple[Any, ...]], **options: Any) -> None:
    """Nodes (2, nodes) with a look for each kind: which they are, label, colour and marker."""
    for chosen, label, colour, marker in kinds:
        if np.any(chosen):
            look = {"c": colour, "marker": marker, "label": label, **options}
            axis.scatter(nodes[0, chosen], nodes[1, chosen], **look)


def draw_foundations(axis: Axes, body: DrawnBody, factor: float = 1.0, **options: Any) -> None:
    """The near foundations beside a body whose displacement is drawn ``factor`` times as large."""
    for one in body.near:
        look = {"color": FOUNDATION, "capstyle": "round", "label": "rigid foundation", **options}
        draw_lines(axis, one.displaced(factor), **look)


def draw_contact_set(axis: Axes, body: DrawnBody, **fill: Any) -> None:
    """Of an obstacle in the interior: the edge of the set that it touches, and with a colour the set."""
    closed = body.triangles[:, body.closed]
    if closed.size:
        if fill:
            corners = list(body.nodes[:, closed[:3]].transpose(2, 1, 0))
            axis.add_collection(PolyCollection(corners, edgecolor="none", label="in contact", **fill))
        draw_lines(axis, along(edges_of(closed, outer=True), body.nodes), color=IN_CONTACT, linewidth=1.2)


def coloured(draw: Callable[..., Any], values: Callable[[DrawnBody], Array], **options: Any) -> Painter:
    """A painter of values as colours below the lines of the mesh; ``draw`` knows where they belong."""

    def paint(axis: Axes, body: DrawnBody) -> Any:
        painted = draw(axis, body.nodes, body.triangles, values(body), **options)
        if not plotting.is_fine(body.triangles):  # the lines would hide the colours
            plotting.draw_mesh(axis, body.nodes, body.triangles, color="white")
        draw_contact_set(axis, body)
        return painted

    return paint


def side_by_side(
    bodies: Sequence[DrawnBody],
    paint: Painter,
    page: Page,
    *,
    deformed: bool = False,
    label: str = "",
    title: str = "",
) -> Figure:
    """What ``paint`` draws of each body, and if asked for the ``deformed`` meshes below, over foundations.

    Colours have one scale, and a bar with the ``label``. A ``title`` takes the
    place of those of the bodies.
    """
    factor = magnification(bodies) if deformed else 0.0
    windows = [window(bodies, 1.0), window(bodies, factor)] if deformed else [window(bodies)]
    figure, axes = page.panels(len(bodies), windows, below=0.85 if title else 0.75 if label else 0.45)
    painted: list[Any] = []
    for column, body in zip(axes.T, bodies, strict=True):
        painted.append(paint(column[0], body))
        column[0].set_title(title or body.title)
        if deformed:
            draw_foundations(column[0], body, linewidth=4.0)  # a boundary may lie on it
            plotting.draw_mesh(column[1], body.moved(factor), body.triangles)
            draw_foundations(column[1], body, factor, linewidth=2.2)
            paired = any(not one.is_rigid for one in body.contacts)
            with_u = " with its jump at pairs" if paired else " and gap"
            scale = f", $u${with_u} × {factor:g}" if factor > 1 else ", true scale"
            column[1].set_title(f"deformed{scale}")
    if label:
        plotting.share_colours(painted)
        bar: dict[str, Any] = {"location": "bottom", "aspect": 40, "shrink": 0.8}
        figure.colorbar(painted[-1], ax=axes[-1].tolist(), label=label, **bar)
    add_legend(figure, list(axes[:, 0]), "outside lower center")
    return figure


def displacement_figure(bodies: Sequence[DrawnBody], page: Page, *, deformed: bool) -> Figure:
    """The displacement of each body, if asked for over the deformed meshes."""
    label = f"$|u|${bracketed(page.units.length)}" if bodies[0].elastic else "$u$"
    paint = coloured(plotting.draw_nodal, lambda body: body.state.displacement)
    return side_by_side(bodies, paint, page, deformed=deformed, label=label)


def contact_figure(bodies: Sequence[DrawnBody], page: Page) -> Figure | None:
    """Pressure along each contact boundary, with friction also the tangential stress and its bound.

    One panel for each; None if nothing is touched.
    """
    unit = bracketed(page.units.stress) if bodies[0].elastic else ""
    kinds = {"pressure": f"contact {'pressure' if bodies[0].elastic else 'stress'}{unit}"}
    if any(np.any(body.state.friction_bound > 0) for body in bodies):
        kinds["tangential_stress"] = f"tangential stress{unit}"
    panels = [
        (place, name)
        for place in range(len(bodies[0].contacts))
        if any(np.any(body.state.pressure[body.contacts[place].nodes]) for body in bodies)
        for name in kinds
    ]
    if not panels:
        return None
    figure = new_figure(page.width, 0.3 + (1.7 if page.columns == 1 else 2.3) * len(panels))
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    first = bodies[0]
    for axis, (place, name) in zip(axes, panels, strict=True):
        curves = [(body, getattr(body.state, name), pen_of(i), body.title) for i, body in enumerate(bodies)]
        if name == "tangential_stress":
            bound: Any = {"color": "0.5", "linewidth": 0.9, "linestyle": (0, (6, 2))}
            ends = first.state.friction_bound, -first.state.friction_bound
            curves += [(first, values, bound, "friction bound ±g") for values in ends]
        points = first.nodes[:, np.concatenate(first.contacts[place].along)]
        where, over = plotting.course(points, page.units)
        for body, values, look, title in curves:
            lines = body.contacts[place].along
            plotting.draw_along(axis, body.nodes, lines, values, over, **look, label=title)
        axis.set(xlabel=f"{where} on {first.contacts[place].name}", ylabel=kinds[name])
        axis.update_datalim([(axis.dataLim.x0, 0.0)])  # a uniform pressure is seen as such
        axis.autoscale_view()
    add_legend(figure, list(axes))
    return figure
