"""What random starts say of a formulation: best, median and worst end, and how many failed."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import audited, blocks, contact_units, label, objective_of
from rmesh_nlp.report.columns import MISSING

TITLE = "Several starts"
CAPTION = (
    "Ends of solves from several starts: audited energies, or values of another objective. The cost is the "
    "median of one start."
)

HEAD = ("formulation", "starts", "best", "median", "worst", "failures", "cost [contact solves]")
"""Ends are audited energies, or values of another objective; the cost is the median of one start."""


def multistart_rows(records: Sequence[Record]) -> list[tuple[str, list[list[str]]]]:
    """Per block, a row for each formulation and objective that was solved from two starts or more."""
    found = []
    for block in blocks(records):
        groups: dict[str, list[Record]] = {}
        for record in block.records:
            if record["status"] == "refused":
                continue
            groups.setdefault(label({**record, "seed": None}), []).append(record)
        rows = [
            row for name, group in groups.items() if (row := _of_one_solve(name, group) or _row(name, group))
        ]
        if rows:
            found.append((block.title, rows))
    return found


def _row(name: str, group: Sequence[Record]) -> list[str] | None:
    if len({record["seed"] for record in group}) < 2:
        return None
    good = [record for record in group if record["success"]]
    ends = [end for record in good if (end := _end(record)) is not None]
    costs = [cost for record in good if (cost := contact_units(record)) is not None]
    return _cells(name, len(group), ends, median(costs) if costs else None)


def _of_one_solve(name: str, group: Sequence[Record]) -> list[str] | None:
    """A record whose solve had starts of its own, ``--starts``."""
    if len(group) != 1 or not group[0].get("start_energies"):
        return None
    ends = group[0].get("start_values") or group[0]["start_energies"]
    return _cells(name, len(ends), [end for end in ends if end is not None], None)


def _cells(name: str, starts: int, ends: Sequence[float], cost: float | None) -> list[str]:
    figures = [f"{f(ends):.7g}" if ends else MISSING for f in (min, median, max)]
    return [name, str(starts), *figures, str(starts - len(ends)), MISSING if cost is None else f"{cost:.3g}"]


def _end(record: Record) -> float | None:
    if objective_of(record) == "energy":
        return audited(record)
    value = record.get("objective_value")
    return None if value is None else float(value)
