"""Rows of the benchmark, kept as JSON lines as they are measured, and the tables and the figure of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

GIVEN, QUADRATIC, ADAPTIVE = "uniform", "P2, uniform", "h-adaptive"
METRIC, LOOP = "metric", "metric, adaptive loop"
RELOCATED, REMESHED, ATTAINABLE = "relocated", "remeshed, relocated", "attainable"
STYLES = {
    GIVEN: ("#000000", "o", "-"),
    QUADRATIC: ("#E69F00", "x", "-"),
    ADAPTIVE: ("#56B4E9", "D", "-"),
    LOOP: ("#0072B2", "s", "-"),
    RELOCATED: ("#D55E00", "^", "-"),
    REMESHED: ("#009E73", "*", "-"),
    ATTAINABLE: ("#000000", "", "--"),
}
"""Colour (Okabe and Ito's, told apart by colour-blind readers), marker and line of what is drawn."""

LABELS = {
    GIVEN: "uniform mesh",
    QUADRATIC: "second order, uniform mesh",
    ADAPTIVE: "h-adaptive (scikit-fem)",
    LOOP: "Mmg with the recovered metric",
    ATTAINABLE: "attainable with linear elements",
}

NEAR = 1e-3
"""How far beyond its ends a curve is read."""

SHARE, MANY = 0.7, 300
"""The share of what is attainable that is enough; nodes from which on times are compared."""


@dataclass(frozen=True)
class Row:
    """One mesh of one method.

    Attributes
    ----------
    case, method, size
        Rows with the same three were measured together.
    nodes : int
        With the midpoints of edges for quadratic elements.
    error : float
        Of the energy, or half the squared error in the energy norm, as the case says.
    seconds : float
        Processor time to this mesh, model build included; NaN where it means nothing.
    status : str
        Of a relocation; of what is attainable, how well the reference is known.
    """

    case: str
    method: str
    size: int
    nodes: int
    error: float
    seconds: float = float("nan")
    status: str = ""


class Store:
    """A file of rows: a run that is broken off goes on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = path.read_text().splitlines() if path.exists() else []
        self.rows = [Row(**json.loads(line)) for line in lines]

    def has(self, case: str, method: str, size: int) -> bool:
        """Whether these were measured before."""
        return any((r.case, r.method, r.size) == (case, method, size) for r in self.rows)

    def keep(self, rows: Iterable[Row]) -> None:
        """Append rows, and show them."""
        new = list(rows)
        with self._path.open("a") as file:
            file.writelines(json.dumps(asdict(row)) + "\n" for row in new)
        for r in new:
            line = f"{r.case:20} {r.method:22} {r.nodes:6} {r.error:.4g} {r.seconds:8.3f} s"
            print(line, r.status, flush=True)
        self.rows += new


def of(rows: Iterable[Row], case: str, method: str) -> list[Row]:
    """Rows of a method on a case, by number of nodes."""
    found = {r.nodes: r for r in rows if (r.case, r.method) == (case, method) and np.isfinite(r.error)}
    return [found[nodes] for nodes in sorted(found)]


def at(x: Sequence[float], y: Sequence[float], value: float) -> float:
    """The y that belongs to a value of x, log-log between neighbours; NaN beyond the ends; x rises."""
    if len(x) < 2 or not x[0] * (1 - NEAR) <= value <= x[-1] * (1 + NEAR):
        return float("nan")
    lx, ly = np.log(x), np.log(y)
    k = int(np.clip(np.searchsorted(lx, np.log(value)), 1, len(x) - 1))
    slope = (ly[k] - ly[k - 1]) / (lx[k] - lx[k - 1])
    return float(np.exp(ly[k - 1] + slope * (np.log(value) - lx[k - 1])))


def factors(rows: Sequence[Row], given: Row) -> dict[str, float]:
    """Error of a given mesh over those of all methods, at equal nodes."""
    found = {r.method: r for r in rows if (r.case, r.size) == (given.case, given.size) and r.nodes}
    result = {
        name: given.error / r.error * given.nodes / r.nodes
        for name, r in found.items()
        if name in (METRIC, RELOCATED, REMESHED, ATTAINABLE)
    }
    for name in (QUADRATIC, ADAPTIVE):
        own = of(rows, given.case, name)
        result[name] = given.error / at([r.nodes for r in own], [r.error for r in own], given.nodes)
    return result


COLUMNS = (QUADRATIC, ADAPTIVE, METRIC, RELOCATED, REMESHED)


def table(rows: Sequence[Row], goals: Mapping[tuple[str, int], float]) -> str:
    """Factors over the given mesh at equal nodes, in Markdown.

    Goals are by case and size. A share of what is attainable is enough if that is less, but not on 6.1 and
    the L-shapes.
    """
    head = ["problem", "nodes", *COLUMNS, "goal", "met", ATTAINABLE, "share", "s relocated", "s remeshed"]
    lines = ["| " + " | ".join(head) + " |", "|:--|" + "--:|" * (len(head) - 1)]
    for given in (r for r in rows if r.method == GIVEN and r.nodes):
        found = factors(rows, given)
        most, best = (found.get(name, np.nan) for name in (ATTAINABLE, REMESHED))
        goal = goals.get((given.case, given.size), np.nan)
        if given.case not in ("6.1", "L-shape") and "jNO" not in given.case:
            goal = np.minimum(goal, SHARE * most)
        met = "" if np.isnan(goal) else "yes" if best >= goal else "no"
        seconds = {r.method: r.seconds for r in rows if (r.case, r.size) == (given.case, given.size)}
        cost = [seconds.get(name, np.nan) for name in (RELOCATED, REMESHED)]
        cells = [figure(found.get(name, np.nan)) for name in COLUMNS]
        cells += [figure(goal), met, *map(figure, (most, best / most, *cost))]
        lines.append(f"| {given.case} | {given.nodes} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def times(rows: Sequence[Row]) -> str:
    """Processor times over those of h-adaptive refinement at equal error, in Markdown."""
    lines = ["| problem | method | nodes | s | over h-adaptive's |", "|:--|:--|--:|--:|--:|"]
    for case in dict.fromkeys(r.case for r in rows):
        known = [r for r in of(rows, case, ADAPTIVE)[::-1] if np.isfinite(r.seconds)]
        errors, seconds = ([getattr(r, name) for r in known] for name in ("error", "seconds"))
        for method in (LOOP, RELOCATED, REMESHED):
            own = [r for r in of(rows, case, method) if r.nodes >= MANY]
            ratios = [r.seconds / at(errors, seconds, r.error) for r in own]
            if np.any(np.isfinite(ratios)):
                columns = [str(r.nodes) for r in own], [f"{r.seconds:.2g}" for r in own], map(figure, ratios)
                lines.append(f"| {case} | {method} | {' | '.join(map(', '.join, columns))} |")
    return "\n".join(lines) + "\n"


def figure(value: float) -> str:
    """Three digits, or a dash."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1000 else f"{float(f'{value:.3g}'):.0f}"


def picture(rows: Sequence[Row], case: str = "6.1") -> Figure:
    """Error against nodes and against time."""
    sheet = Figure(figsize=(11, 4.8), layout="constrained")
    axes = sheet.subplots(1, 2, sharey=True)
    for method, (colour, marker, style) in STYLES.items():
        part = of(rows, case, method)
        look = {"color": colour, "marker": marker, "linestyle": style, "markersize": 6}
        for axis, x in zip(axes, ("nodes", "seconds"), strict=True):
            shown = [r for r in part if np.isfinite(getattr(r, x))]
            label = LABELS.get(method, method)
            if shown:
                axis.loglog([getattr(r, x) for r in shown], [r.error for r in shown], label=label, **look)
    axes[0].set(xlabel="nodes", ylabel=f"error of the energy, Example {case}")
    axes[1].set(xlabel="processor time [s]")
    for axis in axes:
        axis.grid(alpha=0.3)
    sheet.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
    return sheet
