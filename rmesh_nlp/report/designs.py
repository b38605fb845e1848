"""Tables of records whose energies do not compare: designs, and other objectives with Coulomb friction.

For each problem and objective a table of outcomes and one of work, then what was found: design variables and
constrained quantities by name, beside their bounds and the first design.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.display import bounds_in_words
from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, label, objective_gain
from rmesh_nlp.report.columns import BIACTIVE, LABEL, STATUS, TIME, Column, shown
from rmesh_nlp.report.markup import MISSING, latex_text

FEW = 6
"""Names that have a column each; of more each has a row, and so many solves have a column."""

OUTCOME_CAPTION = (
    "Outcome: the objective at the start and at the end, the gain and the part of it that is left on uniform "
    " refinements of both meshes, the largest violation of a constraint over its bound, and the "
    "stationarity over the branches of the contact. Objective: "
)
WORK_CAPTION = (
    "Work: factorisations of KKT matrices (at least so many), wall times of build, solve and audit, and the "
    "first-order residual over that at the start. Objective: "
)


def violation(record: Record) -> float | None:
    """The largest violation of a constraint over its largest bound; None where nothing is constrained."""
    parts = []
    for one in (record.get("constraints") or {}).values():
        value, bounds = one.get("value"), (one.get("lower"), one.get("upper"))
        if value is not None:
            low, high = (value if bound is None else bound for bound in bounds)
            unit = max((abs(bound) for bound in bounds if bound is not None), default=0.0) or 1.0
            parts.append(max(low - value, value - high, 0.0) / unit)
    return max(parts, default=None)


def _left(record: Record) -> float | None:
    share = record.get("gain_surviving")
    return None if share is None else 100 * float(share)


def short_label(record: Record) -> str:
    """The label below a heading that names the objective."""
    return label({**record, "objective": "energy"})


FORMULATION = Column("formulation", short_label)
VIOLATION = Column("violation", violation, ".1e")
OUTCOME = (
    FORMULATION,
    Column("objective|at start", "objective_initial", ".5e"),
    Column("objective|at end", "objective_value", ".5e"),
    Column("gain|[%]", objective_gain, ".4g"),
    Column("left on refined|meshes [%]", _left, ".3g"),
    VIOLATION,
    LABEL,
    STATUS,
)
WORK = (
    FORMULATION,
    Column("iterations", "iterations"),
    Column("contact|solves", "contact_solves"),
    Column("KKT|factorisations", "kkt_factorisations"),
    TIME,
    Column("first-order|residual", "stationarity_residual", ".1e"),
    BIACTIVE,
)


@dataclass(frozen=True)
class Sheet:
    """One table: headings in plain text and in LaTeX, rows of cells, and a caption in plain text."""

    head: Sequence[str]
    tex: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    is_long: bool = False


def sheets(block: Block) -> Iterator[tuple[str, list[Sheet]]]:
    """The tables of a block, by its title with the objective."""
    for objective, records in block.objectives.items():
        outcome: tuple[Column, ...] = OUTCOME
        if not any(record.get("constraints") for record in records):
            outcome = tuple(column for column in OUTCOME if column is not VIOLATION)
        found = [
            _sheet(outcome, records, OUTCOME_CAPTION + objective),
            _sheet(WORK, records, WORK_CAPTION + objective),
            *_found("design", "Design variables. Objective: " + objective, records),
            *_found("constraints", "Constrained quantities. Objective: " + objective, records),
        ]
        yield f"{block.title}: {objective}", found


def _sheet(columns: Sequence[Column], records: Sequence[Record], caption: str) -> Sheet:
    rows = [[column.cell(record) for column in columns] for record in records]
    return Sheet([one.head for one in columns], [one.tex for one in columns], rows, f"{caption}.")


def _named(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str, is_long: bool) -> Sheet:
    return Sheet(head, [latex_text(name) for name in head], rows, f"{caption}.", is_long)


def _found(entry: str, caption: str, records: Sequence[Record]) -> Iterator[Sheet]:
    """Design variables or constrained quantities: bounds, the first design, and where each solve ended."""
    known = [record for record in records if record.get(entry)]
    names = list(dict.fromkeys(name for record in known for name in record[entry]))
    if not names:
        return
    bounds, value = _of_constraints(known) if entry == "constraints" else _of_design(known)
    rows = [["bounds", *map(bounds, names)]]
    start = known[0].get(f"{entry}_initial") or {}
    if start:
        rows.append(["start", *(shown(start.get(name), ".5g") for name in names)])
    solves = [
        [short_label(record), *(value(record, name) for name in names)]
        for record in known
        if record["formulation"] != "fixed" or entry == "constraints"
    ]
    if len(names) <= FEW:
        yield _named(["formulation", *names], [*rows, *solves], caption, is_long=False)
        return
    for first in range(0, max(len(solves), 1), FEW):
        some = [["name", *names], *rows, *solves[first : first + FEW]]
        head, *body = (list(row) for row in zip(*some, strict=True))
        yield _named(head, body, caption, is_long=True)


Cells = tuple[Callable[[str], str], Callable[[Record, str], str]]
"""Bounds of a name in words, and its value in a record."""


def _of_design(known: Sequence[Record]) -> Cells:
    limits = known[0].get("design_bounds") or {}

    def bounds(name: str) -> str:
        pair: Any = limits.get(name)
        return MISSING if pair is None else bounds_in_words(*pair)

    return bounds, lambda record, name: shown(record["design"].get(name), ".5g")


def _of_constraints(known: Sequence[Record]) -> Cells:
    def bounds(name: str) -> str:
        one = next(record["constraints"][name] for record in known if name in record["constraints"])
        return bounds_in_words(one.get("lower"), one.get("upper"))

    def value(record: Record, name: str) -> str:
        return shown(record["constraints"].get(name, {}).get("value"), ".5g")

    return bounds, value
