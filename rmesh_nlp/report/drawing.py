"""Bodies over rigid foundations: how far displacements are magnified, and where the foundation then is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import along
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.report.style import FOUNDATION
from rmesh_nlp.solving.plotting import draw_mesh

PARTS = 8  # of a foundation below one contact edge

# parts of the extent of the body
FAR = 1.0  # a foundation farther away than this is not drawn
LARGEST_DEFORMATION = 0.08  # displacements are magnified up to this
SEEN = 0.003  # about the width of a line
ROOM = 0.15  # a foundation is drawn up to this far outside the body
MARGIN = 0.02  # stays free around everything


@dataclass(frozen=True)
class Foundation:
    """What one contact boundary may meet.

    ``nodes`` (2, contact nodes) would meet ``feet`` after ``gaps``, negative where the foundation overlaps
    the body; points ``starts`` (2, edges, points) of the contact edges would meet ``lines``.
    """

    name: str
    gaps: Array
    nodes: Array
    feet: Array
    starts: Array
    lines: Array
    is_far: bool

    def displaced(self, factor: float) -> Array:
        """The foundation (2, edges, points) beside a body whose displacement is drawn ``factor`` times."""
        return self.lines + (factor - 1) * self.ways.mean(axis=1)[:, None, None]

    @property
    def ways(self) -> Array:
        """(2, points) from the contact boundary to the foundation."""
        return (self.lines - self.starts).reshape(2, -1)


@dataclass(frozen=True)
class Body:
    """A body on one mesh; scalar problems have no foundations.

    Nodes (2, nodes), triangles (nodes per element, elements), displacement (components, nodes).
    """

    nodes: Array
    triangles: NDArray[np.int64]
    displacement: Array
    foundations: tuple[Foundation, ...]

    @property
    def elastic(self) -> bool:
        """Whether the displacement has two components."""
        return self.displacement.shape[0] == 2

    @property
    def near(self) -> list[Foundation]:
        """The foundations that are drawn."""
        return [one for one in self.foundations if not one.is_far]

    def moved(self, factor: float) -> Array:
        """The nodes (2, nodes) after ``factor`` times the displacement."""
        return self.nodes + factor * self.displacement if self.elastic else self.nodes


def foundations(space: DisplacementSpace, nodes: Array) -> tuple[Foundation, ...]:
    """The foundations for nodes at (2, nodes); none for scalar problems."""
    parts = []
    for part in space.contact_sets if space.problem.components == 2 else ():
        edges, here = space.nodes_of(contact_edges(space.problem, part.obstacle)), nodes[:, part.nodes]
        starts = along(edges, nodes, PARTS)
        lines = part.obstacle.feet(starts.reshape(2, -1)).reshape(starts.shape)
        gaps, feet = part.obstacle.distances(here), part.obstacle.feet(here)
        name, far = str(part.obstacle.boundary), _is_far(gaps, nodes)
        parts.append(Foundation(name, gaps, here, feet, starts, lines, far))
    return tuple(parts)


def body_of(fields: Fields) -> Body:
    """The body that a file holds: its foundations are joined in one, known at the contact nodes."""
    nodes, feet = (points[:, fields.contact] for points in (fields.nodes, fields.foundation))
    parts: tuple[Foundation, ...] = ()
    if fields.displacement.shape[0] == 2 and nodes.size:
        gaps = np.linalg.norm(feet - nodes, axis=0)
        edges = fields.boundary
        edges = edges[:, np.all(fields.contact[edges], axis=0)]
        starts, lines = along(edges, fields.nodes), along(edges, fields.foundation)
        parts = (Foundation("", gaps, nodes, feet, starts, lines, _is_far(gaps, fields.initial)),)
    return Body(fields.nodes, fields.triangles, fields.displacement, parts)


def _is_far(gaps: Array, nodes: Array) -> bool:
    return bool(np.min(np.abs(gaps)) > FAR * np.max(np.ptp(nodes, axis=1)))


def magnification(bodies: Sequence[Body]) -> float:
    """The factor by which displacements are drawn: the largest of 1, 2, 5, 10, ... that pictures allow.

    A foundation is drawn as the curve that it is in space. Where the displacement is drawn ``f`` times as
    large, a node that touches, ``u = w``, is drawn at ``X + f w``, beside its place ``X + w`` on the
    foundation by ``(f - 1) w``. If ``w`` is the same for the whole boundary, the foundation is drawn
    displaced by that (:meth:`Foundation.displaced`), and touching nodes touch it. If the gap varies by more
    than ``SEEN`` there is no such place, and displacements are drawn as they are.
    """
    extent = float(np.max(np.ptp(bodies[0].nodes, axis=1)))
    largest = max(float(np.max(np.abs(body.displacement))) for body in bodies)
    ways = [one.ways.T for body in bodies for one in body.near if one.lines.size]
    varies = max((float(np.max(np.abs(way - way.mean(axis=0)))) for way in ways), default=0.0)
    wanted = (step * 10.0**decade for decade in range(12 if largest else 0) for step in (1, 2, 5))
    shown = (f for f in wanted if f * largest <= LARGEST_DEFORMATION * extent)
    return max((f for f in shown if (f - 1) * varies <= SEEN * extent), default=1.0)


def draw_lines(axis: Axes, points: Array, **options: Any) -> None:
    """Lines through points (2, lines, points)."""
    axis.add_collection(LineCollection(list(points.transpose(1, 2, 0)), **options))


def draw_foundations(axis: Axes, body: Body, factor: float = 1.0, **options: Any) -> None:
    """The near foundations beside a body whose displacement is drawn ``factor`` times as large."""
    for one in body.near:
        look = {"color": FOUNDATION, "capstyle": "round", "label": "rigid foundation", **options}
        draw_lines(axis, one.displaced(factor), **look)


def draw_deformed(axis: Axes, body: Body, factor: float) -> None:
    """The mesh moved by its magnified displacement, over its foundations."""
    draw_mesh(axis, body.moved(factor), body.triangles)
    draw_foundations(axis, body, factor, linewidth=2.2)
    axis.set_title(f"deformed, u and gap × {factor:g}" if factor > 1 else "deformed, true scale")


def window(bodies: Sequence[Body], factor: float = 0.0) -> Array:
    """Limits (2, 2) around the bodies; of ``factor`` times the displacement, and around near foundations."""
    points = np.hstack([body.moved(f) for body in bodies for f in {0.0, factor}])
    low, high = points.min(axis=1), points.max(axis=1)
    room = ROOM * float(np.max(high - low))
    for one in (one for body in bodies for one in body.near if factor):
        lines = one.displaced(factor).reshape(2, -1)
        low = np.minimum(low, np.maximum(lines.min(axis=1), low - room))
        high = np.maximum(high, np.minimum(lines.max(axis=1), high + room))
    extra = MARGIN * float(np.max(high - low))
    return np.stack([low - extra, high + extra], axis=1)


def colour_bar(figure: Figure, painted: Any, axes: list[Axes], ticks: int, **options: Any) -> None:
    """A colour bar for all axes with about so many ticks."""
    bar = figure.colorbar(painted, ax=axes, **options)
    bar.locator = MaxNLocator(ticks)
    bar.update_ticks()
