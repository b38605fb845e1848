"""Tables from the rows, with what was to be reached; nothing is typed by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from worth.cases import CASES
from worth.rows import Row

Goal = tuple[str, str, str, bool | None]
"""What, the goal, what was measured, and whether it is met; None where nothing was to be reached."""

RELOCATED = ("large moves", "large moves, flips")

WANTED = {
    "6.3": (2.0, 2.5, 3.0),
    "wedge": (3.0,),
    "free boundary": (2.5,),
    "plate": (2.5,),
    "L-shape": (4.0,),
    "Hertz": (2.0,),
    "Signorini": (2.0,),
}
"""Times less error than the uniform grid that was to be reached, at each size or one for all."""


def of(rows: Iterable[Row], case: str, method: str) -> list[Row]:
    """Rows of a method on a case, by number of nodes; of a mesh that was measured twice the last."""
    found = {r.nodes: r for r in rows if (r.case, r.method) == (case, method)}
    return [found[nodes] for nodes in sorted(found)]


def at_nodes(rows: list[Row], nodes: float) -> float:
    """Error at a number of nodes, log-log between neighbours and beyond the last."""
    return _between([r.nodes for r in rows], [r.error for r in rows], nodes)


def at_error(rows: list[Row], error: float, what: str = "nodes") -> float:
    """Nodes, or another figure, where the error falls to a value."""
    falling = rows[::-1]
    return _between([r.error for r in falling], [getattr(r, what) for r in falling], error)


def _between(x: list[float], y: list[float], at: float) -> float:
    if len(x) < 2:
        return float("nan")
    lx, ly = np.log(x), np.log(y)
    k = int(np.clip(np.searchsorted(lx, np.log(at)), 1, len(x) - 1))
    slope = (ly[k] - ly[k - 1]) / (lx[k] - lx[k - 1])
    return float(np.exp(ly[k - 1] + slope * (np.log(at) - lx[k - 1])))


def rate(rows: list[Row]) -> float:
    """Exponent r of error ~ nodes^-r, by least squares over the rows."""
    if len(rows) < 2:
        return float("nan")
    return -float(np.polyfit(np.log([r.nodes for r in rows]), np.log([r.error for r in rows]), 1)[0])


def goals(rows: list[Row]) -> str:
    """What was to be reached, what is, and whether, in Markdown."""
    parts: tuple[Callable[[list[Row]], Iterator[Goal]], ...]
    parts = (_factors_61, _nodes_61, _cost_61, _time_61, _rates, _other_cases, _hertz, _part, _large)
    lines = ["| what | goal | measured | met |", "|---|---|---|---|"]
    for part in parts:
        for what, goal, measured, met in part(rows):
            answer = "-" if met is None else "yes" if met else "no"
            lines.append(f"| {what} | {goal} | {measured} | {answer} |")
    return "\n".join(lines) + "\n"


BEGIN, END = "<!-- goals: begin -->", "<!-- goals: end -->"


def on_page(page: str, rows: list[Row]) -> str:
    """A page with its table of goals, between its two marks, made anew."""
    head, rest = page.split(BEGIN)
    return f"{head}{BEGIN}\n{goals(rows)}{END}{rest.split(END)[1]}"


def _factors_61(rows: list[Row]) -> Iterator[Goal]:
    grid = of(rows, "6.1", "uniform")
    for method, least in zip(RELOCATED, (8.0, 10.0), strict=True):
        found = of(rows, "6.1", method)
        if found:
            factors = [at_nodes(grid, r.nodes) / r.error for r in found]
            what = f"6.1, {method}: times less error than the uniform grid at {_nodes(found)} nodes"
            yield what, f"{least:g} at each", _figures(factors), min(factors) >= least


def _nodes_61(rows: list[Row]) -> Iterator[Goal]:
    oracle = of(rows, "6.1", "h-adaptive, oracle")
    if not oracle:
        return
    for method, most in ((RELOCATED[0], 1 / 3), (RELOCATED[1], 1 / 3), ("hr", 1 / 4)):
        found = [r for r in of(rows, "6.1", method) if r.error < oracle[0].error]
        if found:
            parts = [r.nodes / at_error(oracle, r.error) for r in found]
            what = f"6.1, {method}: nodes over those of h-refinement with an oracle at equal error"
            yield what, f"{most:.2f}", f"{_figures(parts)} (at {_nodes(found)} nodes)", max(parts) <= most


def _cost_61(rows: list[Row]) -> Iterator[Goal]:
    found = [r for r in of(rows, "6.1", RELOCATED[0]) if r.figures.get("finest")]
    if found:
        finest, every, built = ([r.figures[k] for r in found] for k in ("finest", "all", "built"))
        text = ", ".join(f"{a} / {b}" for a, b in zip(finest, every, strict=True))
        text += f" (statement of the programs {', '.join(map(str, built))} more)"
        what = f"6.1: descents on the finest mesh / all meshes, in contact solves, {_nodes(found)} nodes"
        yield what, "25 / 40", text, max(finest) <= 25 and max(every) <= 40


def _time_61(rows: list[Row]) -> Iterator[Goal]:
    residual = of(rows, "6.1", "h-adaptive, residual estimator")
    if not residual:
        return
    for method in ("hr", *RELOCATED):
        found = [r for r in of(rows, "6.1", method) if r.error < residual[0].error]
        if found:
            ratios = [r.seconds / at_error(residual, r.error, "seconds") for r in found]
            what = (
                f"6.1, {method}: time over that of h-adaptive meshes with a residual estimator at equal error"
            )
            met = max(ratios) <= 1 if method == "hr" else None
            yield what, "1" if method == "hr" else "-", f"{_figures(ratios)} (at {_nodes(found)} nodes)", met


def _rates(rows: list[Row]) -> Iterator[Goal]:
    for method in ("uniform", "h-adaptive, oracle", *RELOCATED):
        found = of(rows, "L-shape", method)
        if len(found) > 1:
            reached = rate(found)
            met = reached >= 0.95 if method in RELOCATED else None
            goal = "(N^-0.67 in the limit)" if method == "uniform" else "N^-1"
            yield f"L-shape, {method}: rate of the error", goal, f"N^-{reached:.2f}", met


def _other_cases(rows: list[Row]) -> Iterator[Goal]:
    for case, wanted in WANTED.items():
        grid = {r.size: r for r in of(rows, case, "uniform")}
        ideal = of(rows, case, "h-adaptive, oracle")
        for method in RELOCATED:
            found = [r for r in of(rows, case, method) if r.size in grid]
            if not found:
                continue
            factors = [grid[r.size].error / r.error for r in found]
            least = wanted if len(wanted) > 1 else wanted * len(factors)
            # nothing is said before every size is there
            met = (
                all(f >= w for f, w in zip(factors, least, strict=False))
                if len(factors) >= len(wanted)
                else None
            )
            text = _figures(factors)
            if len(ideal) > 1:
                behind = _figures(r.error / at_nodes(ideal, r.nodes) for r in found)
                text += f"; error over that of h-refinement with an oracle at equal nodes {behind}"
            measure = "" if CASES[case].measure == "energy" else " (square of the energy norm)"
            what = f"{case}, {method}: times less error{measure} at {_nodes(found)} nodes"
            yield what, ", ".join(f"{w:g}" for w in wanted), text, met


def _hertz(rows: list[Row]) -> Iterator[Goal]:
    grid = {r.size: r for r in of(rows, "Hertz", "uniform")}
    for method in RELOCATED:
        for after in of(rows, "Hertz", method):
            if after.size not in grid:
                continue
            before = grid[after.size].figures
            pairs = [(abs(before[k] - 1), abs(after.figures[k] - 1)) for k in ("half_width", "peak")]
            names = ("half-width", "peak")
            text = "; ".join(f"{k} {a:.1%} to {b:.1%}" for k, (a, b) in zip(names, pairs, strict=True))
            what = f"Hertz, {method}, {after.nodes} nodes: errors of half-width and peak pressure"
            yield what, "halved", text, all(2 * b <= a for a, b in pairs)


def _part(rows: list[Row]) -> Iterator[Goal]:
    for r in of(rows, "acceptance", "rmesh solve"):
        claimed, measured = r.figures["claimed"], r.figures["factor"]
        what = f"`rmesh solve` on a gmsh plate with two holes, {r.nodes} nodes: factor claimed, measured"
        yield what, "equal to 10 %", f"{claimed:.2f}, {measured:.2f}", abs(claimed / measured - 1) <= 0.1


def _large(rows: list[Row]) -> Iterator[Goal]:
    for r in of(rows, "large", RELOCATED[0]):
        minutes, peak = r.seconds / 60, r.figures["peak_gb"]
        spent, factor = r.figures["processor_seconds"] / 60, r.figures["factor"]
        # on one core; wall time on a machine that others use says nothing
        text = f"{spent:.1f} minutes of processor time ({minutes:.1f} by the clock), {peak:.1f} GB"
        text += f"; {factor:.1f} times less error"
        what = f"6.1, {r.figures['triangles']} triangles, without boxes: time, memory"
        yield what, "3 minutes, 4 GB", text, spent <= 3 and peak <= 4


def table(rows: list[Row]) -> str:
    """All rows but those of h-adaptive meshes, in Markdown."""
    head = "| case | method | nodes | error | times less | seconds | units | least area ratio | least angle |"
    lines = [head, "|---|---|--:|--:|--:|--:|--:|--:|--:|"]
    for r in rows:
        if r.case not in CASES or r.method.startswith("h-adaptive"):
            continue
        times = at_nodes(of(rows, r.case, "uniform"), r.nodes) / r.error
        area = f"{r.least_area:.3f}" if np.isfinite(r.least_area) else ""
        lines.append(
            f"| {r.case} | {r.method} | {r.nodes} | {r.error:.3g} | {times:.2f} | {r.seconds:.1f} | "
            f"{r.units:.0f} | {area} | {r.least_angle:.1f} |"
        )
    return "\n".join(lines) + "\n"


def _nodes(rows: list[Row]) -> str:
    return ", ".join(str(r.nodes) for r in rows)


def _figures(values: Iterable[float]) -> str:
    return ", ".join(f"{v:.2f}" for v in values)
