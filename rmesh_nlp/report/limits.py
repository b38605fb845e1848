"""How far each node moved, and what keeps it from going on."""

from __future__ import annotations

from enum import Enum

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.pixels import draw_field, is_fine
from rmesh_nlp.report.states import Drawable
from rmesh_nlp.report.style import MAP

SMALL = 1e-6
"""A multiplier below this part of the largest of its kind holds nothing back."""


class Limit(Enum):
    """What holds a node: label, colour, marker."""

    PINNED = ("does not move", "0.6", "o")
    NOTHING = ("nothing", "#56B4E9", "o")
    BOX = ("its box", "#D55E00", "s")
    AREA = ("the area or an angle of an element", "#000000", "^")


def limits(solution: Drawable) -> NDArray[np.object_]:
    """The :class:`Limit` of each node; boxes before areas where both act."""
    problem = solution.problem
    mobility = MeshMap.of(problem).mobility
    result = np.full(mobility.size, Limit.NOTHING, dtype=object)
    if solution.multipliers is not None:
        pull = solution.multipliers.area + solution.multipliers.angle
        active = pull > SMALL * np.max(pull, initial=0.0)
        result[np.unique(problem.triangles[:, active])] = Limit.AREA
        box = solution.multipliers.box
        result[box > SMALL * np.max(box, initial=0.0)] = Limit.BOX
    result[mobility == Mobility.PINNED] = Limit.PINNED
    return result


def draw_limits(figure: Figure, axis: Axes, solution: Drawable) -> None:
    """Every node with the colour of its limit."""
    nodes = np.asarray(solution.mesh.p)
    fine = is_fine(solution.problem.triangles)
    if not fine:
        axis.triplot(nodes[0], nodes[1], solution.problem.triangles.T, color="0.85", linewidth=0.3)
    kinds = limits(solution)
    used = np.zeros(nodes.shape[1], dtype=bool)
    used[np.unique(solution.mesh.t)] = True
    size = float(np.clip(1500 / max(nodes.shape[1], 1), 0.6, 6.0))
    for limit in Limit:
        here = used & (kinds == limit)
        if np.any(here):
            label, colour, marker = limit.value
            x, y = nodes[:, here]
            axis.scatter(
                x,
                y,
                s=size,
                c=colour,
                marker=marker,
                linewidths=0,
                label=label,
                zorder=2,
                rasterized=fine,
            )
    axis.set_title("what limits each node")
    legend = figure.legend(loc="outside lower center", handletextpad=0.2, borderpad=0.1, labelspacing=0.25)
    for handle in legend.legend_handles:
        handle.set_sizes([14.0])  # type: ignore[union-attr]


def draw_motion(figure: Figure, axis: Axes, solution: Drawable) -> None:
    """The way of each node over the colours of its length."""
    old, new = np.asarray(solution.problem.mesh.p), np.asarray(solution.mesh.p)
    length = np.linalg.norm(new - old, axis=0)
    triangles = solution.problem.triangles
    if is_fine(triangles):  # the ways would hide the colours
        painted = draw_field(axis, new, triangles, length, cmap=MAP, vmin=0.0)
    else:
        mesh = Triangulation(new[0], new[1], triangles.T)
        painted = axis.tripcolor(mesh, length, cmap=MAP, shading="gouraud", vmin=0.0, rasterized=True)
        ways = np.stack([old, new]).transpose(2, 0, 1)[length > 0]
        axis.add_collection(LineCollection(list(ways), color="white", linewidth=0.6))
    bar = figure.colorbar(painted, ax=axis, location="bottom", aspect=25, shrink=0.9, pad=0.03)
    bar.set_label(f"motion{bracketed(solution.problem.units.length)}")
    bar.locator = MaxNLocator(4)
    bar.update_ticks()
    axis.set_title("motion from the given place")
