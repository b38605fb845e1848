"""Records to tables: Markdown, LaTeX with booktabs, CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from rmesh_nlp.display import for_spreadsheet
from rmesh_nlp.io.folder import Manifest, write_text
from rmesh_nlp.io.records import Record, Records, has_energy, objective_of
from rmesh_nlp.io.results import TABLES
from rmesh_nlp.report.blocks import Case, blocks, contact_units, label, names_of_blocks, order_of
from rmesh_nlp.report.columns import (
    CONTACT,
    KINDS,
    OF_BOUNDARIES,
    PRINTED,
    RESULTS,
    Column,
    Kind,
    of,
    of_boundaries,
    table_of,
)
from rmesh_nlp.report.joined import NAMED, joined_tables, named_tables, with_refinement_gains
from rmesh_nlp.report.notes import main_notes, settings_notes, stopped_early, units_notes
from rmesh_nlp.report.study_summary import is_study, median_table, study_notes, summary_table
from rmesh_nlp.report.table import Table
from rmesh_nlp.solving.parts import DESIGN, FEW

SOLVE = Column("solve", "solve")
OF_ENERGY = ("energy_initial", "energy", "energy_initial_audited", "energy_audited")


def sections_of(records: Records) -> list[tuple[str, Case]]:
    """Blocks of named solves with their names, one for each objective where energies do not compare."""
    groups = blocks(with_refinement_gains(records))
    return [
        (name, Case(tuple({**record, "solve": f"{name}, {label(record)}"} for record in own)))
        for block, name in zip(groups, names_of_blocks(groups), strict=True)
        for own in ([block.records] if block.has_energy else block.objectives.values())
    ]


def _further(records: Records, *, short: bool = False) -> list[Table]:
    """Tables whose rows are no solves; a short list is without long ones."""
    sections = sections_of(records)
    boundaries = of_boundaries([row for _, block in sections for row in block.records])
    made = [table_of((SOLVE, *CONTACT), boundaries, title="Contact boundaries", caption=OF_BOUNDARIES)]
    for name, block in sections:
        for entry in () if block.has_energy else NAMED:
            made += named_tables(name, block.records, entry)
    made += joined_tables(records)
    return [table for table in made if table.rows and not (short and table.is_detail)]


def comparable(record: Record) -> Record:
    """Energies only where they compare, objectives only where they are no energies."""
    unknown = () if has_energy(record) else OF_ENERGY
    if objective_of(record) == "energy":
        unknown = (*unknown, "objective_initial", "objective_value")
    shown = {**record, **dict.fromkeys(unknown)}
    return shown | {f"{DESIGN}{name}": value for name, value in (record.get("design") or {}).items()}


def table_of_solves(records: Records, kinds: Sequence[Kind] = KINDS) -> Table:
    """One row per solve, of blocks that a kind is for, with the columns and captions of these kinds.

    Of all kinds further columns follow, and what all solves share stands above the captions.
    """
    asked = [(block, [kind for kind in kinds if kind.is_wanted(block)]) for _, block in sections_of(records)]
    rows = [comparable(row) for block, wanted in asked if wanted for row in block.records]
    used = [kind for kind in kinds if any(kind in wanted for _, wanted in asked)]
    further = (*of("nodes", "unknowns"), *design_columns(records)) if kinds is KINDS else ()
    whole = table_of((SOLVE, *(column for kind in used for column in kind.columns), *further), rows)
    columns = [*zip(whole.head, *whole.rows, strict=True)]
    shared = [column for column in columns if kinds is KINDS and len({*column[1:]}) == 1 < len(rows)]
    head, *kept = zip(*(column for column in columns if column not in shared), strict=True)
    same = ", ".join(f"{column[0]} {column[1]}" for column in shared).replace("|", " ")
    captions = [*([f"The same for all: {same}."] if same else []), *(kind.caption for kind in used)]
    failed = {i for i, row in enumerate(rows) if not row["success"] and row["status"] != "refused"}
    return Table(head, kept, "\n\n".join(captions), failed=failed)


def design_columns(records: Records) -> list[Column]:
    """A column for each of a few design variables."""
    names = dict.fromkeys(name for record in records for name in record.get("design") or {})
    return [Column(name, DESIGN + name, ".5g") for name in names] if len(names) <= FEW else []


def markdown(records: Records, *, short: bool = False, width: int = 0) -> str:
    """One row per solve, what else was asked for, and what is needed to read it.

    A ``short`` one has the main columns. Columns beyond the ``width`` of a screen, if one is given, follow
    below.
    """
    if study := is_study(records):
        every, notes = [median_table(records) if short else summary_table(records)], study_notes(records)
    elif records:
        every = [table_of_solves(records, PRINTED if short else KINDS), *_further(records, short=short)]
        notes = [*main_notes(records), *([] if short else settings_notes(records))]
    else:
        every, notes = [], ["No solve has ended yet."]
    parts = ["# Study\n" if study else "# Comparison of formulations\n"]
    parts += [table.section(width) for table in every]
    items = ["".join(f"- {note}\n" for note in notes)] if notes else []
    return "\n".join([*parts, *items]).replace("<", "&lt;")


def latex(records: Records) -> str:
    r"""Tables of at most eight columns, of all examples; needs ``\usepackage{booktabs}``."""
    if is_study(records):
        every, notes = [median_table(records)], study_notes(records)
    else:
        every = [*(table_of_solves(records, [kind]) for kind in KINDS), *_further(records)]
        notes = [note for of in (settings_notes, units_notes, stopped_early) for note in of(records)]
    tables = [table.latex(notes) for table in every if table.rows]
    return "\n".join(["% made by rmesh table; needs \\usepackage{booktabs}\n", *tables])


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
