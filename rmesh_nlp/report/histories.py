"""Histories of solves: curves over cost, and what each formulation needs to reach what all of them reach.

Costs to the end of each solve are not comparable: one formulation stops early at a poor mesh, another
polishes a good one. So in each block of a comparison two levels are taken that every successful formulation
reaches, the worst of their final objectives and the worst of their final first-order residuals, and the
histories say when each was there first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import HISTORY_FIELDS, Result
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, block_key, blocks, grouped, label, seconds_of_work

# up to this primal residual the objective of an iterate means something, and below it first-order residuals
# are not told apart
FEASIBLE = 1e-6
SLACK = 1e-3  # part of the worst gain by which the common level may miss it: last digits are not compared


@dataclass(frozen=True)
class Curve:
    """The history of one solve: cost in contact solves, and as energy the objective that was minimised."""

    name: str
    iteration: Array
    cost: Array
    energy: Array
    feasible: NDArray[np.bool_]


def curve(result: Result, unit: float | None = None, name: str = "") -> Curve | None:
    """The curve of a result; None without a history of what was minimised.

    ``unit`` are the seconds of a contact solve, by default those that this result measured.
    """
    record = result.record
    if record["formulation"] == RELOCATING_NOTHING:
        return None
    steps = _columns(result)
    value = steps[_minimised(record)]
    if not np.any(np.isfinite(value)):
        return None
    unit = unit or record.get("contact_time_s") or np.nan  # a clock too coarse for it: no cost is known
    cost = np.maximum(steps["seconds"] / unit, 1.0)
    return Curve(name or label(record), steps["iteration"], cost, value, _feasible(steps))


def cost_of_gain(energy: ArrayLike, cost: ArrayLike, initial: float, best: float, level: float) -> float:
    """First cost at which ``initial - energy >= level * (initial - best)``; infinite if it never is.

    Energies (steps,) are NaN where an iterate is not feasible.
    """
    reached = initial - np.asarray(energy, dtype=float) >= level * (initial - best)
    return _first(np.asarray(cost, dtype=float), reached, math.inf)


def with_common_costs(results: Sequence[Result]) -> list[Record]:
    """The records, in blocks of two or more successful formulations with the levels and the costs to them.

    ``common_objective`` is audited if it is the energy. Costs, of build and solve until then, are in contact
    solves, whose time is the median of the block.
    """
    records = [dict(result.record) for result in results]
    moved = [
        place
        for place, record in enumerate(records)
        if record["success"] and record["formulation"] != RELOCATING_NOTHING
    ]
    groups = grouped(moved, lambda place: (block_key(records[place]), records[place]["objective"]))
    units = {block_key(block.records[0]): block.unit for block in blocks(records)}
    for (key, _), places in groups.items():
        unit = units[key]
        if len(places) > 1 and unit is not None:
            for place, found in zip(places, _costs([results[p] for p in places], unit), strict=True):
                records[place].update(found)
    return records


def _costs(results: Sequence[Result], unit: float) -> list[Record]:
    """The levels of one group, and what each result needs to reach them."""
    records = [result.record for result in results]
    pairs = [(end, start) for end, start in map(_ends, records) if not math.isnan(end + start)]
    level = max((end for end, _ in pairs), default=math.nan)
    level += SLACK * max(0.0, min((start - level for _, start in pairs), default=0.0))
    residuals = [r["stationarity_residual"] for r in records if r.get("stationarity_residual") is not None]
    common = max((max(residual, FEASIBLE) for residual in residuals), default=math.nan)
    rows = []
    for result, record in zip(results, records, strict=True):
        split = record.get("build_time_s") is not None and record.get("solve_time_s") is not None
        total = seconds_of_work(record) if split else None
        # the history is of the first run, the times are medians over all
        pace = (total or 1.0) / (record.get("first_cost_s") or total or 1.0)
        steps = _columns(result)
        low = _feasible(steps) & (steps[_minimised(record)] + shift_to_audited(record) <= level)
        # a history may miss the last digits that the end has: all reach the levels at their ends
        end = math.nan if total is None else total
        cost, other = (
            _first(pace * steps["seconds"], where, end) / unit
            for where in (low, steps["stationarity"] <= common)
        )
        rows.append(
            {
                "common_objective": level,
                "common_stationarity": common,
                "cost_to_objective": None if math.isnan(cost) else cost,
                "cost_to_stationarity": None if math.isnan(other) else other,
            }
        )
    return rows


def shift_to_audited(record: Record) -> float:
    """From an energy of the problem's own rule, which histories have, to the audited one."""
    own, audited = record.get("energy"), record.get("energy_audited")
    return 0.0 if _minimised(record) != "energy" or own is None or audited is None else audited - own


def _ends(record: Record) -> tuple[float, float]:
    """Final and initial audited energy, or objective; NaN where not known."""
    names = ("energy_audited", "energy_initial_audited")
    if _minimised(record) != "energy":
        names = ("objective_value", "objective_initial")
    end, start = (math.nan if record.get(name) is None else float(record[name]) for name in names)
    return end, start


def _minimised(record: Record) -> str:
    """The column of a history that has what was minimised."""
    return "energy" if record["objective"] == "energy" else "objective"


def _columns(result: Result) -> dict[str, Array]:
    """A history by columns; NaN where a value is not known."""
    steps = result.steps()
    return {name: np.array([step.get(name, math.nan) for step in steps]) for name in HISTORY_FIELDS}


def _feasible(steps: dict[str, Array]) -> NDArray[np.bool_]:
    return ~(steps["primal_residual"] > FEASIBLE)


def _first(values: Array, where: NDArray[np.bool_], otherwise: float) -> float:
    """The first value where a condition holds."""
    return float(values[np.argmax(where)]) if np.any(where) else otherwise
