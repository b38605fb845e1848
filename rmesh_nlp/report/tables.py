"""Records to tables: Markdown, LaTeX with booktabs, CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from rmesh_nlp.display import for_spreadsheet
from rmesh_nlp.io.folder import Manifest, write_text
from rmesh_nlp.io.records import Records
from rmesh_nlp.io.results import TABLES
from rmesh_nlp.report.blocks import Case, blocks, contact_units, label, names_of_blocks, order_of
from rmesh_nlp.report.columns import KINDS, RESULTS, Column, of_boundaries, table_of
from rmesh_nlp.report.joined import NAMED, joined_tables, named_tables
from rmesh_nlp.report.notes import (
    block_notes,
    main_notes,
    settings_notes,
    stopped_early,
    units_notes,
)
from rmesh_nlp.report.study_summary import is_study, median_table, study_notes, summary_table
from rmesh_nlp.report.table import Table
from rmesh_nlp.solving.parts import DESIGN

DETAILS = "# Details"  # what stands below it is in ``table.md``, and printed with ``--verbose`` only


def sections_of(records: Records) -> list[tuple[str, Case]]:
    """Blocks with their names, one for each objective where energies do not compare."""
    groups = blocks(records)
    return [
        (name, Case(tuple(own)))
        for block, name in zip(groups, names_of_blocks(groups), strict=True)
        for own in ([block.records] if block.has_energy else block.objectives.values())
    ]


def tables(records: Records) -> list[Table]:
    """The tables of a comparison: those of :data:`KINDS` with the solves of all blocks, and joined ones."""
    sections = sections_of(records)
    notes = [*settings_notes(records), *units_notes(records)]
    made = []
    for kind in KINDS:
        rows = [
            {**record, "solve": f"{name}, {label(record)}"}
            for name, block in sections
            if kind.is_wanted(block)
            for record in kind.rows(block.records)
        ]
        if rows:
            table = table_of(
                (Column("solve", "solve"), *kind.columns),
                rows,
                title=kind.title,
                caption=kind.caption,
                notes=notes if kind.is_detail else [*notes, *stopped_early(records)],
                is_detail=kind.is_detail,
            )
            made.append(table)
    for name, block in sections:
        for entry in () if block.has_energy else NAMED:
            made += named_tables(name, block.records, entry)
    return made + joined_tables(records)


def markdown(records: Records, *, short: bool = False) -> str:
    """One row per solve, what else was asked for, and what is needed to read it; below ``DETAILS`` the rest.

    A ``short`` one ends before the details.
    """
    study = is_study(records)
    every = [median_table(records), summary_table(records)] if study else tables(records)
    parts = ["# Study\n" if study else "# Comparison of formulations\n"]
    parts += [table.section() for table in every if not table.is_detail]
    notes = study_notes(records) if study else main_notes(records)
    if notes or not records:
        parts.append(_items(notes) if records else "No solve has ended yet.\n")
    if not short:
        parts += [f"{DETAILS}\n", *(table.section() for table in every if table.is_detail)]
    if not short and not study:
        remarks = [*settings_notes(records), *block_notes(records)]
        parts.append(f"## Notes\n\n{_items(remarks)}")
    return "\n".join(parts).replace("<", "&lt;")


def _items(notes: Sequence[str]) -> str:
    return "".join(f"- {note}\n" for note in notes)


def latex(records: Records) -> str:
    r"""Tables of at most eight columns, of all examples; needs ``\usepackage{booktabs}``."""
    every = [median_table(records)] if is_study(records) else tables(records)
    return "\n".join(
        ["% made by rmesh table; needs \\usepackage{booktabs}\n", *(table.latex() for table in every)]
    )


def frame(records: Records) -> pd.DataFrame:
    """One row per record with every scalar field, by blocks."""
    rows = []
    for block in blocks(records):
        for record in block.records:
            row = {name: value for name, value in record.items() if not isinstance(value, (dict, list))}
            row |= {DESIGN + name: value for name, value in (record.get("design") or {}).items()}
            for own in of_boundaries([record]):
                row |= {f"{name.replace('_', ' ')} ({own['boundary']})": own.get(name) for name in RESULTS}
            for text, one in (record.get("constraints") or {}).items():
                row[f"constraint.{text}"] = one.get("value")
            row["order"] = order_of(record)
            row["delta"] = "x".join(map(str, record["delta"] or ()))
            row["time_contact_solves"] = contact_units(record)
            rows.append(row)
    return pd.DataFrame(rows)


def csv(records: Records) -> str:
    """The same as CSV, without text that a spreadsheet would run."""
    table = frame(records).rename(columns=for_spreadsheet)
    return str(table.apply(lambda column: column.map(for_spreadsheet)).to_csv(index=False))


def write_tables(records: Records, folder: Path) -> None:
    """Write ``table.md``, ``table.tex`` and ``table.csv``; BadInputError if one there is the user's."""
    Manifest(folder).claim(*TABLES)
    for name, content in zip(TABLES, (markdown(records), latex(records), csv(records)), strict=True):
        write_text(folder / name, content)
