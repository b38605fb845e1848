"""Rows of a study joined to tables and profiles: instances by variants, failures as failures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    contact_units,
    objective_of,
    seconds_of_work,
    variant,
    variants_of,
)
from rmesh_nlp.report.columns import MISSING
from rmesh_nlp.report.histories import cost_of_gain, curve, shift_to_audited
from rmesh_nlp.report.profiles import (
    Profile,
    data_profiles,
    performance_profiles,
    quality_profiles,
)

MAIN = (
    "family",
    "formulation",
    "solves",
    "success",
    "converged",
    "gain [%]",
    "contact solves",
    "build + solve [s]",
)
"""Columns of the short table of a study."""

LEVELS = (0.9, 0.99, 0.999)
"""Parts of the best gain for data profiles."""

INF = float("inf")

Instance = tuple[str, ...]


@dataclass(frozen=True)
class Chart:
    """Profiles of all formulations over one quantity.

    Attributes
    ----------
    name, title, axis : str
        For a file name, for people, of the horizontal axis.
    profiles : dict
    """

    name: str
    title: str
    axis: str
    profiles: dict[str, Profile]


def family(record: Record) -> str:
    """What summaries join: the family in a study, else the example."""
    return str(record.get("family") or record["example"])


def is_study(records: Sequence[Record]) -> bool:
    """Whether rows come from a study rather than from a comparison."""
    return any(record.get("variant") and record.get("family") for record in records)


def instance(record: Record) -> Instance:
    """What has to agree for two variants to have solved the same."""
    # a variant without a seed, and one that failed before it had a box, still solve the instance
    return str(record["example"]), str(record["n"]), objective_of(record)


def summary_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table by family and variant; repetitions are joined by medians."""
    head = ["family", "formulation", "solves", "success", "converged", "gain [%]", "of best [%]"]
    head += ["iterations", "contact solves", "build + solve [s]", "cost [contact solves]"]
    best = _best_gain(records)
    groups: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        if record["status"] != "refused":
            groups.setdefault((family(record), variant(record)), []).append(record)
    rows = []
    for (name, method), group in sorted(groups.items(), key=lambda item: (item[0][0], _rank(item[1][0]))):
        good = [record for record in group if record["success"]]
        converged = sum(record["status"] == "converged" for record in good)
        gains = [_relative_gain(record) for record in good]
        parts = [_part_of_best(record, best) for record in good]
        cells = [name, method, str(len(group)), str(len(good)), str(converged)]
        cells += [_range(gains, "{:.3g}"), _range(parts, "{:.4g}")]
        for entry, form in (
            ("iterations", "{:.0f}"),
            ("contact_solves", "{:.0f}"),
        ):
            cells.append(_range([record[entry] for record in good], form))
        cells.append(_range([seconds_of_work(record) for record in good], "{:.3g}"))
        cells.append(_range([contact_units(record) for record in good], "{:.4g}"))
        rows.append(cells)
    return head, rows


def _rank(record: Record) -> tuple[bool, str]:
    """The baseline first, then by name."""
    return record["formulation"] != RELOCATING_NOTHING, variant(record)


def median_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the columns of :func:`summary_rows` that a first reader needs, without ranges."""
    head, rows = summary_rows(records)
    places = [head.index(name) for name in MAIN]
    return [head[i] for i in places], [[row[i].split(" [")[0] for i in places] for row in rows]


DETAILS = (
    "Medians over successful solves, in brackets their range. Of best: the gain over the largest one of any "
    "formulation on that problem. Cost: time of build and solve over that of one contact solve on the given "
    "mesh."
)
"""What the columns of :func:`summary_rows` mean."""


def study_notes(records: Sequence[Record]) -> list[str]:
    """What is needed to read the tables of a study."""
    refused = sum(record["status"] == "refused" for record in records)
    shared = sum(bool(record.get("shared")) for record in records)
    found = [
        "Medians over successful solves. Gain: fall of the audited energy in per cent of its size on the "
        "given mesh.",
    ]
    if refused:
        found.append(f"{refused} solves were refused, since the formulation does not take the objective.")
    if shared:
        found.append(
            f"{shared} of {len(records)} solves shared their core with something: compare their costs in "
            "contact solves, which were measured beside each of them."
        )
    return found


def charts(results: Sequence[Result]) -> list[Chart]:
    """All profiles that the results allow; none with fewer than two formulations.

    The variant that relocates nothing is not ranked: it is the baseline of all gains.
    """
    rows = [r for r in results if r.record["status"] != "refused"]
    rows = [r for r in rows if r.record["formulation"] != RELOCATING_NOTHING]
    names = variants_of([r.record for r in rows])
    instances = list(dict.fromkeys(instance(r.record) for r in rows))
    if len(names) < 2 or not instances:
        return []
    found: dict[tuple[str, Instance], list[Result]] = {}
    for one in rows:
        found.setdefault((variant(one.record), instance(one.record)), []).append(one)

    def costs(cost: Callable[[Result], float]) -> dict[str, list[float]]:
        return {
            name: [_typical([cost(one) for one in found.get((name, where), [])]) for where in instances]
            for name in names
        }

    made = []
    for entry, title in (
        ("iterations", "iterations"),
        ("contact_solves", "contact solves (all at once: 1)"),
        ("time_contact_solves", "build and solve, in contact solves"),
        ("build_and_solve", "build and solve, in seconds"),
    ):
        profiles = performance_profiles(costs(lambda one, e=entry: _cost(one.record, e)))  # type: ignore[misc]
        made.append(Chart(entry, f"Performance profile: {title}", "factor of the cheapest", profiles))
    energies = costs(lambda one: one.record["energy_audited"] if one.record["success"] else INF)
    initial = [_initial(found, names, where) for where in instances]
    made.append(
        Chart(
            "quality",
            "Quality: final audited energy",
            "part of the best gain missed",
            quality_profiles(energies, initial),
        )
    )
    lowest = {where: min(energies[name][i] for name in names) for i, where in enumerate(instances)}
    for level in LEVELS:
        reached = costs(lambda one, part=level: _cost_of_level(one, lowest, part))  # type: ignore[misc]
        title = f"Data profile: {100 * level:g} % of the best gain"
        made.append(Chart(f"data-{100 * level:g}", title, "cost [contact solves]", data_profiles(reached)))
    return made


def _typical(values: Sequence[float]) -> float:
    """The median over repetitions and starts; infinite if most failed or there is none."""
    return float(median(values)) if values else INF


def _cost(record: Record, entry: str) -> float:
    if not record["success"]:
        return INF
    of_work = {"time_contact_solves": contact_units, "build_and_solve": seconds_of_work}
    value = of_work[entry](record) if entry in of_work else record[entry]
    return INF if value is None else float(value)


def _initial(found: Any, names: Sequence[str], where: Instance) -> float:
    for name in names:
        for one in found.get((name, where), []):
            value = _initial_audited(one.record)
            if value is not None:
                return value
    return INF


def _initial_audited(record: Record) -> float | None:
    value = record.get("energy_initial_audited")
    return record["energy_initial"] if value is None else float(value)


def _cost_of_level(one: Result, lowest: dict[Instance, float], level: float) -> float:
    """Cost at which a part of the best gain was reached, by the history or, without one, at the end."""
    record = one.record
    start, best = _initial_audited(record), lowest[instance(record)]
    if not record["success"] or start is None or not np.isfinite(best):
        return INF
    # the history is of the problem's own rule, the best of the audit's: shift by what sets them apart
    shift = shift_to_audited(record)
    drawn = curve(one)
    if drawn is not None:
        energy = np.where(drawn.feasible, drawn.energy + shift, np.nan)
        cost = cost_of_gain(energy, drawn.cost, start, best, level)
        if np.isfinite(cost):
            return cost
    units = contact_units(record)
    return cost_of_gain([record["energy_audited"]], [units or INF], start, best, level)


def _gain(record: Record) -> float | None:
    start, end = _initial_audited(record), record["energy_audited"]
    return None if start is None or end is None else start - end


def _relative_gain(record: Record) -> float | None:
    gain, start = _gain(record), _initial_audited(record)
    return None if gain is None or not start else 100 * gain / abs(start)


def _best_gain(records: Sequence[Record]) -> dict[Instance, float]:
    best: dict[Instance, float] = {}
    for record in records:
        gain = _gain(record) if record["success"] else None
        if gain is not None:
            best[instance(record)] = max(best.get(instance(record), -INF), gain)
    return best


def _part_of_best(record: Record, best: dict[Instance, float]) -> float | None:
    gain, most = _gain(record), best.get(instance(record))
    return None if gain is None or not most or most <= 0 else 100 * gain / most


def _range(values: Sequence[float | None], form: str) -> str:
    """Median with the range in brackets."""
    known = [value for value in values if value is not None]
    if not known:
        return MISSING
    middle, low, high = (form.format(f(known)) for f in (median, min, max))
    return middle if low == high else f"{middle} [{low}, {high}]"
