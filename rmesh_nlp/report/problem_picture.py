"""The picture of a problem before it is solved: boundaries with their roles, mobility of nodes, gaps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.fem.sampling import along
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.vtu import state_of
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.geometry import edges_on, lengths
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.lines import element_zones
from rmesh_nlp.report import style
from rmesh_nlp.report.drawing import DrawnBody, draw_foundations, draw_lines, draw_nodes
from rmesh_nlp.solving import plotting

MARKERS = {
    Mobility.PINNED: ("pinned", "black", "s"),
    Mobility.FREE: ("free", "black", "."),
    Mobility.TIED: ("tied", "black", "D"),
}


def draw_problem(problem: ContactProblem, path: Path) -> None:
    """Draw a problem before it is solved to a file (PNG, PDF, SVG by suffix).

    Boundaries that are fixed, loaded or in contact have their own colours and a legend; where nodes move,
    each has a marker for its mobility, and sliding ones a short line along which they slide. Foundations are
    drawn with the initial gap of every contact node, in red where they overlap the body.
    """
    mesh, free, space = problem.mesh, MeshMap.of(problem), DisplacementSpace(problem)
    nodes, cells = space.points_on_body(mesh.p), space.elements
    # with middles of edges foundations are seen to be curved
    finer = replace(problem.placed(dict.fromkeys(problem.tools, (0.0, 0.0))), order=2)
    fine = DisplacementSpace(finer)
    rest = np.zeros((problem.components, fine.n_nodes))
    body = DrawnBody("", fine.elements, state_of(finer, mesh.p, rest, rest[0], rest[0]))
    extent = np.ptp(np.hstack([mesh.p, *(one.lines.reshape(2, -1) for one in body.near)]), axis=1)
    with rc_context(style.SETTINGS):
        width = style.Page().width
        figure = style.new_figure(width, 1.5 + width * min(extent[1] / extent[0], 1.0))
        axis = figure.add_subplot()
        # one zone has one colour, the lightest
        zone = element_zones(problem.mesh).astype(float)
        plotting.draw_elements(axis, nodes, cells, zone, cmap="Pastel2", vmin=0, vmax=8)
        plotting.draw_mesh(axis, nodes, cells, color="0.6")
        for position, (label, boundary) in enumerate(_roles(problem)):
            pen = style.PENS[1 + position % (len(style.PENS) - 1)]  # black are the nodes
            edges = space.nodes_of(edges_on(mesh, boundary))
            said = {"color": pen["color"], "label": f"{label}: {boundary}"}
            draw_lines(axis, along(edges, nodes), linewidth=3, **said)
        if free.n:
            _draw_mobility(axis, problem, free)
        # so wide that they are seen on both sides of a boundary that lies on them
        draw_foundations(axis, body, linewidth=8, capstyle="butt", zorder=0.5)
        _draw_gaps(axis, body, space.n_nodes)
        axis.autoscale_view()
        across, up = problem.units.axes
        axis.set(aspect="equal", xlabel=across, ylabel=up)
        heading = f"{problem.name}: {mesh.p.shape[1]} nodes, {mesh.nelements} triangles"
        for one in (one for one in body.contacts if body.elastic and one.is_rigid and one not in body.near):
            heading += f"\nthe foundation of {one.name} is {one.distance:.3g} away, not drawn"
        axis.set_title(heading)
        style.add_legend(figure, [axis], "outside lower center")
        style.lay_out(figure)
        figure.savefig(path)


def _draw_mobility(axis: Axes, problem: ContactProblem, free: MeshMap) -> None:
    p, size = problem.mesh.p, 2000 / max(problem.n_vertices, 100)
    length = 0.2 * np.min(lengths(p, problem.mesh.facets))  # boundaries stay seen
    looks = ((free.mobility == kind, *look) for kind, look in MARKERS.items())
    draw_nodes(axis, p, looks, s=size, zorder=3)
    sliding = free.mobility == Mobility.SLIDING
    if np.any(sliding):
        places, step = p[:, sliding], free.positions.slopes(np.zeros(free.n))[:, sliding]
        step *= np.minimum(1.0, length / np.maximum(np.linalg.norm(step, axis=0), 1e-300))
        ends = np.stack([places - step, places + step], axis=2)
        draw_lines(axis, ends, color="black", linewidth=1.5, label="slides along")


def _draw_gaps(axis: Axes, body: DrawnBody, count: int) -> None:
    """The initial gap of every contact node among the first ``count`` nodes; overlaps are red."""
    for one in body.near:
        which = one.nodes[one.nodes < count]
        feet, gap = body.state.feet[one.name][:, which], body.state.gap[which]
        ends = np.stack([body.nodes[:, which], feet], axis=2)
        overlaps = gap < -ROUNDING * np.ptp(body.nodes)
        for chosen, colour, width, label in (
            (gap > 0, "0.5", 0.8, "initial gap"),
            (overlaps, "red", 2.0, "initial overlap"),
        ):
            if np.any(chosen):
                draw_lines(axis, ends[:, chosen], color=colour, linewidth=width, label=label)
        axis.update_datalim(feet.T)


def _roles(problem: ContactProblem) -> list[tuple[str, str]]:
    """Label and name of every boundary that has a role, or without contact is shown by its name."""
    roles = [("given" if problem.obstacles else "boundary", one.boundary) for one in problem.supports]
    roles += [("load", one.boundary) for one in problem.tractions]
    return roles + [("contact", one.boundary) for one in problem.obstacles if isinstance(one.boundary, str)]
