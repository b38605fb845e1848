"""Before and after the relocation side by side: meshes, displacement, stress, contact pressure, motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.foundations import Foundation, displaced, magnification
from rmesh_nlp.report.limits import draw_limits, draw_motion
from rmesh_nlp.report.page import Page
from rmesh_nlp.report.pixels import draw_edges, draw_field, is_fine
from rmesh_nlp.report.states import Drawable, State, after, before
from rmesh_nlp.report.style import FOUNDATION, GRID_LINE, MAP, look, new_figure, save

TITLES = ("given mesh", "relocated mesh")
PICTURES = ("mesh", "displacement", "stress", "flux", "pressure", "motion", "limits")
"""Names of all pictures that there may be."""

ROOM = 0.15
"""A foundation is drawn up to this part of the extent outside the body."""


def write_pictures(solution: Drawable, folder: Path, page: Page = Page()) -> list[Path]:  # noqa: B008
    """Draw everything there is to see about a solution; nothing that would be all zero.

    Returns the files, PNG and PDF: ``mesh``, ``displacement``, ``stress`` or ``flux``, ``pressure``,
    ``motion``, ``limits``.
    """
    paths: list[Path] = []
    with rc_context(page.settings):
        for name, figure in pictures(solution, page):
            paths += save(figure, folder / name, settings=page.settings)
    return paths


def pictures(solution: Drawable, page: Page) -> Iterator[tuple[str, Figure]]:
    """Names and figures, made one by one."""
    states = [before(solution.problem, np.asarray(solution.pressure)), after(solution)]
    moved = bool(np.any(states[0].nodes != states[1].nodes))
    if not moved:
        states = states[1:]
    yield "mesh", _meshes(states, page)
    units = solution.problem.units
    if any(np.any(state.displacement) for state in states):
        label = f"|u|{bracketed(units.length)}" if states[0].elastic else "u"
        values = [state.size_of_displacement for state in states]
        yield "displacement", _coloured(states, values, label, page)
        label = f"von Mises stress{bracketed(units.stress)}" if states[0].elastic else "|flux|"
        name = "stress" if states[0].elastic else "flux"
        yield name, _coloured(states, [state.stress for state in states], label, page)
    if any(np.any(state.pressure) for state in states) and not np.any(states[-1].closed):
        yield "pressure", _pressures(states, page)
    if moved:
        yield "motion", _one(solution, page, draw_motion)
        yield "limits", _one(solution, page, draw_limits)


def _meshes(states: Sequence[State], page: Page) -> Figure:
    """Undeformed meshes; for an elastic body also deformed ones over the one foundation."""
    deforms = states[0].elastic and any(np.any(state.displacement) for state in states)
    factor = _factor(states) if deforms else 0.0
    windows = [_window(states, 1.0 if deforms else 0.0)] + ([_window(states, factor)] if deforms else [])
    figure, axes = page.panels(len(states), windows, below=0.3)
    for k, state in enumerate(states):
        top = axes[0, k]
        _edges(top, state, state.nodes)
        _contact_set(top, state)
        _boundary(top, state)
        if deforms:
            _foundation(top, states[0], 1.0, width=4.0)  # a boundary may lie on it
            bottom = axes[1, k]
            moved = state.nodes + factor * state.displacement
            _edges(bottom, state, moved)
            _foundation(bottom, states[0], factor, width=2.2)
            bottom.set_title(f"deformed, u and gap × {factor:g}" if factor > 1 else "deformed, true scale")
    _finish(axes, states, windows)
    shown: dict[str, Artist] = {}
    for axis in axes[:, 0]:
        handles, labels = axis.get_legend_handles_labels()
        shown.update(zip(labels, handles, strict=True))
    if shown:
        figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=2)
    return figure


def _finish(axes: NDArray[Any], states: Sequence[State], windows: Sequence[Array]) -> None:
    """Titles, limits and labels."""
    unit = bracketed(states[0].problem.units.length)
    for k in range(len(states)):
        axes[0, k].set_title(TITLES[k] if len(states) == 2 else "given mesh, nothing moved")
        for axis, window in zip(axes[:, k], windows, strict=True):
            _frame(axis, window, unit)


def _coloured(states: Sequence[State], values: list[Array], label: str, page: Page) -> Figure:
    """Fields of nodes or elements as colours of one scale."""
    low = min(float(np.min(v)) for v in values)
    high = max(float(np.max(v)) for v in values)
    windows = [_window(states, 0.0)]
    figure, axes = page.panels(len(states), windows, below=0.75)
    for axis, state, value in zip(axes[0], states, values, strict=True):
        colours: dict[str, Any] = {"vmin": low, "vmax": high, "cmap": MAP}
        if is_fine(state.problem.triangles):
            painted = draw_field(axis, state.nodes, state.problem.triangles, value, **colours)
        else:
            mesh = _triangulation(state, state.nodes)
            smooth = value.size == state.nodes.shape[1]
            given: dict[str, Any] = {"shading": "gouraud"} if smooth else {"facecolors": value}
            painted = axis.tripcolor(mesh, *([value] if smooth else []), rasterized=True, **given, **colours)
            axis.triplot(mesh, color="white", linewidth=0.4 * _line_width(state))
        _contact_set(axis, state, filled=False)
    _finish(axes, states, windows)
    bar = figure.colorbar(painted, ax=axes.ravel().tolist(), location="bottom", aspect=40, shrink=0.8)
    bar.set_label(label)
    bar.locator = MaxNLocator(5)
    bar.update_ticks()
    return figure


def _pressures(states: Sequence[State], page: Page) -> Figure:
    """Contact pressure along each contact boundary, one panel per boundary that is touched."""
    problem = states[0].problem
    sets = [
        (number, part)
        for number, part in enumerate(problem.contact_sets)
        if any(np.any(state.pressure[part.nodes]) for state in states)
    ]
    figure = new_figure(page.width, 0.3 + page.line_height * len(sets))
    axes = figure.subplots(len(sets), 1, squeeze=False)[:, 0]
    unit = bracketed(problem.units.stress) if states[0].elastic else ""
    for axis, (_, part) in zip(axes, sets, strict=True):
        points = problem.mesh.p[:, part.nodes]
        direction = int(np.argmax(np.ptp(points, axis=1)))
        for k, state in enumerate(states):
            order = part.nodes[np.argsort(state.nodes[direction, part.nodes])]
            style = look(k)
            axis.plot(
                state.nodes[direction, order],
                state.pressure[order],
                color=style.color,
                linestyle=style.linestyle,
                marker=style.marker,
                markersize=0.6 * style.size,
                markerfacecolor="none",
                markeredgewidth=0.6,
                label=TITLES[k] if len(states) == 2 else "given mesh, nothing moved",
            )
        axis.set(xlabel=f"$x_{direction + 1}${bracketed(problem.units.length)} on {part.obstacle.boundary}")
        axis.set_ylabel(f"contact pressure{unit}" if states[0].elastic else "contact stress")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _one(solution: Drawable, page: Page, draw: Callable[[Figure, Axes, Drawable], None]) -> Figure:
    """A figure of the relocated mesh alone."""
    window = _window([after(solution)], 0.0)
    figure, axes = page.panels(1, [window], below=0.85)
    draw(figure, axes[0, 0], solution)
    _frame(axes[0, 0], window, bracketed(solution.problem.units.length))
    return figure


def _factor(states: Sequence[State]) -> float:
    """By how much displacements are drawn larger than they are."""
    ways = [(one.lines - one.starts).reshape(2, -1) for one in _near(states[0])]
    extent = float(np.max(np.ptp(states[0].nodes, axis=1)))
    return magnification([state.displacement for state in states], ways, extent)


def _near(state: State) -> list[Foundation]:
    return [one for one in state.foundations if not one.is_far]


def _foundation(axis: Axes, state: State, factor: float, width: float) -> None:
    """The foundations as the curves that they are, beside a body drawn with a magnified displacement."""
    for number, one in enumerate(_near(state)):
        axis.add_collection(
            LineCollection(
                list(displaced(one.lines, one.lines - one.starts, factor).transpose(1, 2, 0)),
                color=FOUNDATION,
                linewidth=width,
                capstyle="round",
                label="rigid foundation" if number == 0 else None,
            )
        )


def _contact_set(axis: Axes, state: State, *, filled: bool = True) -> None:
    """For an obstacle in the interior: where it is touched, and the edge of that."""
    closed = state.closed
    if not np.any(closed):
        return
    corners = list(state.nodes[:, state.problem.triangles[:, closed]].transpose(2, 1, 0))
    if filled:
        patches = PolyCollection(corners, facecolor="#D55E00", alpha=0.25, edgecolor="none")
        patches.set_label("in contact")
        axis.add_collection(patches)
    left, right = state.problem.mesh.f2t
    inside = closed[left].astype(int) + np.where(right >= 0, closed[right], False)
    ends = state.nodes[:, state.problem.mesh.facets[:, inside == 1]]
    axis.add_collection(LineCollection(list(ends.transpose(2, 1, 0)), color="#D55E00", linewidth=1.2))


def _boundary(axis: Axes, state: State) -> None:
    """Contact boundaries of the undeformed body, thick."""
    for number, part in enumerate(state.problem.contact_sets):
        if isinstance(part.obstacle.boundary, str):
            facets = state.problem.mesh.boundaries[part.obstacle.boundary]
            ends = state.nodes[:, state.problem.mesh.facets[:, facets]]
            axis.add_collection(
                LineCollection(
                    list(ends.transpose(2, 1, 0)),
                    color="#009E73",
                    linewidth=1.5,
                    label="may come in contact" if number == 0 else None,
                    zorder=3,  # over a foundation that it lies on
                )
            )


def _frame(axis: Axes, window: Array, unit: str) -> None:
    axis.set(xlim=window[0], ylim=window[1], xlabel=f"$x_1${unit}", ylabel=f"$x_2${unit}")
    axis.set_aspect("equal")
    axis.spines[:].set_visible(False)
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axis.label_outer()


def _window(states: Sequence[State], factor: float) -> Array:
    """Limits (2, 2) around the bodies, and around foundations that are near."""
    points = [state.nodes for state in states]
    if factor:
        points += [state.nodes + factor * state.displacement for state in states]
    every = np.hstack(points)
    low, high = every.min(axis=1), every.max(axis=1)
    room = ROOM * float(np.max(high - low))
    if factor:
        for one in _near(states[0]):
            lines = displaced(one.lines, one.lines - one.starts, factor).reshape(2, -1)
            low = np.minimum(low, np.maximum(lines.min(axis=1), low - room))
            high = np.maximum(high, np.minimum(lines.max(axis=1), high + room))
    extra = 0.02 * float(np.max(high - low))
    return np.stack([low - extra, high + extra], axis=1)


def _triangulation(state: State, nodes: Array) -> Triangulation:
    return Triangulation(nodes[0], nodes[1], state.problem.triangles.T)


def _edges(axis: Axes, state: State, nodes: Array) -> None:
    """The edges of the mesh."""
    if is_fine(state.problem.triangles):
        draw_edges(axis, nodes, state.problem.mesh.facets, GRID_LINE)
    else:
        axis.triplot(_triangulation(state, nodes), color=GRID_LINE, linewidth=_line_width(state))


def _line_width(state: State) -> float:
    """Thinner lines on finer meshes."""
    return float(np.clip(8 / np.sqrt(state.problem.mesh.t.shape[1]), 0.08, 0.5))
