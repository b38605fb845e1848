"""Which figures the results of a folder have, by name: like 6.1 to 6.10 of the paper, and profiles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import SolutionFields, read_vtu
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem.units import units_of
from rmesh_nlp.report.blocks import Case, blocks_of, label, order_of, relocates, variant
from rmesh_nlp.report.columns import short_label
from rmesh_nlp.report.curves import bracket_figure, convergence_figure, design_figure, profile_figure
from rmesh_nlp.report.drawing import (
    DrawnBody,
    coloured,
    contact_figure,
    displacement_figure,
    side_by_side,
)
from rmesh_nlp.report.histories import curve
from rmesh_nlp.report.study_summary import charts, is_study
from rmesh_nlp.report.style import Page
from rmesh_nlp.solving import plotting

DECADES = 3  # powers of ten that the colours of an error map span


def figures(results: Sequence[Result], page: Page) -> Iterator[tuple[str, Figure]]:
    """Of a study its profiles; of a comparison those of each block, and brackets of certified energies.

    BadInputError if the fields of a solution cannot be read.
    """
    records = [result.record for result in results]
    if is_study(records):
        for chart in charts(results):
            figure = profile_figure(chart, page)
            figure.axes[0].set_title(chart.title)
            yield f"profile-{chart.name}", figure
        return
    for block, own in blocks_of(results):
        yield from block_figures(block, own, page)
    bounds = ("energy_lower_bound", "energy_upper_bound")
    certified = [r for r in records if r.get("nodes") and all(r.get(name) is not None for name in bounds)]
    for example in dict.fromkeys(record["example"] for record in certified):
        rows = [record for record in certified if record["example"] == example]
        if len({record["nodes"] for record in rows}) > 1:
            yield f"{example}-bracket", bracket_figure(rows, page)


def block_figures(block: Case, results: Sequence[Result], page: Page) -> Iterator[tuple[str, Figure]]:
    """Names and figures of one block: grids, stresses, convergence and designs, beside the given grid."""
    first = block.records[0]
    page, size = replace(page, units=units_of(first)), f"{block.example}-{first['n']}"
    stem = size if order_of(first) == 1 else f"{size}-order{order_of(first)}"
    given, moved = _bodies(results)
    for record, fields, body in moved:
        made = replace(body, title=f"{'design' if record.get('design') else 'relocated'} by {body.title}")
        own = f"{stem}-{label(record)}"
        yield f"{own}-grid", displacement_figure([*given, made], page, deformed=body.elastic)
        if fields.error_bound is not None and fields.error_bound_initial is not None:
            yield f"{own}-error", error_figure(fields, record, page)
    if given and not moved:
        yield f"{stem}-grid", displacement_figure(given, page, deformed=given[0].elastic)
    stresses, progress = stress_figures(results, page), progress_figures(block, results, page)
    for objective, what, figure in (*stresses, *progress):
        asked = objective_of(block.objectives[objective][0])  # without the weight of a distortion
        told = [] if objective == "energy" else ["regularised" if asked == "energy" else asked]
        yield "-".join([stem, *told, what]), figure


def _bodies(
    results: Sequence[Result],
) -> tuple[list[DrawnBody], list[tuple[Record, SolutionFields, DrawnBody]]]:
    """The given grid of a block, if it is known, and what its solves made of it."""
    drawn = [(one.record, read_vtu(one.vtu)) for one in results if one.record["energy"] is not None]
    title = "first design" if any(record.get("design") for record, _ in drawn) else "given grid"
    of_given = (fields for record, fields in drawn if not record.get("remeshed_nodes"))
    given = [DrawnBody(title, fields.triangles, fields.given) for fields in of_given][:1]
    return given, [
        (record, fields, DrawnBody(short_label(record), fields.triangles, fields.final))
        for record, fields in drawn
        if relocates(record)
    ]


def stress_figures(results: Sequence[Result], page: Page) -> Iterator[tuple[str, str, Figure]]:
    """For each objective of a block it, "stress" and the figure of contact stresses, where there are any."""
    page = replace(page, units=units_of(results[0].record)) if results else page
    given, moved = _bodies(results)
    for objective in dict.fromkeys(str(result.record["objective"]) for result in results):
        ends = [body for record, _, body in moved if record["objective"] == objective]
        bodies = [*given, *ends] if ends or not moved else []
        if bodies and (figure := contact_figure(bodies, page)) is not None:
            yield objective, "stress", figure


def progress_figures(
    block: Case, results: Sequence[Result], page: Page, positions: Mapping[str, int] | None = None
) -> Iterator[tuple[str, str, Figure]]:
    """For each objective of a block the ways of its solves: objective, "convergence" or "design", figure.

    With ``positions``, those of all variants of a folder, a curve has the look of its variant.
    """
    name = short_label if positions is None else variant
    for objective in block.objectives:
        solves = [result for result in results if result.record["objective"] == objective]
        traced = [(name(result.record), curve(result)) for result in solves]
        curves = [(what, steps) for what, steps in traced if steps is not None]
        lowest = Case(tuple(result.record for result in solves)).best
        if curves and lowest is not None:
            yield objective, "convergence", convergence_figure(curves, lowest, page, positions)
        if (way := figure_of_designs(solves, page)) is not None:
            yield objective, "design", way


def figure_of_designs(results: Sequence[Result], page: Page) -> Figure | None:
    """The way of the designs of solves with one objective; None where there is none."""
    moved = [result for result in results if relocates(result.record) if result.record.get("design_bounds")]
    if not moved:
        return None
    curves = {short_label(result.record): result.steps() for result in moved}
    first = moved[0].record
    return design_figure(curves, first["design_bounds"], str(first["objective"]), page)


def error_figure(fields: SolutionFields, record: Record, page: Page) -> Figure:
    """Where the error is, before and after: the root of what each element adds to its square, per area."""
    guaranteed = all(record.get(f"guaranteed_{side}") for side in ("lower", "upper", "initial"))
    words = "at most" if guaranteed else "estimated at"
    bodies, densities = [], {}
    for when, state, bound, entry in (
        ("given", fields.given, fields.error_bound_initial, "relative_error_bound_initial"),
        ("relocated", fields.final, fields.error_bound, "relative_error_bound"),
    ):
        assert bound is not None  # it is certified
        error = record.get(entry)
        title = f"{when}, " + ("" if error is None else f"error {words} {100 * error:.3g} %")
        areas = np.abs(signed_areas(state.nodes, fields.triangles[:3]))
        densities[title] = np.sqrt(2 * np.maximum(bound, 0) / areas)
        bodies.append(DrawnBody(title, fields.triangles, state))
    high = max(np.max(list(densities.values())), 1e-299)
    norm = LogNorm(high / 10**DECADES, high)
    paint = coloured(
        plotting.draw_elements, lambda body: np.maximum(densities[body.title], norm.vmin or 0), norm=norm
    )
    return side_by_side(bodies, paint, page, label="error bound per root of area")
