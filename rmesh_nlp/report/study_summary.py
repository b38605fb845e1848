"""Rows of a study joined to tables and profiles: instances by variants, failures as failures.

Performance profiles are those of Dolan and Moré, Math. Program. 91 (2002): the share of problems that a
formulation solves at a cost within a factor tau of the cheapest. Data profiles are those of Moré and Wild,
SIAM J. Optim. 20 (2009): the share of problems of which it reaches a part of the best gain at a cost of
at most kappa contact solves. Costs are arrays (problems,) by formulation. A failure is an infinite cost,
never a missing problem.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import ROUNDING, Array, difference
from rmesh_nlp.io.records import Record, Records, ends_of, gain_of, objective_of
from rmesh_nlp.io.results import Result
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.report.blocks import (
    contact_units,
    relocates,
    seconds_of_work,
    variant,
    variants_of,
    with_order,
)
from rmesh_nlp.report.histories import cost_to
from rmesh_nlp.report.notes import shared_notes
from rmesh_nlp.report.table import MISSING, Table

FIGURES = {
    **{"gain [%]": ".3g", "of best [%]": ".4g", "iterations": ".0f", "contact solves": ".0f"},
    **{"build + solve [s]": ".3g", "cost [contact solves]": ".4g"},
}
"""Columns of medians with their digits."""

HEAD = ("family", "formulation", "solves", "success", "converged", *FIGURES)
FURTHER = ("of best [%]", "iterations", "cost [contact solves]")  # columns that a first reader does not need
RANGES = (
    "Medians over successful solves, in brackets their range. Of best: the gain over the largest one of any "
    "formulation on that problem. Cost: time of build and solve over that of one contact solve on the given "
    "mesh."
)
MEDIANS = (
    "Medians over successful solves. Gain: fall of the audited energy, or of another objective, in per cent "
    "of its size on the given mesh."
)
PARTS = (0.9, 0.99, 0.999)  # of the best gain, in data profiles
INF = float("inf")

# costs of performance profiles by the names of their figures: words, and the cost of a success
COSTS: dict[str, tuple[str, Callable[[Record], float | None]]] = {
    "iterations": ("iterations", lambda record: record["iterations"]),
    "contact_solves": ("contact solves (all at once: 1)", lambda record: record["contact_solves"]),
    "build_and_solve": ("time of build and solve", seconds_of_work),
}


@dataclass(frozen=True)
class Profile:
    """A step function, the share of problems done at a value of at most x: it rises to ``share`` ``at`` x."""

    at: Array
    share: Array

    def __call__(self, x: ArrayLike) -> Array:
        """The share at ``x``; values that differ by rounding are ties."""
        place = np.searchsorted(self.at, np.asarray(x, dtype=float) * (1 + ROUNDING), side="right")
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


def is_study(records: Records) -> bool:
    """Whether rows come from a study rather than from a comparison."""
    return any(record.get("variant") and record.get("family") for record in records)


def instance(record: Record) -> str:
    """What has to agree for two variants to have solved the same."""
    # a variant without a seed, and one that failed before it had move limits, still solve the instance
    return f"{with_order(str(record['example']), record)}, {record['n']}, {objective_of(record)}"


def summary_table(records: Records) -> Table:
    """By family and variant, the variant that relocates nothing first; repetitions are joined by medians."""
    ends = np.array([ends_of(record) for record in records], dtype=float).reshape(-1, 2)
    solves = pd.DataFrame(
        {
            "family": map(family, records),
            "relocates": [relocates(record) for record in records],
            "formulation": map(variant, records),
            "status": [record["status"] for record in records],
            "instance": map(instance, records),
            "fall": [difference(*pair) for pair in ends],
            "gain [%]": [gain_of(*pair) for pair in ends],
            "iterations": [record["iterations"] for record in records],
            "contact solves": [record["contact_solves"] for record in records],
            "build + solve [s]": map(seconds_of_work, records),
            "cost [contact solves]": map(contact_units, records),
        }
    )
    solves["success"] = [bool(record["success"]) for record in records]
    good = solves[solves["success"]]
    best = good.groupby("instance")["fall"].max()
    solves["of best [%]"] = 100 * solves["fall"] / solves["instance"].map(best.where(best > 0))
    rows = []
    asked = solves[solves["status"] != "refused"]
    for (name, _, method), own in asked.groupby(["family", "relocates", "formulation"]):
        good = own[own["success"]]
        converged = (good["status"] == Status.CONVERGED.value).sum()
        figures = [_range(good[column], form) for column, form in FIGURES.items()]
        rows.append([name, method, str(len(own)), str(len(good)), str(converged), *figures])
    return Table(HEAD, rows, RANGES, "Medians with their ranges", is_detail=True, texts=2)


def median_table(records: Records) -> Table:
    """The columns of :func:`summary_table` that a first reader needs, without ranges."""
    places = [place for place, name in enumerate(HEAD) if name not in FURTHER]
    rows = [[row[place].split(" [")[0] for place in places] for row in summary_table(records).rows]
    return Table([HEAD[place] for place in places], rows, MEDIANS)


def _range(values: pd.Series, form: str) -> str:
    """Median with the range in brackets."""
    numbers = values.dropna().astype(float)
    if numbers.empty:
        return MISSING
    middle, low, high = (format(f, form) for f in (numbers.median(), numbers.min(), numbers.max()))
    return middle if low == high else f"{middle} [{low}, {high}]"


def study_notes(records: Records) -> list[str]:
    """What is needed to read the tables of a study."""
    refused = sum(record["status"] == "refused" for record in records)
    said = f"{refused} solves were refused, since the formulation does not take the objective."
    return [said] * (refused > 0) + shared_notes(records)


def charts(results: Sequence[Result]) -> list[Chart]:
    """All profiles that the results allow; none with fewer than two formulations.

    The variant that relocates nothing is not ranked: it is the baseline of all gains.
    """
    rows = [r for r in results if relocates(r.record)]
    rows = [r for r in rows if r.record["status"] != "refused"]
    names, instances = variants_of([r.record for r in rows]), [instance(r.record) for r in rows]
    if len(names) < 2:
        return []

    def typical(value: Callable[[Result], float | None]) -> pd.DataFrame:
        """Medians (problems, formulations) over repetitions and starts; infinite if most failed."""
        values = (value(row) if row.record["success"] else None for row in rows)
        costs = pd.Series([INF if cost is None else float(cost) for cost in values])
        medians = costs.groupby([instances, [variant(row.record) for row in rows]]).median()
        return medians.unstack(fill_value=INF)[names]

    made = []
    for name, (words, cost) in COSTS.items():
        profiles = performance_profiles(typical(lambda one, cost=cost: cost(one.record)))  # type: ignore[misc]
        made.append(Chart(name, f"Performance profile: {words}", "factor of the cheapest", profiles))
    energies = typical(lambda one: ends_of(one.record)[1])
    starts = pd.Series([ends_of(row.record)[0] for row in rows], dtype=float).groupby(instances).first()
    profiles = quality_profiles(energies, starts.fillna(INF))
    made.append(Chart("quality", "Quality: final audited energy", "part of the best gain missed", profiles))
    lowest = energies.min(axis=1)
    for part in PARTS:
        profiles = data_profiles(typical(partial(_cost_of_part, lowest=lowest, part=part)))
        title = f"Data profile: {100 * part:g} % of the best gain"
        made.append(Chart(f"data-{100 * part:g}", title, "cost [contact solves]", profiles))
    return made


def _cost_of_part(result: Result, lowest: Mapping[str, float], part: float) -> float:
    """Cost at which a part of the best gain was reached."""
    start, best = ends_of(result.record)[0], lowest[instance(result.record)]
    if start is None or not np.isfinite(best):
        return INF
    return cost_to(result, start - part * (start - best))


def performance_profiles(table: pd.DataFrame) -> dict[str, Profile]:
    """Dolan and Moré's profiles over the ratio to the cheapest; what all failed is a failure of all."""
    return data_profiles(table.div(table.min(axis=1), axis=0).mask(_is_best(table), 1.0))


def quality_profiles(table: pd.DataFrame, initial: pd.Series) -> dict[str, Profile]:
    """Profiles over the part of the best gain that a final energy misses.

    Where no formulation gains anything over the ``initial`` energies, all that did not fail miss nothing.
    """
    best = table.min(axis=1)
    gain = initial - best
    missed = table.sub(best, axis=0).div(gain.where(gain > ROUNDING * best.abs()), axis=0)
    return data_profiles(missed.mask(_is_best(table), 0.0))


def _is_best(table: pd.DataFrame) -> pd.DataFrame:
    return table.eq(table.min(axis=1), axis=0) & np.isfinite(table)


def data_profiles(table: pd.DataFrame) -> dict[str, Profile]:
    """The distributions of columns of values; what is not finite is never reached."""
    profiles = {}
    for name, values in table.items():
        at, counts = np.unique(values[np.isfinite(values)], return_counts=True)
        profiles[str(name)] = Profile(at, np.cumsum(counts) / max(values.size, 1))
    return profiles
