"""Tables of records whose energies do not compare: designs, and other objectives with Coulomb friction.

For each problem and objective a table of outcomes and one of work, then what was found: design variables and
constrained quantities by name, beside their bounds and the first design.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rmesh_nlp.display import bounds_in_words
from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, ends_of, gain_of, label
from rmesh_nlp.report.columns import BIACTIVE, LABEL, Column, of, shown, table_of
from rmesh_nlp.report.notes import stopped_early, units_notes
from rmesh_nlp.report.table import MISSING, Rows, Table, latex_text

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
ENDS = (
    Column("objective|at start", "objective_initial", ".5e"),
    Column("objective|at end", "objective_value", ".5e"),
)
LEFT = Column("left on refined|meshes [%]", _left, ".3g")
OUTCOME = (
    FORMULATION,
    *ENDS,
    Column("gain|[%]", lambda record: gain_of(*ends_of(record)), ".4g"),
    LEFT,
    VIOLATION,
    LABEL,
    *of("status"),
)
WORK = (
    FORMULATION,
    *of("iterations", "contact_solves", "kkt_factorisations", "wall_time_s"),
    Column("first-order|residual", "stationarity_residual", ".1e"),
    BIACTIVE,
)


def design_tables(block: Block) -> Iterator[tuple[str, list[Table]]]:
    """The tables of a block, by its title with the objective."""
    title, notes = block.title, (*units_notes(block.records), *stopped_early(block.records))

    def of_solves(columns: Sequence[Column], caption: str) -> Table:
        rows = [[column.cell(record) for column in columns] for record in records]
        return table_of(columns, [(title, rows)], latex_text(caption), notes)

    for objective, records in block.objectives.items():
        outcome: tuple[Column, ...] = OUTCOME
        if not any(record.get("constraints") for record in records):
            outcome = tuple(column for column in OUTCOME if column is not VIOLATION)
        named = (("design", "Design variables"), ("constraints", "Constrained quantities"))
        tables = [
            of_solves(outcome, f"{OUTCOME_CAPTION}{objective}."),
            of_solves(WORK, f"{WORK_CAPTION}{objective}."),
            *(
                Table(
                    head, [(title, rows)], latex_text(f"{said}. Objective: {objective}."), notes, is_long=long
                )
                for entry, said in named
                for head, rows, long in _by_name(entry, records)
            ),
        ]
        yield f"{title}: {objective}", tables


def _by_name(entry: str, records: Sequence[Record]) -> Iterator[tuple[Sequence[str], Rows, bool]]:
    """Design variables or constrained quantities: bounds, the first design, and where each solve ended.

    A head, its rows, and whether each name has a row.
    """
    solved = [record for record in records if record.get(entry)]
    names = list(dict.fromkeys(name for record in solved for name in record[entry]))
    if not names:
        return
    bounds, value = _of_constraints(solved) if entry == "constraints" else _of_design(solved)
    rows = [["bounds", *map(bounds, names)]]
    start = solved[0].get(f"{entry}_initial") or {}
    if start:
        rows.append(["start", *(shown(start.get(name), ".5g") for name in names)])
    solves = [
        [short_label(record), *(value(record, name) for name in names)]
        for record in solved
        if record["formulation"] != "fixed" or entry == "constraints"
    ]
    if len(names) <= FEW:
        yield ["formulation", *names], [*rows, *solves], False
        return
    for first in range(0, max(len(solves), 1), FEW):
        some = [["name", *names], *rows, *solves[first : first + FEW]]
        head, *body = (list(row) for row in zip(*some, strict=True))
        yield head, body, True


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
        limits = next(record["constraints"][name] for record in known if name in record["constraints"])
        return bounds_in_words(limits.get("lower"), limits.get("upper"))

    def value(record: Record, name: str) -> str:
        return shown(record["constraints"].get(name, {}).get("value"), ".5g")

    return bounds, value
