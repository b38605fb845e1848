"""A picture of a problem before it is solved: the mesh, the roles of its boundaries, how nodes move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.lines import element_zones
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.foundations import foundations
from rmesh_nlp.report.style import FOUNDATION

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's palette."""

WIDTH = 8.0
"""Inches; the height follows the extent of the mesh."""

MARKERS = {
    Mobility.PINNED: ("s", "pinned"),
    Mobility.SLIDING: ("|", "slides"),
    Mobility.FREE: (".", "free"),
    Mobility.TIED: ("D", "tied"),
}


def draw_problem(problem: ContactProblem, path: Path) -> None:
    """Draw to a file (PNG, PDF, SVG by suffix).

    Boundaries that are given, loaded or in contact have their own colours and a legend; each node
    has a marker for its mobility, and sliding ones a short line along which they slide. Foundations are
    drawn with the initial gap of every contact node, in red where they overlap the body.
    """
    p, free = problem.mesh.p, MeshMap.of(problem)
    feet = [foundation.feet for foundation in foundations(problem, p) if not foundation.is_far]
    extent = np.ptp(np.hstack([p, *feet]), axis=1)
    figure = Figure(figsize=(WIDTH, 1.5 + WIDTH * min(extent[1] / extent[0], 1.0)), layout="constrained")
    axis = figure.add_subplot()
    zone = element_zones(problem)
    # one zone has one colour, the lightest
    axis.tripcolor(
        p[0], p[1], problem.triangles.T, facecolors=zone.astype(float), cmap="Pastel2", vmin=0, vmax=8
    )
    axis.triplot(p[0], p[1], problem.triangles.T, color="0.6", linewidth=0.4)
    for (label, facets), colour in zip(_roles(problem), COLOURS * 5, strict=False):
        ends = p[:, problem.mesh.facets[:, facets]]
        axis.add_collection(
            LineCollection(list(ends.transpose(2, 1, 0)), color=colour, linewidth=3, label=label)
        )
    _draw_moves(axis, problem, free)
    far = _draw_foundations(axis, problem)
    unit = bracketed(problem.units.length)
    axis.set(aspect="equal", xlabel=f"$x_1${unit}", ylabel=f"$x_2${unit}")
    axis.set_title("\n".join([f"{problem.name}: {p.shape[1]} nodes, {free.n} moves", *far]))
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))  # several foundations have one entry
    figure.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=3, fontsize="small")
    figure.savefig(path, dpi=150, bbox_inches="tight")


def _draw_moves(axis: Axes, problem: ContactProblem, free: MeshMap) -> None:
    p, size = problem.mesh.p, 2000 / max(problem.mesh.p.shape[1], 100)
    for kind, (marker, label) in MARKERS.items():
        nodes = free.mobility == kind
        if not np.any(nodes):
            continue
        if kind is Mobility.SLIDING:
            step = free.positions.slopes(np.zeros(free.n))[:, nodes]
            ends = np.stack([p[:, nodes] - step, p[:, nodes] + step])
            axis.add_collection(
                LineCollection(list(ends.transpose(2, 0, 1)), color="black", linewidth=1.5, label=label)
            )
        else:
            axis.scatter(
                p[0, nodes], p[1, nodes], s=size, marker=marker, color="black", label=label, zorder=3
            )


def _draw_foundations(axis: Axes, problem: ContactProblem) -> list[str]:
    """Foundations and initial gaps; returns a line for the title about each that is too far off to draw."""
    far = []
    for one in foundations(problem, problem.mesh.p):
        if one.is_far:
            far.append(f"the foundation of {one.name} is {one.gaps.min():.3g} away, not drawn")
            continue
        axis.add_collection(
            LineCollection(
                list(one.lines.transpose(1, 2, 0)),
                color=FOUNDATION,
                linewidth=8,  # seen on both sides of a boundary that lies on it
                label="rigid foundation",
                zorder=0.5,
            )
        )
        nodes = problem.mesh.p[:, one.nodes]
        for chosen, colour, width, label in (
            (one.gaps > 0, "0.5", 0.8, "initial gap"),
            (one.gaps < -1e-9 * np.ptp(problem.mesh.p), "red", 2.0, "initial overlap"),
        ):
            if np.any(chosen):
                ends = np.stack([nodes[:, chosen], one.feet[:, chosen]])
                lines = list(ends.transpose(2, 0, 1))
                axis.add_collection(LineCollection(lines, color=colour, linewidth=width, label=label))
        axis.update_datalim(one.feet.T)
    axis.autoscale_view()
    return far


def _roles(problem: ContactProblem) -> list[tuple[str, np.ndarray]]:
    """Label and facets of every boundary that has a role."""
    boundaries = problem.mesh.boundaries
    roles = [(f"given: {d.boundary}", boundaries[d.boundary]) for d in problem.supports]
    roles += [(f"load: {t.boundary}", boundaries[t.boundary]) for t in problem.tractions]
    for obstacle in problem.obstacles:
        if isinstance(obstacle.boundary, str):
            roles.append((f"contact: {obstacle.boundary}", boundaries[obstacle.boundary]))
    return roles
