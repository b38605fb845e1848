"""Results to figures like 6.1 to 6.10 of the paper, and to profiles; nothing is solved here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, StrMethodFormatter

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.sampling import pieces
from rmesh_nlp.io.folder import Manifest, safe_name
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import Fields, read_vtu
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem.units import NO_UNITS, Units, bracketed, units_of
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, Block, blocks, grouped, label, order_of, with_order
from rmesh_nlp.report.design_figure import design_figure
from rmesh_nlp.report.designs import short_label
from rmesh_nlp.report.drawing import body_of, colour_bar, draw_deformed, magnification, window
from rmesh_nlp.report.histories import Curve, curve
from rmesh_nlp.report.study_summary import Chart, charts, is_study
from rmesh_nlp.report.style import (
    SETTINGS,
    TWO_COLUMNS,
    Look,
    Page,
    add_legend,
    look,
    new_figure,
    save,
)
from rmesh_nlp.solving import plotting
from rmesh_nlp.solving.plotting import MAP, size_of

LEVELS = 16  # contours of a solution
DECADES = 3  # powers of ten that the colours of an error map span
FLOOR = 1e-8  # part of the best energy down to which distances are drawn: the solvers' tolerance
NOTHING = 1e-10  # part of the largest distance below which an objective counts as zero
MARKERS = 15  # about as many markers on a curve
FEW = 100  # axes that span a smaller factor are labelled with numbers in place of powers


def write_figures(
    results: Sequence[Result], folder: Path, manifest: Manifest | None = None, kind: str = "png"
) -> list[Path]:
    """Draw everything that the results hold and return the files.

    Figures are noted in the ``manifest`` of the folder above, and no file is replaced that is not. Raises
    BadInputError if the fields of a solution cannot be read, or a file of the user's is in the way.
    """
    paths: list[Path] = []
    with rc_context(SETTINGS):
        for name, figure in _all_figures(results):
            stem, number = safe_name(name), 1
            while stem in {path.stem for path in paths}:  # numbered if an earlier figure has the name
                number += 1
                stem = f"{safe_name(name)}-{number}"
            if manifest is not None:
                manifest.claim(f"{folder.name}/{stem}.{kind}")
            paths.append(save(figure, folder / stem, kind))
    return paths


def _all_figures(results: Sequence[Result]) -> Iterator[tuple[str, Figure]]:
    """Of a study its profiles; of a comparison those of each block, and brackets of certified energies."""
    records = [result.record for result in results]
    if is_study(records):
        yield from ((f"profile-{chart.name}", profile_figure(chart)) for chart in charts(results))
        return
    by_record = {id(result.record): result for result in results}
    for block in blocks(records):
        yield from block_figures(block, [by_record[id(record)] for record in block.records])
    bounds = ("energy_lower_bound", "energy_upper_bound")
    certified = [r for r in records if r.get("nodes") and all(r.get(name) is not None for name in bounds)]
    for example in dict.fromkeys(record["example"] for record in certified):
        rows = [record for record in certified if record["example"] == example]
        if len({record["nodes"] for record in rows}) > 1:
            yield f"{example}-bracket", bracket_figure(rows)


def block_figures(block: Block, results: Sequence[Result]) -> Iterator[tuple[str, Figure]]:
    """Names and figures of one block: grids, stresses and convergence.

    Formulations are compared with the solution of ``fixed``; without it, what would show the
    given grid is left out.
    """
    drawn = [(one.record, read_vtu(one.vtu)) for one in results if one.record["energy"] is not None]
    units = units_of(block.records[0].get("units"))
    order = order_of(block.records[0])
    stem = f"{block.example}-{block.records[0]['n']}" + (f"-order{order}" if order != 1 else "")
    moved = [(record, field) for record, field in drawn if record["formulation"] != RELOCATING_NOTHING]
    fixed = [field for record, field in drawn if record["formulation"] == RELOCATING_NOTHING]
    designs = any(record.get("design") for record, _ in drawn)
    given = {"first design" if designs else "given grid": fixed[0]} if fixed else {}
    made = "design" if designs else "relocated"
    with rc_context(SETTINGS):
        for record, field in moved:
            key = record.get("key", stem)
            yield f"{key}-grid", grid_figure({**given, f"{made} by {short_label(record)}": field}, units)
            if field.error_bound is not None and field.error_bound_initial is not None:
                yield (
                    f"{key}-error",
                    error_figure(field, (field.error_bound_initial, field.error_bound), record),
                )
        if given and not moved:
            yield f"{stem}-grid", grid_figure(given, units)
        for objective in block.objectives:
            own = [(record, field) for record, field in moved if record["objective"] == objective]
            named = {short_label(record): field for record, field in own}
            if drawn and drawn[0][1].contact.any() and (named or not moved):
                yield f"{stem}{_suffix(objective)}-stress", stress_figure({**given, **named}, units)
        for objective, records in block.objectives.items():
            solves = [result for result in results if result.record["objective"] == objective]
            traced = [curve(result, block.unit, short_label(result.record)) for result in solves]
            curves = [one for one in traced if one is not None]
            lowest = Block(tuple(records)).best
            if curves and lowest is not None:
                yield f"{stem}{_suffix(objective)}-convergence", convergence_figure(curves, lowest)
            if (way := figure_of_designs(solves)) is not None:
                yield f"{stem}{_suffix(objective)}-design", way


def figure_of_designs(results: Sequence[Result], width: float = TWO_COLUMNS) -> Figure | None:
    """The way of the designs of solves with one objective; None where there is none."""
    moved = [result for result in results if result.record["formulation"] != RELOCATING_NOTHING]
    designs = [
        result for result in moved if result.record.get("design_bounds") and result.record.get("design")
    ]
    if not designs:
        return None
    curves = {short_label(result.record): result.steps() for result in designs}
    first = designs[0].record
    return design_figure(curves, first["design_bounds"], str(first["objective"]), width=width)


def _suffix(objective: str) -> str:
    """What tells figures of other objectives from those of the energy."""
    return "" if objective == "energy" else f"-{objective}"


def grid_figure(panels: Mapping[str, Fields], units: Units = NO_UNITS) -> Figure:
    """Grids by title with contours of the solution; below them, if elastic, the deformed grids."""
    bodies = [body_of(field) for field in panels.values()]
    elastic, factor = bodies[0].elastic, magnification(bodies)
    windows = [window(bodies), *([window(bodies, factor)] if elastic else [])]
    below = 0.3 if elastic else 0.15
    figure, axes = Page().panels(len(bodies), windows, units.length, below=below, beside=1.0)
    cut = [pieces(body.triangles, body.nodes.shape[1]) for body in bodies]
    values = [size_of(parts(body.displacement)) for parts, body in zip(cut, bodies, strict=True)]
    levels = MaxNLocator(LEVELS).tick_values(min(map(np.min, values)), max(map(np.max, values)))
    for column, title, body, parts, value in zip(axes.T, panels, bodies, cut, values, strict=True):
        mesh = plotting.triangulation(body.nodes, parts)
        filled = column[0].tricontourf(mesh, value, levels=levels, cmap=MAP)
        plotting.draw_mesh(column[0], body.nodes, body.triangles, color="white")
        column[0].set_title(title)
        if elastic:
            draw_deformed(column[1], body, factor)
    name = f"|u|{bracketed(units.length)}" if elastic else "u"
    shape: dict[str, Any] = {"ticks": 5, "aspect": 10} if elastic else {"ticks": 8, "aspect": 25}
    colour_bar(figure, filled, axes[0].tolist(), **shape, pad=0.02, label=name)
    add_legend(figure, [axes[-1, 0]], "outside lower center")
    return figure


def stress_figure(curves: Mapping[str, Fields], units: Units = NO_UNITS) -> Figure:
    """Contact stress by name, the given grid first; with friction the tangential one and its bound."""
    fields = list(curves.values())
    unit = bracketed(units.stress) if fields[0].displacement.shape[0] == 2 else ""
    frictional = any(np.any(field.friction_bound > 0) for field in fields)
    figure = new_figure(TWO_COLUMNS, 4.6 if frictional else 2.6)
    axes = figure.subplots(2 if frictional else 1, 1, sharex=True, squeeze=False)[:, 0]
    coordinate = plotting.direction(fields[0].nodes[:, fields[0].contact])

    def draw(axis: Axes, field: Fields, values: Array, **pen: Any) -> None:
        where = np.flatnonzero(field.contact), field.boundary
        plotting.draw_along(axis, field.nodes, where, values, coordinate, **pen)

    for position, (name, field) in enumerate(curves.items()):
        for axis, values in zip(axes, (field.pressure, field.tangential_stress), strict=False):
            draw(axis, field, values, **look(position).line(), label=name)
    axes[0].set_ylabel(f"contact stress{unit}")
    if frictional:
        axes[1].set_ylabel(f"tangential stress{unit}")
        pen = {"color": "0.5", "linewidth": 0.9, "linestyle": (0, (6, 2))}
        draw(axes[1], fields[0], fields[0].friction_bound, **pen, label="friction bound ±g")
        draw(axes[1], fields[0], -fields[0].friction_bound, **pen)
    axes[-1].set_xlabel(f"$x_{coordinate + 1}${bracketed(units.length)} on the contact boundary")
    add_legend(figure, [axes[-1]])
    return figure


def error_figure(field: Fields, bounds: tuple[Array, Array], record: Record) -> Figure:
    """Where the error is, before and after: the root of what each element adds to its square, per area.

    ``bounds`` (elements,) are what each element adds to the bound of half the squared error on the given
    and on the relocated mesh.
    """
    meshes = (field.initial, field.nodes)
    density = [
        np.sqrt(2 * np.maximum(local, 0) / np.abs(signed_areas(nodes, field.triangles[:3])))
        for nodes, local in zip(meshes, bounds, strict=True)
    ]
    high = float(np.max(density))
    norm = LogNorm(max(high, 1e-300) / 10**DECADES, max(high, 1e-299))
    figure, axes = Page().panels(2, [window([body_of(field)])], "", below=0.15, beside=1.0)
    guaranteed = all(record.get(f"guaranteed_{side}") for side in ("lower", "upper", "initial"))
    for axis, when, nodes, values in zip(axes[0], ("given", "relocated"), meshes, density, strict=True):
        drawn = plotting.draw_elements(
            axis, nodes, field.triangles, np.maximum(values, norm.vmin or 0), norm=norm
        )
        error = record.get("relative_error_bound_initial" if when == "given" else "relative_error_bound")
        words = "at most" if guaranteed else "estimated at"
        axis.set_title(f"{when}, " + ("" if error is None else f"error {words} {100 * error:.3g} %"))
    figure.colorbar(drawn, ax=axes[0].tolist(), label="error bound\nper root of area", aspect=20)
    return figure


def bracket_figure(records: Sequence[Record]) -> Figure:
    """Lower and upper bounds of the least energy against the size of the mesh, a band per formulation.

    The size is the number of nodes, and of unknowns where not all displacements are linear.
    """
    figure = new_figure(TWO_COLUMNS * 0.6, 2.8)
    axis = figure.subplots()
    size = "nodes" if all(order_of(record) == 1 for record in records) else "unknowns"
    bands = grouped(records, lambda record: with_order(label(record), record))
    for position, (name, own) in enumerate(bands.items()):
        rows = sorted(own, key=lambda record: int(record[size]))
        nodes = [row[size] for row in rows]
        low, high = ([row[f"energy_{side}_bound"] for row in rows] for side in ("lower", "upper"))
        style = look(position)
        axis.fill_between(nodes, low, high, color=style.color, alpha=0.15, linewidth=0)
        pen: dict[str, Any] = {"color": style.color, "marker": style.marker, "markersize": 4}
        axis.plot(nodes, high, **pen, label=name)
        axis.plot(nodes, low, **pen, linestyle="--")
    axis.set(xscale="log", xlabel=size, ylabel="bounds of the least energy")
    axis.legend()
    return figure


def convergence_figure(
    curves: Sequence[Curve], best: Record, looks: Mapping[str, int] | None = None, width: float = TWO_COLUMNS
) -> Figure:
    """Distance to the best objective over iterations and over cost; a narrow figure has the cost alone.

    Drawn is the value by the problem's own rule. Energies are per unit of depth, so their unit is that of
    force. ``best`` has the lowest objective, for curves without a feasible end; ``looks`` are positions of
    the names in other figures.
    """
    of_energy = best["objective"] == "energy"
    unit = bracketed(units_of(best.get("units")).force) if of_energy else ""
    symbol = "J" if of_energy else "F"
    ends = [float(one.energy[-1]) for one in curves if one.feasible[-1]]
    reference = min(ends, default=float(best["energy" if of_energy else "objective_value"]))
    figure = new_figure(width, 3.1)
    axes = figure.subplots(1, 2 if width == TWO_COLUMNS else 1, sharey=True, squeeze=False)[0]
    gaps = [np.abs(one.energy - reference) for one in curves]
    largest = max(float(np.nanmax(gap)) for gap in gaps) or 1.0
    # a sum of squares may end at rounding: parts of that would span thirty decades
    ends_at_zero = abs(reference) < NOTHING * largest
    floor = FLOOR * (largest if ends_at_zero else abs(reference))
    for position, (one, gap) in enumerate(zip(curves, gaps, strict=True), 1):
        style = look(position if looks is None else looks[one.name])
        for axis, where in zip(axes[::-1], (one.cost, one.iteration), strict=False):
            _draw(axis, where, np.maximum(gap, floor), one, style)
    least = f"{reference:.6g}".replace("-", "−")
    drawn_to = f"{symbol}* = {least}, drawn down to $10^{{{round(np.log10(FLOOR))}}}$ "
    drawn_to += "of the largest" if ends_at_zero else f"|{symbol}*|"
    if not all(one.feasible.all() for one in curves):
        drawn_to += "\nopen markers: constraints not yet met"
    axes[0].set(yscale="log", ylabel=f"|{symbol} − {symbol}*|{unit}", xlabel=f"iteration\n{drawn_to}")
    axes[-1].set(xscale="log", xlabel="cost: time of build and solve\nover that of one contact solve")
    if len(axes) == 1:
        axes[0].set_xlabel(f"cost [contact solves]\n{drawn_to}")
    for axis in axes:
        axis.grid(color="0.9", linewidth=0.5)
        axis.minorticks_off()
    _label_in_numbers(axes[-1])  # costs often span less than a decade
    add_legend(figure, [axes[0]])
    return figure


def _draw(axis: Axes, where: Array, gap: Array, one: Curve, style: Look) -> None:
    """A line with some markers, open where the iterate is not feasible."""
    common: Any = {"color": style.color, "marker": style.marker, "markersize": 4, "markeredgewidth": 0.8}
    axis.plot(where, gap, color=style.color, linestyle=style.linestyle)
    marked = np.zeros(where.size, dtype=bool)
    marked[:: max(1, where.size // MARKERS)] = marked[-1] = True
    for kept, face in ((one.feasible & marked, style.color), (~one.feasible & marked, "white")):
        axis.plot(where[kept], gap[kept], linestyle="none", markerfacecolor=face, **common)
    axis.plot([], [], linestyle=style.linestyle, label=one.name, **common)  # for the legend


def _label_in_numbers(axis: Axes) -> None:
    """Labels 1, 2, 5, 10: powers of ten would leave a short axis without any."""
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def profile_figure(chart: Chart, width: float = 0.6 * TWO_COLUMNS, heading: bool = True) -> Figure:
    """Shares of problems over the chart's quantity, one step function per formulation."""
    figure = new_figure(width, 2.9)
    axis = figure.add_subplot()
    every = np.concatenate([profile.at for profile in chart.profiles.values()])
    positive = every[every > 0]
    # values of zero stand at the left edge of a logarithmic axis
    low = float(max(positive.min(), 1e-6)) if positive.size else 1.0
    high = 1.1 * float(max(positive.max(), 2 * low)) if positive.size else 2.0
    for position, (name, profile) in enumerate(chart.profiles.items(), 1):
        at = np.concatenate([[low], np.maximum(profile.at, low), [high]])
        style = look(position)
        axis.step(at, profile(at), where="post", label=name, color=style.color, linestyle=style.linestyle)
    axis.set(ylim=(-0.02, 1.02), xlabel=chart.axis, ylabel="share of problems", xscale="log")
    if heading:
        axis.set_title(chart.title)
    if high < FEW * low:
        _label_in_numbers(axis)
        axis.minorticks_off()
    axis.grid(color="0.9", linewidth=0.5)
    if len(chart.profiles) > 4 or not heading:
        add_legend(figure, [axis])
    else:
        axis.legend(loc="lower right")
    return figure
