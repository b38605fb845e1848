"""Records to tables: Markdown, LaTeX with booktabs, CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pandas as pd

from rmesh_nlp.display import for_markdown, for_spreadsheet
from rmesh_nlp.io.files import write_text
from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.io.results import TABLES, Results
from rmesh_nlp.report.blocks import (
    Block,
    blocks,
    contact_units,
    grouped,
    names_of_solves,
    order_of,
)
from rmesh_nlp.report.columns import (
    CERTIFICATES,
    COMMON,
    COSTS,
    ENERGIES,
    ERRORS,
    MAIN,
    OBJECTIVES,
    RESIDUALS,
    Column,
    body,
)
from rmesh_nlp.report.designs import sheets
from rmesh_nlp.report.joined import joined_tables
from rmesh_nlp.report.markup import Groups, latex_table, latex_text, markdown_table
from rmesh_nlp.report.notes import ENERGY, detailed_notes, main_notes, stopped_early, units_notes
from rmesh_nlp.report.study_summary import RANGES, is_study, median_rows, study_notes, summary_rows
from rmesh_nlp.solving.parts import DESIGN

DETAILS = "## Details"  # what stands below it is in ``table.md``, and printed with ``--verbose`` only

# of the tables that LaTeX has; the others are in ``table.md`` and ``table.csv``
CAPTIONS = {
    MAIN: f"Relocation by each formulation. {ENERGY.replace('J is', '$J$ is')} The gain is in per cent of "
    r"$|J|$ on the given mesh. Times are wall times of build, solve and audit.",
    ENERGIES: r"Energies by the quadrature rule of the problem, extremes of the displacement $u$, and the "
    r"least element area over the given one.",
    COMMON: r"Cost, in contact solves on the given mesh, until each formulation reached what all of them "
    r"reach: an energy or other objective, and a first-order residual.",
    RESIDUALS: r"Dimensionless residuals of equilibrium and complementarity, of the state that the "
    r"formulation ended with and of an independent contact solve on its mesh, and the first-order residual "
    r"of the outer problem over that on the given mesh.",
    ERRORS: r"Theorem 4.1: errors in energy ($I_1$), contact ($I_2$) and friction ($I_3$), and the energy "
    r"above the exact one.",
    OBJECTIVES: r"Outer objectives other than the energy.",
    CERTIFICATES: r"Bounds of the least energy, and of the error in the energy norm in per cent of the norm.",
}

# tables that a block of records has only where one of its records asks for it
WANTED: dict[tuple[Column, ...], Callable[[Record], bool]] = {
    COMMON: lambda record: record.get("common_objective") is not None,
    ERRORS: lambda record: record.get("I1") is not None,
    OBJECTIVES: lambda record: objective_of(record) != "energy",
    CERTIFICATES: lambda record: "certificate_remark" in record,
}


def _having(columns: tuple[Column, ...], records: Sequence[Record]) -> list[Block]:
    """The blocks with a record that asks for these columns."""
    wanted = WANTED.get(columns, lambda _: True)
    return [block for block in blocks(records) if any(wanted(record) for record in block.records)]


def markdown(records: Sequence[Record]) -> str:
    """The short tables of :func:`short_markdown`, and below ``DETAILS`` all others."""
    parts = [short_markdown(records), f"{DETAILS}\n"]
    if is_study(records):
        return for_markdown("\n".join([*parts, f"{markdown_table(*summary_rows(records))}- {RANGES}\n"]))
    parts += _designs(records, is_long=True)
    for block in blocks(records):
        parts.append(f"### {block.title}\n")
        every = (ENERGIES, COSTS, COMMON, RESIDUALS, ERRORS)
        for columns in every if block.has_energy else (COSTS, RESIDUALS):
            parts += [_block_table(columns, one) for one in _having(columns, block.records)]
    parts.append(f"### Notes\n\n{_items(detailed_notes(records))}")
    return for_markdown("\n".join(parts))


def _of_energy(records: Sequence[Record], wanted: bool = True) -> list[Record]:
    """The records of the blocks whose energies compare, or of all others."""
    return [record for block in blocks(records) if block.has_energy is wanted for record in block.records]


def _designs(records: Sequence[Record], *, is_long: bool) -> Iterator[str]:
    """The tables of the others below their titles: the long ones, or all but those."""
    for block in blocks(_of_energy(records, wanted=False)):
        for title, found in sheets(block):
            tables = [markdown_table(one.head, one.rows) for one in found if one.is_long is is_long]
            yield from [f"### {title}\n", *tables] if tables else []


def short_markdown(records: Sequence[Record]) -> str:
    """One row per solve, what else was asked for, and what is needed to read it."""
    if is_study(records):
        table = markdown_table(*median_rows(records))
        return for_markdown(f"# Study\n\n{table}\n{_items(study_notes(records))}")
    parts, of_energy = ["# Comparison of formulations\n"], _of_energy(records)
    if of_energy or not records:
        parts.append(main_table(of_energy) if records else "No solve has ended yet.\n")
    for columns in (OBJECTIVES, CERTIFICATES):
        for block in _having(columns, of_energy):
            parts += [f"### {block.title}\n", _block_table(columns, block)]
    parts += _designs(records, is_long=False)
    notes: list[str] = []
    for joined in joined_tables(records):
        notes += joined.notes
        for name, rows in joined.groups:
            parts.append(f"## {joined.title}: {name}\n\n{markdown_table(joined.head, rows)}")
    parts.append(_items([*notes, *main_notes(records)]))
    return for_markdown("\n".join(parts))


def main_table(records: Sequence[Record]) -> str:
    """Audited energies, work and status, one row per solve."""
    solved = [row for block in blocks(records) for row in body(MAIN, block)]
    named = [[name, *row[1:]] for name, row in zip(names_of_solves(records), solved, strict=True)]
    return markdown_table(["solve", *(column.head for column in MAIN[1:])], named)


def _block_table(columns: tuple[Column, ...], block: Block) -> str:
    return markdown_table([column.head for column in columns], body(columns, block))


def _items(notes: Sequence[str]) -> str:
    return "".join(f"- {note}\n" for note in notes)


def latex(records: Sequence[Record]) -> str:
    r"""Tables of at most eight columns, examples below each other; needs ``\usepackage{booktabs}``."""
    tables = (latex_table(*table) for table in _latex_tables(records))
    return "\n".join(["% made by rmesh table; needs \\usepackage{booktabs}\n", *tables])


def _latex_tables(records: Sequence[Record]) -> Iterator[tuple[list[str], Groups, str, Sequence[str]]]:
    """Heads, groups of rows, caption and notes of each."""
    if is_study(records):
        head, rows = median_rows(records)
        families = grouped(rows, lambda row: row[0])
        groups = [(name, [row[1:] for row in own]) for name, own in families.items()]
        yield [latex_text(cell) for cell in head[1:]], groups, "Results of the study.", study_notes(records)
        return
    units, of_energy = units_notes(records), _of_energy(records)
    printed = ["The paper truncates its digits."] if any(block.paper for block in blocks(records)) else []
    below = {MAIN: [*units, *stopped_early(records)], ENERGIES: [*printed, *units]}
    for columns, caption in CAPTIONS.items():
        own = [(block.title, body(columns, block)) for block in _having(columns, of_energy)]
        if own:
            yield [column.tex for column in columns], own, caption, below.get(columns, ())
    for block in blocks(_of_energy(records, wanted=False)):
        notes = (*units_notes(block.records), *stopped_early(block.records))
        for one in (one for _, found in sheets(block) for one in found):
            yield list(one.tex), [(block.title, one.rows)], latex_text(one.caption), notes
    for table in joined_tables(records):
        yield [latex_text(cell) for cell in table.head], table.groups, table.caption, table.notes


def frame(records: Sequence[Record]) -> pd.DataFrame:
    """One row per record with every scalar field, the paper's values beside ours."""
    rows = []
    for block in blocks(records):
        paper = block.paper
        for record in block.records:
            row = {name: value for name, value in record.items() if not isinstance(value, (dict, list))}
            row |= {DESIGN + name: value for name, value in (record.get("design") or {}).items()}
            for text, one in (record.get("constraints") or {}).items():
                row[f"constraint.{text}"] = one.get("value")
            row["order"] = order_of(record)
            row["delta"] = "x".join(map(str, record["delta"] or ()))
            row["time_contact_solves"] = contact_units(record)
            row["paper_energy_initial"] = paper and paper.energy_initial
            row["paper_energy_final"] = paper and paper.energy_final
            rows.append(row)
    return pd.DataFrame(rows)


def csv(records: Sequence[Record]) -> str:
    """The same as CSV, without text that a spreadsheet would run."""
    table = frame(records).rename(columns=for_spreadsheet)
    return str(table.apply(lambda column: column.map(for_spreadsheet)).to_csv(index=False))


def write_tables(records: Sequence[Record], folder: Path) -> None:
    """Write ``table.md``, ``table.tex`` and ``table.csv``; BadInputError if one there is the user's."""
    Results(folder).manifest.claim(*TABLES)
    for name, content in zip(TABLES, (markdown(records), latex(records), csv(records)), strict=True):
        write_text(folder / name, content)
