"""Histories of solves: curves over cost, and what each formulation needs to reach what all of them reach.

Costs to the end of each solve are not comparable: one formulation stops early at a poor mesh, another
polishes a good one. So in each block of a comparison two levels are taken that every successful formulation
reaches, the worst of their final objectives and the worst of their final first-order residuals, and the
histories say when each was there first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from rmesh_nlp.io.records import Record, ends_of, objective_of
from rmesh_nlp.io.results import Result
from rmesh_nlp.report.blocks import (
    blocks_of,
    contact_units,
    end_of,
    grouped,
    relocates,
    seconds_of_work,
)
from rmesh_nlp.solving.outer import TOLERANCE

SLACK = 1e-3  # part of the worst gain by which the common level may miss it: last digits are not compared


def curve(result: Result) -> pd.DataFrame | None:
    """The history of a result with its ``cost`` in contact solves and the ``value`` of what was minimised.

    ``feasible`` steps meet their constraints. None without a history of the value.
    """
    record, steps = result.record, result.steps()
    value = steps["energy" if objective_of(record) == "energy" else "objective"]
    if not relocates(record) or not value.notna().any():
        return None
    # a clock too coarse for the unit: no cost is known
    pace = 1.0 / (record.get("contact_time_s") or math.nan)
    if (first := record.get("first_cost_s")) is not None:
        # the history is of the first run, the times are medians over all
        pace *= (seconds_of_work(record) or math.nan) / first
    cost = (pace * steps["seconds"]).clip(lower=1.0)
    return steps.assign(cost=cost, value=value, feasible=is_feasible(steps))


def is_feasible(steps: pd.DataFrame) -> pd.Series:
    """Where constraints and contact conditions are met to the default tolerance, or are not known."""
    return ~(steps["primal_residual"] > TOLERANCE)


def cost_to(result: Result, level: float) -> float:
    """First cost at which the audited energy, or another objective, was at most a level; infinite if never.

    It is looked up in the history and, where that has no feasible iterate so low, at the end.
    """
    record, way = result.record, curve(result)
    cost = (contact_units(record) or math.inf) if end_of(record) <= level else math.inf
    if way is None:
        return cost
    # the history is of the problem's own rule, the level of the assessment's
    return _first(way["cost"], way["feasible"] & (way["value"] + _to_audited(record) <= level), cost)


def with_common_costs(results: Sequence[Result]) -> list[Record]:
    """The records, in blocks of two or more successful formulations with the levels and the costs to them.

    ``common_objective`` is audited if it is the energy. Costs, of build and solve until then, are in contact
    solves.
    """
    added: dict[int, Record] = {}
    for block, own in blocks_of(results):
        good = (result for result in own if result.record["success"])
        moved = (result for result in good if relocates(result.record))
        for group in grouped(moved, lambda result: result.record["objective"]).values():
            if len(group) > 1 and block.unit is not None:
                added |= zip(map(id, group), _costs(group), strict=True)
    return [{**result.record, **added.get(id(result), {})} for result in results]


def _costs(results: Sequence[Result]) -> list[Record]:
    """The levels of one group, and what each result needs to reach them."""
    records = [result.record for result in results]
    ends = pd.DataFrame(map(ends_of, records), columns=["start", "end"], dtype=float).dropna()
    level = ends["end"].max()
    level += SLACK * max(0.0, (ends["start"] - level).min())
    residuals = pd.Series([record.get("stationarity_residual") for record in records], dtype=float)
    common = residuals.clip(lower=TOLERANCE).max()  # less is not told apart
    rows = []
    for result, record in zip(results, records, strict=True):
        # a history may miss the last digits that the end has: all reach the levels at their ends
        settled, way = contact_units(record) or math.inf, curve(result)
        if way is not None:
            settled = _first(way["cost"], way["stationarity"] <= common, settled)
        costs = {"cost_to_objective": cost_to(result, level), "cost_to_stationarity": settled}
        finite = {name: cost for name, cost in costs.items() if math.isfinite(cost)}
        rows.append({"common_objective": level, "common_stationarity": common, **finite})
    return rows


def _to_audited(record: Record) -> float:
    """From an energy of the problem's own rule, which histories have, to the audited one."""
    own, audited = record.get("energy"), record.get("energy_audited")
    return 0.0 if objective_of(record) != "energy" or own is None or audited is None else audited - own


def _first(values: pd.Series, where: pd.Series, otherwise: float) -> float:
    """The first value where a condition holds."""
    return float(values[where].iloc[0]) if where.any() else otherwise
