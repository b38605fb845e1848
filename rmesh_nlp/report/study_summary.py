"""Rows of a study joined to tables and profiles: instances by variants, failures as failures.

Performance profiles are those of Dolan and Moré, Math. Program. 91 (2002): the share of problems that a
formulation solves at a cost within a factor tau of the cheapest. Data profiles are those of Moré and Wild,
SIAM J. Optim. 20 (2009): the share of problems of which it reaches a part of the best gain at a cost of
at most kappa contact solves. Costs are arrays (problems,) by formulation. A failure is an infinite cost,
never a missing problem.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.io.results import Result
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    contact_units,
    ends_of,
    gain_of,
    grouped,
    seconds_of_work,
    variant,
    variants_of,
    with_order,
)
from rmesh_nlp.report.histories import cost_of_gain, curve, shift_to_audited
from rmesh_nlp.report.table import MISSING, Table

HEAD = (
    *("family", "formulation", "solves", "success", "converged", "gain [%]", "of best [%]"),
    *("iterations", "contact solves", "build + solve [s]", "cost [contact solves]"),
)
SHORT = (0, 1, 2, 3, 4, 5, 8, 9)  # columns that a first reader needs
RANGES = (
    "Medians over successful solves, in brackets their range. Of best: the gain over the largest one of any "
    "formulation on that problem. Cost: time of build and solve over that of one contact solve on the given "
    "mesh."
)
MEDIANS = (
    "Medians over successful solves. Gain: fall of the audited energy, or of another objective, in per cent "
    "of its size on the given mesh."
)
LEVELS = (0.9, 0.99, 0.999)  # parts of the best gain for data profiles
SAME = 1e-9  # ratios that agree to this are one: costs of two clocks' ticks are ties
INF = float("inf")

# costs of performance profiles by the names of their figures: words, and the cost of a success
COSTS: dict[str, tuple[str, Callable[[Record], float | None]]] = {
    "iterations": ("iterations", lambda record: record["iterations"]),
    "contact_solves": ("contact solves (all at once: 1)", lambda record: record["contact_solves"]),
    "time_contact_solves": ("build and solve, in contact solves", contact_units),
    "build_and_solve": ("build and solve, in seconds", seconds_of_work),
}

Instance = tuple[str, ...]


@dataclass(frozen=True)
class Profile:
    """A step function, the share of problems done at a value of at most x: it rises to ``share`` ``at`` x."""

    at: Array
    share: Array

    def __call__(self, x: ArrayLike) -> Array:
        """The share at ``x``."""
        place = np.searchsorted(self.at, np.asarray(x, dtype=float) * (1 + SAME), side="right")
        return np.concatenate([[0.0], self.share])[place]


@dataclass(frozen=True)
class Chart:
    """Profiles of all formulations over one quantity on a logarithmic axis; the name is for files."""

    name: str
    title: str
    axis: str
    profiles: dict[str, Profile]


def family(record: Record) -> str:
    """What summaries join: the family in a study, else the example; another order than 1 apart."""
    return with_order(str(record.get("family") or record["example"]), record)


def is_study(records: Sequence[Record]) -> bool:
    """Whether rows come from a study rather than from a comparison."""
    return any(record.get("variant") and record.get("family") for record in records)


def instance(record: Record) -> Instance:
    """What has to agree for two variants to have solved the same."""
    # a variant without a seed, and one that failed before it had move limits, still solve the instance
    return with_order(str(record["example"]), record), str(record["n"]), objective_of(record)


def summary_table(records: Sequence[Record]) -> Table:
    """By family and variant; repetitions are joined by medians."""
    best: dict[Instance, float] = {}
    for record in records:
        gain = _gain(record)
        if record["success"] and gain is not None:
            best[instance(record)] = max(best.get(instance(record), -INF), gain)
    columns: tuple[tuple[str, Callable[[Record], float | None]], ...] = (
        (".3g", lambda record: gain_of(*ends_of(record))),
        (".4g", lambda record: _part(_gain(record), best.get(instance(record)))),
        (".0f", lambda record: record["iterations"]),
        (".0f", lambda record: record["contact_solves"]),
        (".3g", seconds_of_work),
        (".4g", contact_units),
    )
    groups = grouped(  # the baseline first, then by name
        (record for record in records if record["status"] != "refused"),
        lambda record: (family(record), record["formulation"] != RELOCATING_NOTHING, variant(record)),
    )
    rows = []
    for (name, _, method), group in sorted(groups.items(), key=lambda item: item[0]):
        good = [record for record in group if record["success"]]
        converged = sum(record["status"] == "converged" for record in good)
        figures = [_range([value(record) for record in good], form) for form, value in columns]
        rows.append([name, method, str(len(group)), str(len(good)), str(converged), *figures])
    return Table(HEAD, [("", rows)], texts=2)


def median_table(records: Sequence[Record]) -> Table:
    """The columns of :func:`summary_table` that a first reader needs, without ranges."""
    rows = [[row[i].split(" [")[0] for i in SHORT] for row in summary_table(records).rows]
    return Table([HEAD[i] for i in SHORT], [("", rows)])


def _start(record: Record) -> float | None:
    """The audited energy of the given mesh, or another objective."""
    return ends_of(record)[0]


def _gain(record: Record) -> float | None:
    start, end = ends_of(record)
    return None if start is None or end is None else start - end


def _part(gain: float | None, whole: float | None) -> float | None:
    """Per cent of a whole that is above zero."""
    return None if gain is None or not whole or whole <= 0 else 100 * gain / whole


def _range(values: Sequence[float | None], form: str) -> str:
    """Median with the range in brackets."""
    numbers = [value for value in values if value is not None]
    if not numbers:
        return MISSING
    middle, low, high = (format(f(numbers), form) for f in (median, min, max))
    return middle if low == high else f"{middle} [{low}, {high}]"


def study_notes(records: Sequence[Record]) -> list[str]:
    """What is needed to read the tables of a study."""
    refused = sum(record["status"] == "refused" for record in records)
    shared = sum(bool(record.get("shared")) for record in records)
    notes = [MEDIANS]
    if refused:
        notes.append(f"{refused} solves were refused, since the formulation does not take the objective.")
    if shared:
        notes.append(
            f"{shared} of {len(records)} solves shared their core with something: compare their costs in "
            "contact solves, which were measured beside each of them."
        )
    return notes


def charts(results: Sequence[Result]) -> list[Chart]:
    """All profiles that the results allow; none with fewer than two formulations.

    The variant that relocates nothing is not ranked: it is the baseline of all gains.
    """
    rows = [r for r in results if r.record["formulation"] != RELOCATING_NOTHING]
    rows = [r for r in rows if r.record["status"] != "refused"]
    names = variants_of([r.record for r in rows])
    instances = grouped((r.record for r in rows), instance)
    solves = grouped(rows, lambda r: (variant(r.record), instance(r.record)))
    if len(names) < 2:
        return []

    def typical(value: Callable[[Result], float | None]) -> dict[str, list[float]]:
        """Medians over repetitions and starts; infinite if most failed or there is none."""

        def cost(one: Result) -> float:
            cost_of_one = value(one) if one.record["success"] else None
            return INF if cost_of_one is None else float(cost_of_one)

        return {
            name: [
                median(map(cost, solves[name, where])) if (name, where) in solves else INF
                for where in instances
            ]
            for name in names
        }

    made = []
    for name, (words, cost) in COSTS.items():
        profiles = performance_profiles(typical(lambda one, cost=cost: cost(one.record)))  # type: ignore[misc]
        made.append(Chart(name, f"Performance profile: {words}", "factor of the cheapest", profiles))
    energies = typical(lambda one: ends_of(one.record)[1])
    starts = [next((s for r in own if (s := _start(r)) is not None), INF) for own in instances.values()]
    profiles = quality_profiles(energies, starts)
    made.append(Chart("quality", "Quality: final audited energy", "part of the best gain missed", profiles))
    lowest = dict(zip(instances, np.min(list(energies.values()), axis=0), strict=True))
    for level in LEVELS:
        profiles = data_profiles(typical(partial(_cost_of_level, lowest=lowest, level=level)))
        title = f"Data profile: {100 * level:g} % of the best gain"
        made.append(Chart(f"data-{100 * level:g}", title, "cost [contact solves]", profiles))
    return made


def _cost_of_level(one: Result, lowest: Mapping[Instance, float], level: float) -> float:
    """Cost at which a part of the best gain was reached, by the history or, without one, at the end."""
    record = one.record
    start, best = _start(record), lowest[instance(record)]
    if start is None or not np.isfinite(best):
        return INF
    drawn = curve(one)
    if drawn is not None:
        # the history is of the problem's own rule, the best of the assessment's
        energy = np.where(drawn.feasible, drawn.energy + shift_to_audited(record), np.nan)
        cost = cost_of_gain(energy, drawn.cost, start, best, level)
        if np.isfinite(cost):
            return cost
    end = ends_of(record)[1]
    return cost_of_gain([INF if end is None else end], [contact_units(record) or INF], start, best, level)


def data_profiles(costs: Mapping[str, ArrayLike]) -> dict[str, Profile]:
    """Moré and Wild's profiles over the cost itself, that of a part of the best gain, in contact solves."""
    return _profiles(costs, _table(costs))


def performance_profiles(costs: Mapping[str, ArrayLike]) -> dict[str, Profile]:
    """Dolan and Moré's profiles over the ratio to the cheapest; what all failed is a failure of all."""
    table = _table(costs)
    best = np.min(table, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _profiles(costs, np.where(best > 0, table / best, np.where(table == 0, 1.0, np.inf)))


def quality_profiles(energies: Mapping[str, ArrayLike], initial: ArrayLike) -> dict[str, Profile]:
    """Profiles over the part of the best gain that a final energy misses.

    Where no formulation gains anything over the ``initial`` energies, all that did not fail miss nothing.
    """
    table = _table(energies)
    best = np.min(table, axis=0)
    gain, is_best = np.asarray(initial, dtype=float) - best, np.isfinite(table) & (table <= best)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _profiles(energies, np.where(gain > 0, (table - best) / gain, np.where(is_best, 0.0, np.inf)))


def _table(values: Mapping[str, ArrayLike]) -> Array:
    """(formulations, problems) values; a failure is infinite."""
    return np.array([np.asarray(row, dtype=float) for row in values.values()])


def _profiles(names: Iterable[str], table: Array) -> dict[str, Profile]:
    """The distributions of rows of values; what is not finite is never reached."""
    profiles = {}
    for name, values in zip(names, table, strict=True):
        at, counts = np.unique(values[np.isfinite(values)], return_counts=True)
        profiles[name] = Profile(at, np.cumsum(counts) / max(values.size, 1))
    return profiles
