"""Records to tables: Markdown, LaTeX with booktabs, CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from rmesh_nlp.display import for_markdown, for_spreadsheet
from rmesh_nlp.io.folder import write_text
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
    FORMULATION,
    MAIN,
    OBJECTIVES,
    RESIDUALS,
    Column,
    body,
    table_of,
)
from rmesh_nlp.report.designs import design_tables
from rmesh_nlp.report.joined import joined_tables
from rmesh_nlp.report.notes import ENERGY, detailed_notes, main_notes, stopped_early, units_notes
from rmesh_nlp.report.study_summary import RANGES, is_study, median_table, study_notes, summary_table
from rmesh_nlp.report.table import Groups, Table
from rmesh_nlp.solving.parts import DESIGN

DETAILS = "## Details"  # what stands below it is in ``table.md``, and printed with ``--verbose`` only

# of the tables that LaTeX has; the others are in ``table.md`` and ``table.csv``
CAPTIONS = {
    MAIN: f"Relocation by each formulation. {ENERGY.replace('J is', '$J$ is')} The gain is in per cent of "
    r"$|J|$ on the given mesh. Times are wall times of build, solve and audit.",
    ENERGIES: r"Energies by the quadrature rule of the problem, extremes of the displacement $u$, the "
    r"contact on the relocated mesh, and the least element area over the given one.",
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


def _is_wanted(columns: tuple[Column, ...], block: Block) -> bool:
    """Whether a record of the block asks for these columns."""
    return any(map(WANTED.get(columns, lambda _: True), block.records))


def _of(columns: tuple[Column, ...], block: Block) -> str:
    return table_of(columns, [(block.title, body(columns, block))]).markdown()


def markdown(records: Sequence[Record]) -> str:
    """The short tables of :func:`short_markdown`, and below ``DETAILS`` all others."""
    parts = [short_markdown(records), f"{DETAILS}\n"]
    if is_study(records):
        return for_markdown("\n".join([*parts, f"{summary_table(records).markdown()}- {RANGES}\n"]))
    parts += _designs(records, is_long=True)
    for block in blocks(records):
        every = (ENERGIES, COSTS, COMMON, RESIDUALS, ERRORS) if block.has_energy else (COSTS, RESIDUALS)
        tables = (_of(columns, block) for columns in every if _is_wanted(columns, block))
        parts += [f"### {block.title}\n", *tables]
    parts.append(f"### Notes\n\n{_items(detailed_notes(records))}")
    return for_markdown("\n".join(parts))


def _designs(records: Sequence[Record], *, is_long: bool) -> Iterator[str]:
    """The tables of blocks whose energies do not compare, by titles: the long ones, or all others."""
    for block in blocks(records):
        for title, tables in () if block.has_energy else design_tables(block):
            shown = [table.markdown() for table in tables if table.is_long is is_long]
            yield from [f"### {title}\n", *shown] if shown else []


def short_markdown(records: Sequence[Record]) -> str:
    """One row per solve, what else was asked for, and what is needed to read it."""
    if is_study(records):
        return for_markdown(f"# Study\n\n{median_table(records).markdown()}\n{_items(study_notes(records))}")
    parts, of_energy = ["# Comparison of formulations\n"], [b for b in blocks(records) if b.has_energy]
    if of_energy or not records:
        parts.append(_main(of_energy) if records else "No solve has ended yet.\n")
    for columns in (OBJECTIVES, CERTIFICATES):
        wanted = (block for block in of_energy if _is_wanted(columns, block))
        parts += [f"### {block.title}\n\n{_of(columns, block)}" for block in wanted]
    parts += _designs(records, is_long=False)
    notes: list[str] = []
    for title, table in joined_tables(records).items():
        notes += table.notes
        for name, rows in table.groups:
            parts.append(f"## {title}: {name}\n\n{replace(table, groups=[(name, rows)]).markdown()}")
    parts.append(_items([*notes, *main_notes(records)]))
    return for_markdown("\n".join(parts))


def _main(groups: Sequence[Block]) -> str:
    """Audited energies, work and status, one row per solve."""
    records = [record for block in groups for record in block.records]
    rows = [row for block in groups for row in body(MAIN, block)]
    named = [[name, *row[1:]] for name, row in zip(names_of_solves(records), rows, strict=True)]
    return table_of((replace(FORMULATION, heading="solve"), *MAIN[1:]), [("", named)]).markdown()


def _items(notes: Sequence[str]) -> str:
    return "".join(f"- {note}\n" for note in notes)


def latex(records: Sequence[Record]) -> str:
    r"""Tables of at most eight columns, examples below each other; needs ``\usepackage{booktabs}``."""
    tables = (table.latex() for table in _latex_tables(records))
    return "\n".join(["% made by rmesh table; needs \\usepackage{booktabs}\n", *tables])


def _latex_tables(records: Sequence[Record]) -> Iterator[Table]:
    if is_study(records):
        medians = median_table(records)
        families = grouped(medians.rows, lambda row: row[0])
        groups: Groups = [(name, [row[1:] for row in own]) for name, own in families.items()]
        yield Table(medians.head[1:], groups, "Results of the study.", study_notes(records))
        return
    units, every = units_notes(records), blocks(records)
    printed = ["The paper truncates its digits."] if any(block.paper for block in every) else []
    below = {MAIN: [*units, *stopped_early(records)], ENERGIES: [*printed, *units]}
    for columns, caption in CAPTIONS.items():
        wanted = (block for block in every if block.has_energy and _is_wanted(columns, block))
        examples = [(block.title, body(columns, block)) for block in wanted]
        if examples:
            yield table_of(columns, examples, caption, below.get(columns, ()))
    for block in every:
        for _, tables in () if block.has_energy else design_tables(block):
            yield from tables
    yield from joined_tables(records).values()


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
