"""Solve many problems, ours beside the plain loop: records, a table, a performance profile."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rmesh_nlp.display import for_markdown, for_spreadsheet
from rmesh_nlp.mpcc.families import FAMILIES
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.plain import plain_loop
from rmesh_nlp.mpcc.reading import READERS, Problem, read, read_collection
from rmesh_nlp.mpcc.solver import solve

WORSE = 1e-3  # an objective is worse than another if it is above it by this, relative
REACHED = 1e-4  # and at a known value within this, relative
_FLOOR = 1e-3  # objectives smaller than this are compared absolutely


def files(paths: Sequence[Path]) -> list[Path]:
    """Files to read: folders stand for the files in them whose format is known."""
    found: list[Path] = []
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in READERS)
        if not inside:
            raise ValueError(f"{path}: no file with one of the endings {', '.join(READERS)}")
        found += inside
    return found


def from_families(names: Sequence[str], sizes: int, seeds: int) -> Iterator[tuple[str, Problem]]:
    """Problems of generated families: of each the first ``sizes`` sizes, with ``seeds`` seeds.

    Names may be ``all``, ``chosen`` (families that chose the defaults) and ``held-out`` (the others).
    """
    groups = {
        "all": list(FAMILIES),
        "chosen": [name for name, family in FAMILIES.items() if family.chose_defaults],
        "held-out": [name for name, family in FAMILIES.items() if not family.chose_defaults],
    }
    for name in [part for given in names for part in groups.get(given, [given])]:
        if name not in FAMILIES:
            raise ValueError(f"unknown family {name!r}; there are {', '.join([*groups, *FAMILIES])}")
        for size in FAMILIES[name].sizes[:sizes]:
            for seed in range(seeds):
                instance = FAMILIES[name].make(size, seed)
                yield name, Problem(instance.name, instance.mpcc, instance.x0)


def from_files(paths: Iterable[Path]) -> Iterator[tuple[str, Problem]]:
    """Problems of files, the group is the folder; a Python file is a collection and a group of its own."""
    for path in paths:
        if path.suffix == ".py":
            yield from ((path.stem, problem) for problem in read_collection(path))
        else:
            yield path.parent.name, read(path)


def record(group: str, problem: Problem, options: Options, plain: bool) -> dict[str, Any]:
    """Solve one problem; what raises is a row with the message as status, never a gap."""
    row: dict[str, Any] = {
        "group": group, "problem": problem.name, "unknowns": problem.mpcc.n_x, "pairs": problem.mpcc.n_pairs,
    }  # fmt: skip
    row.update(_ours(problem, options))
    if np.isfinite(problem.target):
        row.update(target=problem.target, reached=row["success"] and at_target(row["f"], problem.target))
    if plain:
        row.update(_plain(problem, options.time_limit_s))
        both = row["success"] and row["plain_success"]
        row["compared"] = _compare(problem.sign * row["f"], problem.sign * row["plain_f"]) if both else ""
        if np.isfinite(problem.target):
            row["plain_reached"] = row["plain_success"] and at_target(row["plain_f"], problem.target)
    return row


def _ours(problem: Problem, options: Options) -> dict[str, Any]:
    began, cpu = time.perf_counter(), time.process_time()
    try:
        result = solve(problem.mpcc, problem.x0, p=problem.p0, options=options)
    except Exception as error:  # kept as a row
        return {
            "status": f"{type(error).__name__}: {error}", "success": False, "f": float("nan"), "label": "",
            "iterations": 0, "seconds": time.perf_counter() - began,
            "cpu_seconds": time.process_time() - cpu,
        }  # fmt: skip
    return {
        "status": result.status.value, "success": result.success, "f": problem.sign * result.f,
        "constraint_violation": result.constraint_violation, "complementarity": result.complementarity,
        "stationarity": result.stationarity, "n_biactive": result.n_biactive, "label": result.label,
        "b_stationary": result.b_stationary, "iterations": result.counts["ipopt_iterations"],
        "nlp_solves": result.counts["nlp_solves"], "rescues": result.counts["rescues"],
        "seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - cpu,
    }  # fmt: skip


def _plain(problem: Problem, limit: float) -> dict[str, Any]:
    cpu = time.process_time()
    try:
        end = plain_loop(problem.mpcc, problem.x0, problem.p0, time_limit_s=limit)
    except Exception as error:  # kept as a row
        return {"plain_status": f"{type(error).__name__}: {error}", "plain_success": False,
                "plain_f": float("nan"), "plain_iterations": 0, "plain_seconds": float("nan"),
                "plain_cpu_seconds": float("nan")}  # fmt: skip
    return {
        "plain_status": end.status, "plain_success": end.success, "plain_f": problem.sign * end.f,
        "plain_constraint_violation": end.constraint_violation, "plain_complementarity": end.complementarity,
        "plain_iterations": end.iterations, "plain_seconds": end.seconds,
        "plain_cpu_seconds": time.process_time() - cpu,
    }  # fmt: skip


def at_target(f: float, target: float) -> bool:
    """Whether an objective is the best known one, relative to max(1, |target|)."""
    return abs(f - target) <= REACHED * max(1.0, abs(target))


def _compare(ours: float, theirs: float) -> str:
    """``worse``, ``better`` or ``equal``: local minima, told apart by their objectives (minimised)."""
    margin = WORSE * max(abs(ours), abs(theirs), _FLOOR)
    return "worse" if ours > theirs + margin else "better" if theirs > ours + margin else "equal"


def run(
    problems: Iterable[tuple[str, Problem]],
    options: Options | None = None,
    *,
    plain: bool = True,
    out: Path | None = None,
    show: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Solve all; each row is shown and appended to ``out/records.jsonl`` as soon as it is there."""
    settings = options or Options()
    rows = []
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "records.jsonl").write_text("")
    for group, problem in problems:
        row = record(group, problem, settings, plain)
        rows.append(row)
        if show is not None:
            show(line(row))
        if out is not None:
            with (out / "records.jsonl").open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")
    if out is not None and rows:
        write(rows, out)
    return rows


def line(row: dict[str, Any]) -> str:
    """One row for the screen."""
    text = f"{row['problem']:26} {row['status'][:16]:16} f = {row['f']:<15.9g} "
    text += f"{row['iterations']:5d} iterations {row['seconds']:7.2f} s  {row['label']}"
    if not row.get("reached", True):
        text += f" (best known {row['target']:.9g})"
    if "plain_f" in row:
        text += f" | plain {row['plain_f']:<13.7g} {row['plain_iterations']:5d} {row['compared']}"
    return text


def table(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One line per group and a total: counts of success and of better and worse minima, iterations, time."""
    frame = pd.DataFrame(rows)
    parts = [(str(name), part) for name, part in frame.groupby("group", sort=False)] + [("all", frame)]
    lines, targets = [], "reached" in frame
    for name, part in parts:
        cpu = part["cpu_seconds"]
        entry: dict[str, Any] = {
            "group": name, "problems": len(part), "solved": int(part["success"].sum()),
            "iterations": int(part["iterations"].sum()), "cpu [s]": round(cpu.sum(), 2),
        }  # fmt: skip
        if "plain_f" in part:
            theirs, compared = part["plain_cpu_seconds"], part["compared"]
            if targets:
                known = part["reached"].notna()
                entry["at target"] = f"{int(part['reached'].eq(True).sum())}/{int(known.sum())}"
                entry["plain at target"] = f"{int(part['plain_reached'].eq(True).sum())}/{int(known.sum())}"
            entry["plain solved"] = int(part["plain_success"].sum())
            entry["better"], entry["worse"] = (
                int((compared == "better").sum()),
                int((compared == "worse").sum()),
            )
            entry["plain iterations"] = int(part["plain_iterations"].sum())
            entry["plain cpu [s]"] = round(theirs.sum(), 2)
            entry["time ratio"] = round(cpu.sum() / theirs.sum(), 2)
            entry["median ratio"] = round(float((cpu / theirs).median()), 2)
        lines.append(entry)
    return pd.DataFrame(lines)


def markdown(frame: pd.DataFrame) -> str:
    """A Markdown table."""
    rows = [list(frame.columns), ["---"] * len(frame.columns), *frame.astype(str).to_numpy().tolist()]
    return for_markdown("\n".join("| " + " | ".join(row) + " |" for row in rows))


def write(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Write ``table.md``, ``records.csv`` and, with the plain loop, ``profile.png``."""
    (out / "table.md").write_text(markdown(table(rows)) + "\n", encoding="utf-8")
    frame = pd.DataFrame(rows).apply(lambda column: column.map(for_spreadsheet))
    frame.to_csv(out / "records.csv", index=False)
    if "plain_f" in rows[0]:
        _profile(rows, out / "profile.png")


def _profile(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Performance profile in iterations: share of problems solved within a factor of the better solver.

    E. D. Dolan and J. J. More, Benchmarking optimization software with performance profiles, Math. Program.
    91 (2002) 201-213. A minimum worse than the other's counts as not solved.
    """
    from matplotlib.figure import Figure

    ours = [r["success"] and r["compared"] != "worse" for r in rows]
    theirs = [r["plain_success"] and r["compared"] != "better" for r in rows]
    solved = np.array([ours, theirs]).T
    cost = np.array([[r["iterations"], r["plain_iterations"]] for r in rows], dtype=float)
    cost = np.where(solved, np.maximum(cost, 1.0), np.inf)
    best = cost.min(axis=1)
    ratio = cost / np.where(np.isfinite(best), best, 1.0)[:, None]
    figure = Figure(figsize=(5, 3.5))
    axes = figure.subplots()
    factors = np.geomspace(1, max(10.0, float(np.max(ratio[np.isfinite(ratio)], initial=1.0)) * 1.1), 200)
    for k, name in enumerate(("rmesh_nlp.mpcc", "plain Scholtes loop")):
        axes.step(factors, [(ratio[:, k] <= factor).mean() for factor in factors], where="post", label=name)
    axes.set(xscale="log", ylim=(0, 1.03), xlabel="iterations / those of the better", ylabel="share solved")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
