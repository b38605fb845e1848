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
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import HISTORY_FIELDS, Result
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    blocks_of,
    contact_units,
    grouped,
    label,
    seconds_of_work,
)
from rmesh_nlp.solving.outer import TOLERANCE

SLACK = 1e-3  # part of the worst gain by which the common level may miss it: last digits are not compared


@dataclass(frozen=True)
class Curve:
    """The history of one solve: cost in contact solves, and as energy the objective that was minimised."""

    name: str
    iteration: Array
    cost: Array
    energy: Array
    feasible: NDArray[np.bool_]
    stationarity: Array


def curve(result: Result, name: str = "") -> Curve | None:
    """The curve of a result; None without a history of what was minimised."""
    record = result.record
    if record["formulation"] == RELOCATING_NOTHING:
        return None
    steps = pd.DataFrame(result.steps(), columns=HISTORY_FIELDS, dtype=float)
    value = steps["energy" if _is_energy(record) else "objective"]
    if not value.notna().any():
        return None
    unit = record.get("contact_time_s") or np.nan  # a clock too coarse for it: no cost is known
    return Curve(
        name or label(record),
        steps["iteration"].to_numpy(),
        np.maximum(steps["seconds"].to_numpy() / unit, 1.0),
        value.to_numpy(),
        is_feasible(steps).to_numpy(),
        steps["stationarity"].to_numpy(),
    )


def is_feasible(steps: pd.DataFrame) -> pd.Series:
    """Where constraints and contact conditions are met to the default tolerance, or are not known."""
    return ~(steps["primal_residual"] > TOLERANCE)


def cost_of_gain(energy: ArrayLike, cost: ArrayLike, initial: float, best: float, level: float) -> float:
    """First cost at which ``initial - energy >= level * (initial - best)``; infinite if it never is.

    Energies (steps,) are NaN where an iterate is not feasible.
    """
    reached = initial - np.asarray(energy, dtype=float) >= level * (initial - best)
    return _first(np.asarray(cost, dtype=float), reached, math.inf)


def with_common_costs(results: Sequence[Result]) -> list[Record]:
    """The records, in blocks of two or more successful formulations with the levels and the costs to them.

    ``common_objective`` is audited if it is the energy. Costs, of build and solve until then, are in contact
    solves.
    """
    added: dict[int, Record] = {}
    for block, own in blocks_of(results):
        good = (result for result in own if result.record["success"])
        moved = (result for result in good if result.record["formulation"] != RELOCATING_NOTHING)
        for group in grouped(moved, lambda result: result.record["objective"]).values():
            if len(group) > 1 and block.unit is not None:
                added |= zip(map(id, group), _costs(group), strict=True)
    return [{**result.record, **added.get(id(result), {})} for result in results]


def _costs(results: Sequence[Result]) -> list[Record]:
    """The levels of one group, and what each result needs to reach them."""
    records = [result.record for result in results]
    ends = pd.DataFrame(map(_ends, records), columns=["start", "end"], dtype=float).dropna()
    level = ends["end"].max()
    level += SLACK * max(0.0, (ends["start"] - level).min())
    residuals = pd.Series([record.get("stationarity_residual") for record in records], dtype=float)
    common = residuals.clip(lower=TOLERANCE).max()  # less is not told apart
    rows = []
    for result, record in zip(results, records, strict=True):
        total = seconds_of_work(record) or math.nan
        # a history may miss the last digits that the end has: all reach the levels at their ends
        costs = [contact_units(record) or math.nan] * 2
        if (way := curve(result)) is not None:
            # the history is of the first run, the times are medians over all
            pace = way.cost * total / (record.get("first_cost_s") or total)
            low = way.feasible & (way.energy + shift_to_audited(record) <= level)
            reached = (low, way.stationarity <= common)
            costs = [_first(pace, where, end) for where, end in zip(reached, costs, strict=True)]
        cost, other = (None if math.isnan(value) else value for value in costs)
        levels = {"common_objective": level, "common_stationarity": common}
        rows.append({**levels, "cost_to_objective": cost, "cost_to_stationarity": other})
    return rows


def shift_to_audited(record: Record) -> float:
    """From an energy of the problem's own rule, which histories have, to the audited one."""
    own, audited = record.get("energy"), record.get("energy_audited")
    return 0.0 if not _is_energy(record) or own is None or audited is None else audited - own


def _ends(record: Record) -> tuple[float | None, ...]:
    """Initial and final audited energy, or objective."""
    names = ("objective_initial", "objective_value")
    if _is_energy(record):
        names = ("energy_initial_audited", "energy_audited")
    return tuple(record.get(name) for name in names)


def _is_energy(record: Record) -> bool:
    """Whether the energy alone was minimised."""
    return bool(record["objective"] == "energy")


def _first(values: Array, where: NDArray[np.bool_], otherwise: float) -> float:
    """The first value where a condition holds."""
    return float(values[np.argmax(where)]) if np.any(where) else otherwise
