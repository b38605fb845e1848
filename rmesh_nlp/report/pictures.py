"""Which pictures a solution has, by name: before and after, meshes, fields, pressure, motion, limits."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rmesh_nlp.contact.active_set import solve, touching_set
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import along, points_of
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.io.kept_problem import KeptSolution
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.curves import design_figure
from rmesh_nlp.report.drawing import (
    Body,
    Contact,
    coloured,
    contact_figure,
    displacement_figure,
    draw_contact_set,
    draw_lines,
    draw_nodes,
    foundations,
    side_by_side,
)
from rmesh_nlp.report.style import CONTACT, IN_CONTACT, NEUTRAL, Page
from rmesh_nlp.solving import plotting
from rmesh_nlp.solving.parts import DESIGN, Step
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.state import nodal_stress

Drawable = Solution | KeptSolution
GIVEN = "given mesh"


def body_at(title: str, problem: ContactProblem, X: Array, u: Array, pressure: Array) -> Body:
    """The body of a problem with its vertices at X (2, vertices).

    Displacement ``u`` (components, nodes) and pressure (nodes,) are at the nodes of the displacement.
    """
    space = DisplacementSpace(problem)
    nodes, contacts = points_of(space, X), []
    closed = np.zeros(space.elements.shape[1], dtype=bool)
    for part in space.contact_sets:
        obstacle = part.obstacle
        if obstacle.boundary is Place.INTERIOR:  # closed are elements whose nodes all touch
            touching = u[0] + obstacle.distances(nodes) <= ZERO * np.max(np.abs(u), initial=0.0)
            closed |= np.all(touching[space.elements], axis=0)
        else:
            edges = space.nodes_of(contact_edges(problem, obstacle))
            contacts.append(Contact(str(obstacle.boundary), part.nodes, edges))
    shown: dict[str, Any] = {"foundations": foundations(space, nodes), "contacts": tuple(contacts)}
    shown |= {"pressure": pressure, "stress": plotting.size_of_stress(problem, X, u)}
    return Body(title, nodes, space.elements, u, **shown, closed=np.flatnonzero(closed))


def before(problem: ContactProblem, pressure: Array | None = None, title: str = GIVEN) -> Body:
    """The contact solution before relocation; ``pressure`` (nodes,) of a similar mesh says who touches."""
    model, X = ContactSolver(problem), np.asarray(problem.mesh.p)
    system, space = model.system(X), model.discretisation.space
    start = None if pressure is None else touching_set(system, pressure[model.contact_nodes] > 0)
    state = solve(system, start)
    pressure = nodal_stress(model, X, state.normal_force)
    return body_at(title, problem, X, space.values(model.displacement.values(state.u)), pressure)


def after(solution: Drawable) -> Body:
    """The solution itself."""
    X = np.asarray(solution.mesh.p)
    moved = np.any(solution.problem.mesh.p != X)
    title = "relocated mesh" if moved else f"{_title(solution)}, nothing moved"
    title = title if solution.designed is None else "last design"
    return body_at(title, solution.problem, X, solution.displacement, np.asarray(solution.pressure))


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


def pictures(solution: Drawable, page: Page) -> Iterator[tuple[str, Figure]]:
    """Names and figures of all there is to see, made one by one; nothing that would be all zero."""
    last, start = after(solution), _start(solution)
    bodies = [last]
    begin, end = np.asarray(start.mesh.p), np.asarray(solution.mesh.p)
    moved = bool(np.any(begin != end))
    if moved or solution.designed is not None:
        bodies.insert(0, before(start, last.pressure, _title(solution)))
    units, elastic = solution.problem.units, last.elastic
    is_loaded = any(np.any(body.displacement) for body in bodies)
    yield "mesh", side_by_side(bodies, _paint_mesh, page, units.length, deformed=elastic and is_loaded)
    if is_loaded:
        yield "displacement", displacement_figure(bodies, page, units, deformed=False)
        paint = coloured(plotting.draw_elements, lambda body: body.stress)
        label = f"von Mises stress{bracketed(units.stress)}" if elastic else "|flux|"
        yield "stress" if elastic else "flux", side_by_side(bodies, paint, page, units.length, label=label)
    if not last.closed.size and (contact := contact_figure(bodies, page, units)) is not None:
        yield "pressure", contact
    if moved:
        yield "motion", motion_figure(solution, last, begin, end, page)
        if not solution.problem.motion.is_fixed:
            yield "limits", limits_figure(solution, last, page)
    if solution.designed is not None and (design := _design(solution, page)) is not None:
        yield "design", design


def _paint_mesh(axis: Axes, body: Body) -> None:
    """The mesh with the boundaries, or the interior set, of contact."""
    plotting.draw_mesh(axis, body.nodes, body.triangles)
    draw_contact_set(axis, body, facecolor=IN_CONTACT, alpha=0.25)
    for contact in body.contacts:
        look: dict[str, Any] = {"color": CONTACT, "linewidth": 1.5, "label": "may come in contact"}
        draw_lines(axis, along(contact.edges, body.nodes), zorder=3, **look)  # over the foundation


def _design(solution: Drawable, page: Page) -> Figure | None:
    """Objective and design variables over the iterations."""
    assert solution.designed is not None
    steps = [step.row() if isinstance(step, Step) else step for step in solution.history]
    shown = {name for step in steps[:1] for name in step}
    bounds = {one.name: one.bounds for one in solution.designed.design if DESIGN + one.name in shown}
    return design_figure({"": steps}, bounds, solution.objective, page) if bounds else None


class Limit(Enum):
    """What limits the motion of a node: label, colour, marker."""

    PINNED = ("does not move", "0.6", "o")
    NOTHING = ("nothing", NEUTRAL, "o")
    MOVE_LIMIT = ("its move limit", IN_CONTACT, "s")
    AREA = ("the area or an angle of an element", "#000000", "^")


def limits(solution: Drawable) -> NDArray[np.object_]:
    """The :class:`Limit` of each vertex; move limits before areas where both act."""
    problem = solution.problem
    mobility = MeshMap.of(problem).mobility
    result = np.full(mobility.size, Limit.NOTHING, dtype=object)
    if solution.multipliers is not None:
        pull = solution.multipliers.area + solution.multipliers.angle
        active = pull > ZERO * np.max(pull, initial=0.0)
        result[np.unique(problem.triangles[:, active])] = Limit.AREA
        limit = solution.multipliers.limit
        result[limit > ZERO * np.max(limit, initial=0.0)] = Limit.MOVE_LIMIT
    result[mobility == Mobility.PINNED] = Limit.PINNED
    return result


def limits_figure(solution: Drawable, body: Body, page: Page) -> Figure:
    """Every vertex with the colour of its limit."""
    X, kinds, fine = np.asarray(solution.mesh.p), limits(solution), plotting.is_fine(body.triangles)
    used = np.isin(np.arange(X.shape[1]), solution.mesh.t)
    size = float(np.clip(1500 / X.shape[1], 0.6, 6.0))

    def paint(axis: Axes, body: Body) -> None:
        if not fine:
            plotting.draw_mesh(axis, body.nodes, body.triangles, color="0.85")
        looks = ((used & (kinds == limit), *limit.value) for limit in Limit)
        draw_nodes(axis, X, looks, s=size, linewidths=0, zorder=2, rasterized=fine)

    figure = side_by_side([body], paint, page, solution.problem.units.length, title="what limits each node")
    for handle in figure.legends[0].legend_handles:
        handle.set_sizes([14.0])  # type: ignore[union-attr]
    return figure


def motion_figure(solution: Drawable, body: Body, begin: Array, end: Array, page: Page) -> Figure:
    """The way of each vertex, from ``begin`` to ``end`` (2, vertices), over the colours of its length."""
    space, unit = DisplacementSpace(solution.problem), solution.problem.units.length
    motion = body.nodes - points_of(space, begin)

    def paint(axis: Axes, body: Body) -> Any:
        if not plotting.is_fine(body.triangles):  # the ways would hide the colours
            moved = np.any(begin != end, axis=0)
            draw_lines(axis, np.stack([begin, end], axis=2)[:, moved], color="white", linewidth=0.6)
        return plotting.draw_nodal(axis, body.nodes, body.triangles, motion, vmin=0.0)

    title = f"motion from the {_title(solution)}"
    return side_by_side([body], paint, page, unit, label=f"motion{bracketed(unit)}", title=title)
