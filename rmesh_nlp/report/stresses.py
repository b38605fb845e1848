"""Figures of contact and tangential stress along the contact boundary."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.problem.units import NO_UNITS, Units, bracketed
from rmesh_nlp.report.style import TWO_COLUMNS, legend_columns, look, new_figure


def stress_figure(curves: Mapping[str, Fields], units: Units = NO_UNITS) -> Figure:
    """Contact stress of each solution, and the tangential one with its bound where there is friction.

    Parameters
    ----------
    curves : mapping from names to Fields, the given grid first
    units : Units
        What stands in the labels of the axes.
    """
    fields = list(curves.values())
    elastic = fields[0].displacement.shape[0] == 2
    unit = bracketed(units.stress) if elastic else ""
    frictional = any(np.any(field.friction_bound > 0) for field in fields)
    figure = new_figure(TWO_COLUMNS, 4.6 if frictional else 2.6)
    axes = figure.subplots(2 if frictional else 1, 1, sharex=True, squeeze=False)[:, 0]
    direction = _direction(fields[0])
    for position, (name, field) in enumerate(curves.items()):
        where = np.flatnonzero(field.contact)
        where = where[np.argsort(field.nodes[direction, where])]
        style = look(position)
        for axis, values in zip(axes, (field.pressure, field.tangential_stress), strict=False):
            axis.plot(
                field.nodes[direction, where],
                values[where],
                color=style.color,
                linestyle=style.linestyle,
                marker=style.marker,
                markersize=style.size,
                markerfacecolor="none",
                label=name,
            )
    axes[0].set_ylabel(f"contact stress{unit}")
    if frictional:
        axes[1].set_ylabel(f"tangential stress{unit}")
        _bounds(figure, fields[0], direction)
    axes[-1].set_xlabel(f"$x_{direction + 1}${bracketed(units.length)} on the contact boundary")
    handles, names = axes[-1].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=legend_columns(names))
    return figure


def _bounds(figure: Figure, field: Fields, direction: int) -> None:
    """Lines at plus and minus the friction bound."""
    where = np.flatnonzero(field.contact)
    where = where[np.argsort(field.nodes[direction, where])]
    axis = figure.axes[1]
    for sign, name in ((1, "friction bound ±g"), (-1, None)):
        axis.plot(
            field.nodes[direction, where],
            sign * field.friction_bound[where],
            color="0.5",
            linewidth=0.9,
            linestyle=(0, (6, 2)),
            label=name,
        )


def _direction(field: Fields) -> int:
    """The coordinate along which the contact boundary runs."""
    return int(np.argmax(np.ptp(field.nodes[:, field.contact], axis=1)))
