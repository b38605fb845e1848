"""Which pictures a solution has, by name: before and after, meshes, fields, pressure, motion, limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import SolutionFields, read_vtu
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.problem.units import bracketed, units_of
from rmesh_nlp.report.curves import estimates_figure
from rmesh_nlp.report.drawing import (
    DrawnBody,
    coloured,
    contact_figure,
    displacement_figure,
    draw_contact_set,
    draw_lines,
    draw_nodes,
    side_by_side,
)
from rmesh_nlp.report.figures import figure_of_designs
from rmesh_nlp.report.style import CONTACT, IN_CONTACT, NEUTRAL, Page
from rmesh_nlp.solving import plotting


def pictures(result: Result, page: Page) -> Iterator[tuple[str, Figure]]:
    """Names and figures of all there is to see, made one by one; nothing that would be all zero.

    BadInputError if the fields cannot be read.
    """
    record, fields = result.record, read_vtu(result.vtu)
    moved, is_design = bool(np.any(fields.given.nodes != fields.final.nodes)), bool(record.get("design"))
    before = "first design" if is_design else "new mesh" if record.get("remeshed_nodes") else "given mesh"
    after = "last design" if is_design else "relocated mesh" if moved else f"{before}, nothing moved"
    last = DrawnBody(after, fields.triangles, fields.final)
    bodies = [last]
    if moved or is_design:
        bodies.insert(0, DrawnBody(before, fields.triangles, fields.given))
    page, elastic = replace(page, units=units_of(record)), last.elastic
    is_loaded = any(np.any(body.state.displacement) for body in bodies)
    yield "mesh", side_by_side(bodies, _paint_mesh, page, deformed=elastic and is_loaded)
    if is_loaded:
        yield "displacement", displacement_figure(bodies, page, deformed=False)
        paint = coloured(plotting.draw_elements, lambda body: body.state.stress)
        label = f"von Mises stress{bracketed(page.units.stress)}" if elastic else "|flux|"
        yield "stress" if elastic else "flux", side_by_side(bodies, paint, page, label=label)
    if (contact := contact_figure(bodies, page)) is not None:
        yield "pressure", contact
    if moved:
        yield "motion", motion_figure(fields, last, f"motion from the {before}", page)
        if record["delta"] != [0, 0]:
            yield "limits", limits_figure(fields, last, page)
    if (design := figure_of_designs([result], page)) is not None:
        yield "design", design
    if meshes := record.get("meshes"):
        yield "estimates", estimates_figure(meshes, page)


def _paint_mesh(axis: Axes, body: DrawnBody) -> None:
    """The mesh with the boundaries, or the interior set, of contact."""
    plotting.draw_mesh(axis, body.nodes, body.triangles)
    draw_contact_set(axis, body, facecolor=IN_CONTACT, alpha=0.25)
    for contact in body.contacts:
        look: dict[str, Any] = {"color": CONTACT, "linewidth": 1.5, "label": "may come in contact"}
        draw_lines(axis, contact.starts, zorder=3, **look)  # over the foundation


class Limit(Enum):
    """What limits the motion of a node: label, colour, marker."""

    PINNED = ("does not move", "0.6", "o")
    NOTHING = ("nothing", NEUTRAL, "o")
    MOVE_LIMIT = ("its move limit", IN_CONTACT, "s")
    AREA = ("the area or an angle of an element", "#000000", "^")


def limits(fields: SolutionFields) -> NDArray[np.object_]:
    """The :class:`Limit` of each node; move limits before areas where both act."""
    result = np.full(fields.mobility.size, Limit.NOTHING, dtype=object)
    if fields.multipliers is not None:
        pull, limit = fields.multipliers.area + fields.multipliers.angle, fields.multipliers.limit
        active = pull > ZERO * np.max(pull, initial=0.0)
        result[np.unique(fields.triangles[:3, active])] = Limit.AREA
        result[limit > ZERO * np.max(limit, initial=0.0)] = Limit.MOVE_LIMIT
    result[fields.mobility == Mobility.PINNED] = Limit.PINNED
    return result


def limits_figure(fields: SolutionFields, body: DrawnBody, page: Page) -> Figure:
    """Every vertex with the colour of its limit."""
    kinds, fine = limits(fields), plotting.is_fine(body.triangles)
    vertices = np.isin(np.arange(kinds.size), fields.triangles[:3])
    size = float(np.clip(1500 / np.count_nonzero(vertices), 0.6, 6.0))

    def paint(axis: Axes, body: DrawnBody) -> None:
        if not fine:
            plotting.draw_mesh(axis, body.nodes, body.triangles, color="0.85")
        looks = ((vertices & (kinds == limit), *limit.value) for limit in Limit)
        draw_nodes(axis, body.nodes, looks, s=size, linewidths=0, zorder=2, rasterized=fine)

    figure = side_by_side([body], paint, page, title="what limits each node")
    for handle in figure.legends[0].legend_handles:
        handle.set_sizes([14.0])  # type: ignore[union-attr]
    return figure


def motion_figure(fields: SolutionFields, body: DrawnBody, title: str, page: Page) -> Figure:
    """The way of each vertex over the colours of its length."""
    begin, end = fields.given.nodes, fields.final.nodes

    def paint(axis: Axes, body: DrawnBody) -> Any:
        if not plotting.is_fine(body.triangles):  # the ways would hide the colours
            moved = np.any(begin != end, axis=0) & (fields.mobility >= 0)
            draw_lines(axis, np.stack([begin, end], axis=2)[:, moved], color="white", linewidth=0.6)
        return plotting.draw_nodal(axis, end, body.triangles, end - begin, vmin=0.0)

    label = f"motion{bracketed(page.units.length)}"
    return side_by_side([body], paint, page, label=label, title=title)
