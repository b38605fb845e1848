"""What each formulation needs to reach what all of them reach: costs to a common energy and stationarity.

Costs to the own end compare apples with pears: one formulation stops early at a poor mesh, another polishes a
good one. So in each block of a comparison two levels are taken that every successful formulation reaches, the
worst of their final objectives and the worst of their final first-order residuals, and the histories say
when each was there first.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, block_key, blocks

SLACK = 1e-3
"""The common level may miss this part of the worst gain: the last digits of a descent are not compared."""

FEASIBLE = 1e-6
"""Primal residual up to which the objective of an iterate means something."""

TIGHTEST = 1e-6
"""First-order residuals below it are not told apart."""


def with_common_costs(results: Sequence[Result]) -> list[Record]:
    """The records, in blocks of two or more successful formulations with further entries.

    ``common_objective``, ``common_stationarity``
        The levels; an energy is the audited one.
    ``cost_to_objective``, ``cost_to_stationarity``
        Build and solve until then, in contact solves; the unit is the median of the block.
    """
    records = [dict(result.record) for result in results]
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for place, record in enumerate(records):
        if record["success"] and record["formulation"] != RELOCATING_NOTHING:
            key = (*block_key(record), record["objective"])
            groups[key].append(place)
    units = {block_key(block.records[0]): block.unit for block in blocks(records)}
    for places in groups.values():
        unit = units[block_key(records[places[0]])]
        if len(places) < 2 or unit is None:
            continue
        for place, found in _costs([results[p] for p in places], unit, places):
            records[place].update(found)
    return records


def _costs(results: Sequence[Result], unit: float, places: Sequence[int]) -> list[tuple[int, Record]]:
    ends = [_end(result.record) for result in results]
    starts = [_start(result.record) for result in results]
    known = [(e, s) for e, s in zip(ends, starts, strict=True) if e is not None and s is not None]
    level = max((e for e, _ in known), default=math.nan)
    level += SLACK * max(0.0, min((s - level for _, s in known), default=0.0))
    residuals = [result.record.get("stationarity_residual") for result in results]
    common = max((max(r, TIGHTEST) for r in residuals if r is not None), default=math.nan)
    rows = []
    for place, result in zip(places, results, strict=True):
        shift = _shift(result.record)
        name = "energy" if result.record["objective"] == "energy" else "objective"
        total = _seconds(result.record)
        # the history is of the first run, the times are medians over all
        pace = (total or 1.0) / (result.record.get("first_cost_s") or total or 1.0)
        reached = stationary = None
        for step in result.steps():
            seconds = pace * step.get("seconds", math.nan)
            feasible = not step.get("primal_residual", math.nan) > FEASIBLE
            if reached is None and feasible and step.get(name, math.nan) + shift <= level:
                reached = seconds
            if stationary is None and step.get("stationarity", math.nan) <= common:
                stationary = seconds
        found: Record = {"common_objective": level, "common_stationarity": common}
        for entry, when in (("cost_to_objective", reached), ("cost_to_stationarity", stationary)):
            # a history may miss the last digits that the end has: all reach the levels at their ends
            when = total if when is None else when
            found[entry] = None if when is None else when / unit
        rows.append((place, found))
    return rows


def _end(record: Record) -> float | None:
    value = record.get("energy_audited" if record["objective"] == "energy" else "objective_value")
    return None if value is None else float(value)


def _start(record: Record) -> float | None:
    value = record.get("energy_initial_audited" if record["objective"] == "energy" else "objective_initial")
    return None if value is None else float(value)


def _shift(record: Record) -> float:
    """From an energy of the problem's own rule, which histories have, to the audited one."""
    own, audited = record.get("energy"), record.get("energy_audited")
    if record["objective"] != "energy" or own is None or audited is None:
        return 0.0
    return float(audited) - float(own)


def _seconds(record: Record) -> float | None:
    build, solve = record.get("build_time_s"), record.get("solve_time_s")
    return None if build is None or solve is None else float(build) + float(solve)
