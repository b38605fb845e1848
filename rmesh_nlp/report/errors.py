"""Figures of certificates: where the error is, before and after, and brackets of the least energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.report.blocks import label
from rmesh_nlp.report.style import MAP, TWO_COLUMNS, look, new_figure

DECADES = 3
"""Powers of ten that the colours of an error map span."""


def error_figure(field: Fields, record: Record) -> Figure:
    """Where the error is, before and after: the root of what each element adds to its square, per area."""
    panels = [
        (
            f"given, {_percent(record, 'relative_error_bound_initial')}",
            field.initial,
            field.error_bound_initial,
        ),
        (f"relocated, {_percent(record, 'relative_error_bound')}", field.nodes, field.error_bound),
    ]
    density = [
        np.sqrt(2 * np.maximum(_known(local), 0) / np.abs(signed_areas(nodes, field.triangles)))
        for _, nodes, local in panels
    ]
    high = max(float(np.max(values)) for values in density)
    norm = LogNorm(max(high, 1e-300) / 10**DECADES, max(high, 1e-299))
    shape = np.ptp(field.nodes, axis=1)
    wide = shape[0] > 2 * shape[1]
    rows, columns = (2, 1) if wide else (1, 2)
    height = 0.9 + rows * (TWO_COLUMNS - 1.4) / columns * float(shape[1] / shape[0])
    figure = new_figure(TWO_COLUMNS, min(height, 8.0))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (title, nodes, _), values in zip(axes, panels, density, strict=True):
        drawn = axis.tripcolor(
            nodes[0], nodes[1], field.triangles.T, np.maximum(values, norm.vmin or 0), norm=norm, cmap=MAP
        )
        axis.set(aspect="equal", xlabel="$x_1$", ylabel="$x_2$")
        axis.set_title(title)
    figure.colorbar(drawn, ax=axes.tolist(), label="error bound per root of area", aspect=30)
    return figure


def bracket_figure(records: Sequence[Record]) -> Figure:
    """Lower and upper bounds of the least energy against the number of nodes, a band per formulation."""
    figure = new_figure(TWO_COLUMNS * 0.6, 2.8)
    axis = figure.subplots()
    for position, name in enumerate(dict.fromkeys(label(record) for record in records)):
        rows = sorted((r for r in records if label(r) == name), key=lambda record: record["nodes"])
        nodes = [row["nodes"] for row in rows]
        low, high = ([row[f"energy_{side}_bound"] for row in rows] for side in ("lower", "upper"))
        style = look(position)
        axis.fill_between(nodes, low, high, color=style.color, alpha=0.15, linewidth=0)
        axis.plot(nodes, high, color=style.color, marker=style.marker, markersize=4, label=name)
        axis.plot(nodes, low, color=style.color, marker=style.marker, markersize=4, linestyle="--")
    axis.set(xscale="log", xlabel="nodes", ylabel="bounds of the least energy")
    axis.legend()
    return figure


def is_certified(record: Record) -> bool:
    """Whether a record holds both bounds of the energy."""
    return record.get("energy_lower_bound") is not None and record.get("energy_upper_bound") is not None


def _known(local: Array | None) -> Array:
    if local is None:
        raise ValueError("the solution has no certificate")
    return local


def _percent(record: Record, name: str) -> str:
    guaranteed = all(record.get(f"guaranteed_{side}") for side in ("lower", "upper", "initial"))
    value = record.get(name)
    if value is None:
        return ""
    return f"error {'at most' if guaranteed else 'estimated at'} {100 * value:.3g} %"
