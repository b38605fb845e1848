"""Records grouped by what was solved, their names, and what tables and figures derive from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, TypeVar

from rmesh_nlp.examples import PAPER
from rmesh_nlp.io.records import Record, Records, ends_of, has_energy, objective_of
from rmesh_nlp.io.results import Result

DEFAULT_RELAXATION = "scholtes"
LINEAR = "order 1"  # what is only said beside another one

# starts of ``mpcc`` that solve another model first: the homotopy then only certifies its end
BORROWED = ("joint", "nested")

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Items by key, in the order of their first appearance."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


@dataclass(frozen=True)
class Case:
    """Records of one example on one grid with the same order, move limits and rule, as they were solved."""

    records: tuple[Record, ...]

    @property
    def example(self) -> str:
        """Name of the example."""
        return str(self.records[0]["example"])

    @property
    def name(self) -> str:
        """An example of the paper, or a problem of one's own."""
        return f"{'Example' if self.example in PAPER else 'Problem'} {self.example}"

    @property
    def settings(self) -> tuple[str, str, str, str]:
        """Size, order of displacements, move limits and quadrature rule in words."""
        record = self.records[0]
        size = f"n = {record['n']}" if self.example in PAPER else str(record["n"])
        rule = record.get("quadrature", "midpoint")
        words = "midpoint rule" if rule == "midpoint" else f"rule of degree {rule}"
        delta = record["delta"]
        limits = "nodes not relocated" if delta == [0, 0] else f"delta = {delta_text(delta)}"
        return size, f"order {order_of(record)}", limits, words

    @property
    def title(self) -> str:
        """The example with its settings, the order if it is not 1."""
        return f"{self.name}: {', '.join(text for text in self.settings if text != LINEAR)}"

    @property
    def objectives(self) -> dict[str, list[Record]]:
        """The records by what was minimised."""
        return grouped(self.records, lambda record: str(record["objective"]))

    @property
    def has_energy(self) -> bool:
        """Whether the energies of its records compare; records that failed have none to say otherwise."""
        return all(map(has_energy, self.records))

    @property
    def best(self) -> Record | None:
        """The successful record with the least value of what was minimised."""
        return min((record for record in self.records if record["success"]), key=end_of, default=None)

    @property
    def unit(self) -> float | None:
        """Seconds of a contact solve on the given mesh: the median of what the rows measured.

        Costs in units of each row would tell more of a busy machine than of formulations.
        """
        units = [record["contact_time_s"] for record in self.records if record.get("contact_time_s")]
        return median(units) if units else None


def blocks(records: Iterable[Record]) -> list[Case]:
    """The records grouped, in the order of their first appearance."""
    return [Case(tuple(group)) for group in grouped(records, block_key).values()]


def blocks_of(results: Iterable[Result]) -> list[tuple[Case, list[Result]]]:
    """The same of results, with those of each block."""
    groups = grouped(results, lambda result: block_key(result.record)).values()
    return [(Case(tuple(result.record for result in own)), own) for own in groups]


def block_key(record: Record) -> Hashable:
    """What records of one block have in common."""
    rule = record.get("quadrature", "midpoint")
    return record["example"], record["n"], str(record["delta"]), rule, order_of(record)


def order_of(record: Record) -> int:
    """The order of the displacements."""
    return int(record.get("order") or 1)


def with_order(name: str, record: Record) -> str:
    """A name with the order of the displacements, if it is not 1."""
    return name if order_of(record) == 1 else f"{name}, order {order_of(record)}"


def relocates(record: Record) -> bool:
    """Whether its formulation moves nodes: the solution of ``fixed`` is that of the given mesh."""
    return bool(record["formulation"] != "fixed")


def end_of(record: Record) -> float:
    """What was minimised, at the end; infinite if that is not known."""
    end = ends_of(record)[1]
    return math.inf if end is None else end


def label(record: Record) -> str:
    """The formulation, with what sets a row apart from the default."""
    parts = [str(record.get("variant") or record["formulation"])]
    if record.get("chosen_by"):
        parts = [f"{record.get('variant') or record['chosen_by']} ({record['formulation']})"]
    if record["formulation"] == "mpcc" and record.get("start") in BORROWED:
        parts = [f"{record['start']}, certified as an MPCC solution"]
    if record.get("relaxation", DEFAULT_RELAXATION) != DEFAULT_RELAXATION:
        parts.append(str(record["relaxation"]))
    if objective_of(record) != "energy":
        parts.append(objective_of(record))
    elif record["objective"] != "energy" and not record.get("chosen_by"):
        parts.append("regularised")
    if record["seed"] is not None:
        parts.append(f"seed {record['seed']}")
    return ", ".join(parts)


def seedless(record: Record) -> str:
    """The label that solves from several starts share."""
    return label({**record, "seed": None})


def variant(record: Record) -> str:
    """The variant of a row: its name in the study, or in a comparison its label."""
    return str(record.get("variant") or seedless(record))


def variants_of(records: Records) -> list[str]:
    """All variants that relocate, in the order of the records: the same looks in all figures of a folder."""
    return list(dict.fromkeys(variant(r) for r in records if relocates(r)))


def names_of_blocks(groups: Sequence[Case]) -> list[str]:
    """Example of each block, with the settings that tell blocks of one example apart."""
    names = []
    for block in groups:
        told, rivals = [block.example], [other for other in groups if other.example == block.example]
        for place, text in enumerate(block.settings):
            alike = [other for other in rivals if other.settings[place] == text]
            told += [text] if len(alike) < len(rivals) or (place == 1 and text != LINEAR) else []
            rivals = alike
        names.append(", ".join(told))
    return names


def in_common_units(records: Records) -> list[Record]:
    """The records with the unit of cost of their block, :attr:`Case.unit`, if they measured one."""
    units = {block_key(block.records[0]): block.unit for block in blocks(records)}
    return [
        {**record, "contact_time_s": units[block_key(record)]} if record.get("contact_time_s") else record
        for record in records
    ]


def delta_text(delta: Any) -> str:
    """Half-widths as text, once if both are the same."""
    if delta is None:
        return "none"
    if isinstance(delta, dict):
        return f"{delta['relative']} x shortest edge"
    return f"{delta[0]:.6g}" if delta[0] == delta[1] else f"{delta[0]:.6g} x {delta[1]:.6g}"


def seconds_of_work(record: Record) -> float | None:
    """Seconds of build and solve, the assessment is no cost; of a killed one its wall time."""
    build, solve = record.get("build_time_s"), record.get("solve_time_s")
    return record.get("wall_time_s") if build is None or solve is None else build + solve


def contact_units(record: Record) -> float | None:
    """Build and solve over the time of one contact solve; of :func:`in_common_units` for a fair one."""
    seconds, unit = seconds_of_work(record), record.get("contact_time_s")
    return seconds / unit if seconds is not None and unit else None
