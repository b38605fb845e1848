"""Random design problems: ``nested`` and ``mpcc`` from two starts, judged alike.

    python scripts/benchmark_designs.py --seeds 0 50 --out rows.jsonl    solves what is not in the file yet
    python scripts/benchmark_designs.py --read rows.jsonl                shows the table

Each problem of :mod:`random_designs` is solved from the design as given and from a random
one. Of every end that is called stationary all branches of its biactive pairs are searched for a direction of
descent (:mod:`branches`), with none of the code that gave the label. Gradients are checked by Taylor's
formula at random designs away from kinks.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from branches import steepest
from formulations.mpcc import AllAtOnce
from formulations.nested import Nested
from random_designs import random_design
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.monitor import Limits, Monitor
from rmesh_nlp.solving.outer import Outer

FORMULATIONS = {"nested": Nested, "mpcc": AllAtOnce}

STARTS = {"given": None, "seed": 1}

REACHED, OF_GAIN = 1e-4, 1e-6
"""An end has reached the best if it is above it by less than these parts of its value and of the gain."""

WORK = 6_000
"""Branches times outer variables beyond which no branch is searched."""

STEPS, ROUNDED = (1e-3, 1e-4), 1e-9
"""Of Taylor tests, in outer variables, and their least remainder above rounding, relative to the slope."""

Row = dict[str, Any]


def solved(seed: int, formulation: str, start: str, seconds: float) -> Row:
    """One solve: how it ended, what it cost, and whether a branch descends."""
    found = random_design(seed)
    began = time.process_time()
    row: Row = {"seed": seed, "formulation": formulation, "start": start, "objective": found.objective}
    try:
        outer, monitor = Outer.of(found.problem, found.objective), Monitor(Limits(seconds=seconds))
        first = outer.variables(seed=STARTS[start])
        outcome = monitor.run(FORMULATIONS[formulation](), outer, first)
        end = assess(outer, outcome)
    except Exception as error:  # whatever happens leaves a row
        return {**row, "status": type(error).__name__, "message": str(error), "valid": False}
    conditions = end.first_order
    point, begin = outer.function(outcome.q), outer.function(np.zeros(outer.n))
    row |= {"status": end.status.value, "said": outcome.status.value, "valid": end.valid, "n": outer.n}
    row |= {"success": end.success, "residual": conditions.residual, "label": conditions.stationarity}
    row |= {"b_stationary": conditions.label.b_stationary if conditions.label else None}
    row |= {"pairs": conditions.label.biactive if conditions.label else 0}
    row |= {"value": point.value, "violation": outer.merit(point)[0], "first": begin.value}
    row |= {"first_violation": outer.merit(begin)[0], "friction": _friction(outer)}
    row |= {"constraints": [str(one.value) for one in found.problem.constraints]}
    row |= {"iterations": monitor.iterations, "contact_solves": outer.spent.contact_solves}
    row |= {"cpu_s": time.process_time() - began, "rate": None}
    if row["b_stationary"] and np.any(point.weak):
        searched = steepest(outer, outcome.q, WORK // outer.n)
        row |= {"rate": searched.rate, "branches": searched.branches} if searched else {}
    return row


def _friction(outer: Outer) -> str:
    obstacle = outer.problem.contact_sets[0].obstacle
    return "coulomb" if obstacle.has_coulomb else "tresca" if obstacle.has_bound else "none"


def taylor(seed: int) -> Row:
    """Order of the remainder of the first-order formula along random directions, away from kinks."""
    found, rng = random_design(seed), np.random.default_rng(seed)
    outer = Outer.of(found.problem, found.objective)
    for attempt in range(40):
        q = outer.clipped(0.5 * outer.variables(seed=attempt + 1))
        d = rng.uniform(-1, 1, outer.n)
        for step in STEPS:
            points = [outer.function(q + h * d) for h in (0.0, step, step / 2)]
            if any(np.any(one.weak) for one in points) or len({_contact(one) for one in points}) > 1:
                continue
            here, *others = points
            slope = float(here.gradient @ d)
            one, two = (
                abs(p.value - here.value - h * slope) for p, h in zip(others, (step, step / 2), strict=True)
            )
            if two > ROUNDED * max(abs(here.value), abs(slope)):
                return {"seed": seed, "order": float(np.log2(one / two)), "step": step}
    return {"seed": seed, "order": None}


def _contact(point: ReducedPoint) -> bytes:
    return point.equilibrium.active.key()


def best_reached(rows: list[Row]) -> dict[tuple[int, str], bool]:
    """By (seed, formulation): whether the better of its ends reaches the best of all ends of the problem."""
    result = {}
    for seed in sorted({row["seed"] for row in rows}):
        own = [row for row in rows if row["seed"] == seed]
        ends = {
            name: min([_value(row) for row in own if row["formulation"] == name], default=np.inf)
            for name in FORMULATIONS
        }
        best = min(ends.values())
        first = next((row["first"] for row in own if row["valid"]), 0.0)
        if np.isfinite(best):
            aim = best + REACHED * abs(best) + OF_GAIN * abs(first - best)
            result |= {(seed, name): end <= aim for name, end in ends.items()}
    return result


def _value(row: Row) -> float:
    return row["value"] if row["valid"] else np.inf


def shown(rows: list[Row]) -> str:
    """A table of counts by formulation."""
    reached, lines = best_reached(rows), []
    for name in FORMULATIONS:
        own = [row for row in rows if row["formulation"] == name]
        ended = [row for row in own if "n" in row]
        valid = [row for row in own if row["valid"]]
        good = [row for row in valid if row["success"]]
        claimed = [row for row in ended if row["b_stationary"] and row["pairs"]]
        searched = [row for row in claimed if row["rate"] is not None]
        first = [value for (_, which), value in reached.items() if which == name]
        lines += [
            f"{name}: {len(own)} solves, {len(valid)} valid, {len(good)} successes, best of all reached on"
            f" {sum(first)} of {len(first)} problems",
            f"  status {dict(Counter(row['status'] for row in own).most_common())}",
            f"  B-stationary {sum(row['b_stationary'] is True for row in ended)}, not"
            f" {sum(row['b_stationary'] is False for row in ended)}, undecided"
            f" {sum(row['b_stationary'] is None for row in ended)}; labels"
            f" {dict(Counter(row['label'] for row in ended).most_common())}",
            f"  biactive and B-stationary {len(claimed)}, branches searched {len(searched)}, steepest descent"
            f" {min([row['rate'] for row in searched], default=0.0):.1e}",
        ]
        if ended:
            middle = {k: median(row[k] for row in ended) for k in ("iterations", "contact_solves", "cpu_s")}
            lines.append(
                f"  medians: {middle['iterations']:.0f} iterations, {middle['contact_solves']:.0f} contact"
                f" solves, {middle['cpu_s']:.2f} s; in all {sum(row['cpu_s'] for row in ended):.0f} s"
            )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Solve what is not in the file yet, or show it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 200))
    parser.add_argument("--formulations", default=",".join(FORMULATIONS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--gradients", action="store_true", help="Taylor tests alone")
    parser.add_argument("--out", type=Path, default=Path("designs.jsonl"))
    parser.add_argument("--read", type=Path)
    given = parser.parse_args(arguments)
    path = given.read or given.out
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if given.gradients:
        orders = [taylor(seed)["order"] for seed in range(*given.seeds)]
        off = [abs(order - 2) for order in orders if order is not None]
        print(f"{len(off)} of {len(orders)} designs away from kinks; order 2 within {max(off):.4f},", end=" ")
        print(f"within 0.02 on {sum(one <= 0.02 for one in off)}")
        return
    done = {(row["seed"], row["formulation"], row["start"]) for row in rows}
    for seed in range(*given.seeds) if given.read is None else ():
        for name in given.formulations.split(","):
            for start in STARTS:
                if (seed, name, start) in done:
                    continue
                rows.append(row := solved(seed, name, start, given.seconds))
                with given.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                words = ("status", "said", "label", "residual", "value", "violation", "iterations", "cpu_s")
                print(seed, name, start, *(f"{row.get(word, '')}"[:12] for word in words), flush=True)
    print(shown(rows))


if __name__ == "__main__":
    main()
