"""Tables and the figure of the benchmark of orders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from best_mesh.rows import Row, at, figure, of

UNIFORM, ADAPTIVE, RELOCATED, REMESHED = "uniform", "h-adaptive", "relocated", "remeshed, relocated"
REFERENCE, POLYGON = "reference", "polygon"
METHODS = {
    UNIFORM: ("#000000", "o"),
    ADAPTIVE: ("#56B4E9", "D"),
    RELOCATED: ("#D55E00", "^"),
    REMESHED: ("#009E73", "*"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers) and marker."""

SHOWN = {"L-shape r^(2/3)": r"L-shape, $r^{2/3}$", "6.1": "Example 6.1", "wedge": "wedge with friction"}
"""Cases of the figure, and what they are called there."""

MANY = 1000
"""Nodes from which on times are compared."""


def limit(rows: Sequence[Row], case: str, method: str, size: int) -> tuple[float, float]:
    """The energy that those of two meshes tend to like one over the square of the nodes, and its doubt."""
    found = [r for r in rows if (r.case, r.method, r.size) == (case, method, size) and r.nodes]
    if len(found) < 2:
        return float("nan"), float("nan")
    coarse, fine = found
    rest = (coarse.error - fine.error) / ((fine.nodes / coarse.nodes) ** 2 - 1)
    return fine.error - rest, abs(rest)


def tables(rows: Sequence[Row]) -> str:
    """All of them, in Markdown."""
    return "\n".join((factors(rows), orders(rows), times(rows), polygons(rows)))


def factors(rows: Sequence[Row]) -> str:
    """Error of uniform meshes over that of the others with as many unknowns, and rates, at order 2."""
    methods, rated = (ADAPTIVE, RELOCATED, REMESHED), (UNIFORM, RELOCATED, REMESHED)
    lines = _head(
        ["problem", "nodes", "error, uniform", "known to", *methods, *(f"rate, {m}" for m in rated)]
    )
    for case in _cases(rows):
        doubt, found = limit(rows, case, REFERENCE, 0)[1], _at_equal_unknowns(rows, case, 2)
        for (before, old), (nodes, errors) in zip([(0, {}), *found], found, strict=False):
            cells = [figure(errors[UNIFORM]), figure(doubt)]
            cells += [figure(errors[UNIFORM] / errors[m]) for m in methods]
            rates = [np.log(old[m] / errors[m]) / np.log(nodes / before) for m in rated if old]
            cells += [f"{rate:.2f}" if np.isfinite(rate) else "-" for rate in rates or [np.nan] * len(rated)]
            lines.append(f"| {case} | {nodes} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def orders(rows: Sequence[Row]) -> str:
    """Errors of order 1 over those of order 2, with as many unknowns."""
    lines = _head(["problem", "nodes", *METHODS, "order 1 uniform over order 2 remeshed, relocated"])
    for case in _cases(rows):
        found = (_at_equal_unknowns(rows, case, order) for order in (1, 2))
        for (nodes, one), (_, two) in zip(*found, strict=True):
            ratios = [*(one[m] / two[m] for m in METHODS), one[UNIFORM] / two[REMESHED]]
            lines.append(f"| {case} | {nodes} | {' | '.join(map(figure, ratios))} |")
    return "\n".join(lines) + "\n"


def times(rows: Sequence[Row]) -> str:
    """Processor times over those of uniform and h-adaptive meshes of scikit-fem at equal error, at order 2.

    Where no mesh that was measured reaches the error, the last ones are continued: with the rate of the
    error, and with a time in proportion to the nodes, so that the ratio is a bound.
    """
    lines = _head(["problem", "method", "nodes", "over uniform", "over h-adaptive"])
    for case in _cases(rows):
        for method in (RELOCATED, REMESHED):
            for row in (r for r in of(rows, case, f"P2 {method}") if r.nodes >= MANY):
                cells = []
                for peer in (UNIFORM, ADAPTIVE):
                    known = [r for r in of(rows, case, f"P2 {peer}")[::-1] if np.isfinite(r.seconds)]
                    errors, seconds = ([getattr(r, name) for r in known] for name in ("error", "seconds"))
                    if len(known) > 1 and row.error < errors[0]:
                        rate = np.log(errors[1] / errors[0]) / np.log(known[0].nodes / known[1].nodes)
                        least = seconds[0] * (errors[0] / row.error) ** (1 / rate)
                        cells.append(f"< {figure(row.seconds / least)}")
                    else:
                        cells.append(figure(row.seconds / at(errors, seconds, row.error)))
                lines.append(f"| {case} | {method} | {row.nodes} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def polygons(rows: Sequence[Row]) -> str:
    """What the energy changes by if a curved boundary is replaced by the polygon of a mesh."""
    lines = _head(["problem", "nodes", "the polygon's own error", "over that of the elements, uniform"])
    for case in _cases(rows):
        exact = limit(rows, case, REFERENCE, 0)[0]
        uniform = of(rows, case, f"P2 {UNIFORM}")
        sizes = sorted({r.size for r in rows if (r.case, r.method) == (case, POLYGON)})
        for size, given in zip(sizes, uniform, strict=False):
            own = abs(limit(rows, case, POLYGON, size)[0] - exact)
            lines.append(f"| {case} | {given.nodes} | {figure(own)} | {figure(own / given.error)} |")
    return "\n".join(lines) + "\n"


def picture(rows: Sequence[Row]) -> Figure:
    """Error against unknowns and against time: orders 1 (open, dashed) and 2 of all methods."""
    sheet = Figure(figsize=(12, 8.2), layout="constrained")
    axes = sheet.subplots(2, len(SHOWN), sharey="col")
    for column, (case, title) in enumerate(SHOWN.items()):
        for order in (1, 2):
            for method, (colour, marker) in METHODS.items():
                label = f"order {order}, {method}"
                face = "white" if order == 1 else colour
                look = {"color": colour, "marker": marker, "markerfacecolor": face, "label": label}
                look |= {"linestyle": "--" if order == 1 else "-", "markersize": 8 if marker == "*" else 5}
                part = of(rows, case, f"P{order} {method}")
                for row, x in enumerate(("nodes", "seconds")):
                    axes[row, column].loglog(*_columns(part, x), **look)
        axes[0, column].set(title=title, xlabel="unknown nodes")
        axes[1, column].set(xlabel="processor time [s]")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    for axis in axes[:, 0]:
        axis.set_ylabel("error (squared energy norm)")
    sheet.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=10)
    return sheet


def _columns(rows: Sequence[Row], x: str) -> tuple[list[float], list[float]]:
    return [getattr(r, x) for r in rows], [r.error for r in rows]


def _cases(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(r.case for r in rows))


def _at_equal_unknowns(rows: Sequence[Row], case: str, order: int) -> list[tuple[int, dict[str, float]]]:
    """Nodes of the relocated meshes of order 2, and the errors of as many by all methods at an order.

    New meshes have a few more or less: as if errors fell by the power of the order.
    """
    own = {method: of(rows, case, f"P{order} {method}") for method in METHODS}
    result = []
    for number, nodes in enumerate(row.nodes for row in of(rows, case, f"P2 {RELOCATED}")):
        found = {}
        for method, known in own.items():
            if method in (UNIFORM, ADAPTIVE):
                found[method] = at([r.nodes for r in known], [r.error for r in known], nodes)
            else:
                same = known[number] if number < len(known) else Row(case, method, 0, 0, float("nan"))
                found[method] = same.error * (same.nodes / nodes) ** order
        result.append((nodes, found))
    return result


def _head(columns: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(columns) + " |", "|:--|" + "--:|" * (len(columns) - 1)]
