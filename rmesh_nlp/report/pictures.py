"""Pictures of a relocation before and after: meshes, fields, pressure, motion, limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rmesh_nlp.contact.active_set import solve, touching_set
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import along, points_of
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.io.kept_problem import KeptSolution
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report import style
from rmesh_nlp.report.design_figure import design_figure
from rmesh_nlp.report.drawing import (
    Body,
    colour_bar,
    draw_deformed,
    draw_foundations,
    draw_lines,
    foundations,
    magnification,
    window,
)
from rmesh_nlp.report.style import Page
from rmesh_nlp.solving import plotting
from rmesh_nlp.solving.parts import DESIGN, Step
from rmesh_nlp.solving.solution import Solution

Drawable = Solution | KeptSolution
PICTURES = ("mesh", "displacement", "stress", "flux", "pressure", "motion", "limits", "design")
GIVEN = "given mesh"
CLOSED = 1e-9  # a gap below this part of the largest displacement is closed
SMALL = 1e-6  # a multiplier below this part of the largest of its kind is not active


@dataclass(frozen=True)
class DrawnState(Body):
    """A solution on one mesh: nodes and triangles of its displacement space, vertices ``X`` (2, vertices).

    Pressure is (nodes,); stress, von Mises' or the length of the flux, is (elements, pieces).
    """

    title: str
    problem: ContactProblem
    X: Array
    pressure: Array
    stress: Array

    @staticmethod
    def of(title: str, problem: ContactProblem, X: Array, u: Array, pressure: Array) -> DrawnState:
        """The state of displacement ``u`` (components, nodes), the vertices at X (2, vertices)."""
        space, stress = DisplacementSpace.of(problem), plotting.size_of_stress(problem, X, u)
        nodes = points_of(space, X)
        parts = foundations(space, nodes)
        return DrawnState(nodes, space.elements, u, parts, title, problem, X, pressure, stress)

    @property
    def space(self) -> DisplacementSpace:
        """Its displacement space."""
        return DisplacementSpace.of(self.problem)

    @property
    def closed(self) -> NDArray[np.bool_]:
        """(elements,) those of an interior contact set whose nodes all touch the obstacle."""
        closed = np.zeros(self.triangles.shape[1], dtype=bool)
        for part in self.problem.obstacles:
            if part.boundary is Place.INTERIOR:
                gap = self.displacement[0] + part.distances(self.nodes)
                touching = gap <= CLOSED * np.max(np.abs(self.displacement), initial=0.0)
                closed |= np.all(touching[self.triangles], axis=0)
        return closed


def before(problem: ContactProblem, pressure: Array | None = None, title: str = GIVEN) -> DrawnState:
    """The contact solution before relocation; ``pressure`` (nodes,) of a similar mesh says who touches."""
    model, X = ContactSolver(problem), np.asarray(problem.mesh.p)
    system, space = model.system(X), DisplacementSpace.of(problem)
    start = None if pressure is None else touching_set(system, pressure[model.contact_nodes] > 0)
    state = solve(system, start)
    pressure = np.zeros(space.n_nodes)
    np.add.at(pressure, model.contact_nodes, state.normal_force / space.weights(X))
    return DrawnState.of(title, problem, X, space.values(model.displacement.values(state.u)), pressure)


def after(solution: Drawable) -> DrawnState:
    """The solution itself."""
    X, pressure = np.asarray(solution.mesh.p), np.asarray(solution.pressure)
    moved = np.any(solution.problem.mesh.p != X)
    title = "relocated mesh" if moved else f"{_title(solution)}, nothing moved"
    title = title if solution.designed is None else "last design"
    return DrawnState.of(title, solution.problem, X, solution.displacement, pressure)


def _start(solution: Drawable) -> ContactProblem:
    """The problem before relocation, with its first design."""
    return solution.problem if solution.designed is None else solution.designed.at_design()


def _title(solution: Drawable) -> str:
    """What the mesh before relocation is."""
    if solution.designed is not None:
        return "first design"
    if isinstance(solution, Solution):
        return GIVEN if solution.assessment.is_same_mesh else "new mesh"
    return "new mesh" if solution.is_remeshed else GIVEN


def write_pictures(solution: Drawable, folder: Path, page: Page = Page()) -> list[Path]:  # noqa: B008
    """Draw all there is to see about a solution, nothing that would be all zero."""
    paths: list[Path] = []
    with rc_context(page.settings):
        for name, figure in pictures(solution, page):
            paths.append(style.save(figure, folder / name, page.kind, page.settings))
    return paths


def pictures(solution: Drawable, page: Page) -> Iterator[tuple[str, Figure]]:
    """Names and figures, made one by one."""
    states = [after(solution)]
    start = _start(solution)
    moved = bool(np.any(start.mesh.p != states[0].X))
    if moved or solution.designed is not None:
        states.insert(0, before(start, states[0].pressure, _title(solution)))
    yield "mesh", _meshes(states, page)
    units, elastic = solution.problem.units, states[0].elastic
    if any(np.any(state.displacement) for state in states):
        label = f"|u|{bracketed(units.length)}" if elastic else "u"
        fields = [state.displacement for state in states]
        yield "displacement", _coloured(states, fields, plotting.draw_nodal, label, page)
        label = f"von Mises stress{bracketed(units.stress)}" if elastic else "|flux|"
        stresses = [state.stress for state in states]
        coloured = _coloured(states, stresses, plotting.draw_elements, label, page)
        yield "stress" if elastic else "flux", coloured
    if any(np.any(state.pressure) for state in states) and not np.any(states[-1].closed):
        yield "pressure", _pressures(states, page)
    if moved:
        relocates = not solution.problem.motion.is_fixed
        for name, draw in (("motion", _draw_motion), *((("limits", _draw_limits),) if relocates else ())):
            figure, axes = page.panels(1, [window(states[1:])], units.length, below=0.85)
            draw(figure, axes[0, 0], solution)
            yield name, figure
    if solution.designed is not None and (drawn := _design(solution, page)) is not None:
        yield "design", drawn


def _design(solution: Drawable, page: Page) -> Figure | None:
    """Objective and design variables over the iterations."""
    assert solution.designed is not None
    steps = [step.row() if isinstance(step, Step) else step for step in solution.history]
    shown = {name for step in steps[:1] for name in step}
    bounds = {one.name: one.bounds for one in solution.designed.design if DESIGN + one.name in shown}
    return design_figure({"": steps}, bounds, solution.objective, width=page.width) if bounds else None


def _meshes(states: Sequence[DrawnState], page: Page) -> Figure:
    """Undeformed meshes; for an elastic body also deformed ones over the one foundation."""
    deforms = states[0].elastic and any(np.any(state.displacement) for state in states)
    factor = magnification(states) if deforms else 0.0
    windows = [window(states, 1.0), window(states, factor)] if deforms else [window(states)]
    figure, axes = page.panels(len(states), windows, states[0].problem.units.length, below=0.3)
    for column, state in zip(axes.T, states, strict=True):
        plotting.draw_mesh(column[0], state.nodes, state.triangles)
        _contact_set(column[0], state)
        for part in state.problem.contact_sets:
            if isinstance(part.obstacle.boundary, str):
                edges = state.space.nodes_of(contact_edges(state.problem, part.obstacle))
                pen = {"color": style.CONTACT, "linewidth": 1.5, "label": "may come in contact"}
                draw_lines(column[0], along(edges, state.nodes), zorder=3, **pen)  # over the foundation
        column[0].set_title(state.title)
        if deforms:
            draw_foundations(column[0], state, linewidth=4.0)  # a boundary may lie on it
            draw_deformed(column[1], state, factor)
    style.add_legend(figure, list(axes[:, 0]), "outside lower center")
    return figure


def _coloured(states: Sequence[DrawnState], values: list[Array], draw: Any, label: str, page: Page) -> Figure:
    """Fields as colours of one scale, by the function that draws nodal fields or those of elements."""
    length = states[0].problem.units.length
    figure, axes = page.panels(len(states), [window(states)], length, below=0.75)
    painted: list[Any] = []
    for axis, state, value in zip(axes[0], states, values, strict=True):
        painted.append(draw(axis, state.nodes, state.triangles, value))
        if not plotting.is_fine(state.triangles):  # the lines would hide the colours
            plotting.draw_mesh(axis, state.nodes, state.triangles, thin=0.4, color="white")
        _contact_set(axis, state, filled=False)
        axis.set_title(state.title)
    drawn = np.concatenate([np.ravel(one.get_array()) for one in painted])
    for one in painted:
        one.set_clim(drawn.min(), drawn.max())
    below: dict[str, Any] = {"location": "bottom", "aspect": 40, "shrink": 0.8}
    colour_bar(figure, painted[-1], axes.ravel().tolist(), 5, label=label, **below)
    return figure


def _pressures(states: Sequence[DrawnState], page: Page) -> Figure:
    """Contact pressure along each contact boundary, one panel per boundary that is touched."""
    problem, units = states[0].problem, states[0].problem.units
    space = states[0].space
    sets = [
        part for part in space.contact_sets if any(np.any(state.pressure[part.nodes]) for state in states)
    ]
    figure = style.new_figure(page.width, 0.3 + page.line_height * len(sets))
    axes = figure.subplots(len(sets), 1, squeeze=False)[:, 0]
    name = f"contact pressure{bracketed(units.stress)}" if states[0].elastic else "contact stress"
    for axis, part in zip(axes, sets, strict=True):
        coordinate = plotting.direction(states[0].nodes[:, part.nodes])
        where = part.nodes, space.nodes_of(contact_edges(problem, part.obstacle))
        for position, state in enumerate(states):
            pen = {**style.look(position).line(scale=0.6), "markeredgewidth": 0.6, "label": state.title}
            plotting.draw_along(axis, state.nodes, where, state.pressure, coordinate, **pen)
        place = f"$x_{coordinate + 1}${bracketed(units.length)} on {part.obstacle.boundary}"
        axis.set(xlabel=place, ylabel=name)
    style.add_legend(figure, [axes[0]])
    return figure


def _contact_set(axis: Axes, state: DrawnState, *, filled: bool = True) -> None:
    """For an obstacle in the interior: where it is touched, and the edge of that."""
    closed, mesh = state.closed, state.problem.mesh
    if not np.any(closed):
        return
    if filled:
        corners = list(state.X[:, state.problem.triangles[:, closed]].transpose(2, 1, 0))
        pen: dict[str, Any] = {"facecolor": style.IN_CONTACT, "edgecolor": "none", "alpha": 0.25}
        axis.add_collection(PolyCollection(corners, **pen, label="in contact"))
    inner, outer = mesh.f2t
    rim = closed[inner] != ((outer >= 0) & closed[outer])
    draw_lines(axis, state.X[:, mesh.facets[:, rim].T], color=style.IN_CONTACT, linewidth=1.2)


class Limit(Enum):
    """What limits the motion of a node: label, colour, marker."""

    PINNED = ("does not move", "0.6", "o")
    NOTHING = ("nothing", style.NEUTRAL, "o")
    MOVE_LIMIT = ("its move limit", style.IN_CONTACT, "s")
    AREA = ("the area or an angle of an element", "#000000", "^")


def limits(solution: Drawable) -> NDArray[np.object_]:
    """The :class:`Limit` of each vertex; move limits before areas where both act."""
    problem = solution.problem
    mobility = MeshMap.of(problem).mobility
    result = np.full(mobility.size, Limit.NOTHING, dtype=object)
    if solution.multipliers is not None:
        pull = solution.multipliers.area + solution.multipliers.angle
        active = pull > SMALL * np.max(pull, initial=0.0)
        result[np.unique(problem.triangles[:, active])] = Limit.AREA
        limit = solution.multipliers.limit
        result[limit > SMALL * np.max(limit, initial=0.0)] = Limit.MOVE_LIMIT
    result[mobility == Mobility.PINNED] = Limit.PINNED
    return result


def _draw_limits(figure: Figure, axis: Axes, solution: Drawable) -> None:
    """Every vertex with the colour of its limit."""
    X, space = np.asarray(solution.mesh.p), DisplacementSpace.of(solution.problem)
    fine = plotting.is_fine(space.elements)
    if not fine:
        plotting.draw_mesh(axis, points_of(space, X), space.elements, color="0.85")
    kinds = limits(solution)
    used = np.isin(np.arange(X.shape[1]), solution.mesh.t)
    size = float(np.clip(1500 / max(X.shape[1], 1), 0.6, 6.0))
    for limit in Limit:
        label, colour, marker = limit.value
        limited = used & (kinds == limit)
        if np.any(limited):
            pen: dict[str, Any] = {"marker": marker, "linewidths": 0, "label": label, "rasterized": fine}
            axis.scatter(X[0, limited], X[1, limited], s=size, c=colour, zorder=2, **pen)
    axis.set_title("what limits each node")
    legend = figure.legend(loc="outside lower center", handletextpad=0.2, borderpad=0.1, labelspacing=0.25)
    for handle in legend.legend_handles:
        handle.set_sizes([14.0])  # type: ignore[union-attr]


def _draw_motion(figure: Figure, axis: Axes, solution: Drawable) -> None:
    """The way of each vertex over the colours of its length."""
    old, new = np.asarray(_start(solution).mesh.p), np.asarray(solution.mesh.p)
    space = DisplacementSpace.of(solution.problem)
    begin, end = points_of(space, old), points_of(space, new)
    painted = plotting.draw_nodal(axis, end, space.elements, end - begin, vmin=0.0)
    if not plotting.is_fine(space.elements):  # the ways would hide the colours
        moved = np.any(old != new, axis=0)
        draw_lines(axis, np.stack([old, new], axis=2)[:, moved], color="white", linewidth=0.6)
    below: dict[str, Any] = {"location": "bottom", "aspect": 25, "shrink": 0.9, "pad": 0.03}
    colour_bar(figure, painted, [axis], 4, label=f"motion{bracketed(solution.problem.units.length)}", **below)
    axis.set_title(f"motion from the {_title(solution)}")
