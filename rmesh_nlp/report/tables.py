"""Records to tables: Markdown, LaTeX with booktabs, CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from rmesh_nlp.display import for_markdown, for_spreadsheet
from rmesh_nlp.io.files import write_text
from rmesh_nlp.io.record_model import Record
from rmesh_nlp.io.results import TABLES, Results
from rmesh_nlp.report import multistart
from rmesh_nlp.report.blocks import blocks
from rmesh_nlp.report.columns import (
    CERTIFICATES,
    COMMON,
    COSTS,
    ENERGIES,
    ERRORS,
    OBJECTIVES,
    RESIDUALS,
    Column,
    body,
    contact_units,
)
from rmesh_nlp.report.markup import latex_table, latex_text, markdown_table
from rmesh_nlp.report.notes import notes
from rmesh_nlp.report.refinement import HEAD, TITLE, refinement_notes, refinement_rows
from rmesh_nlp.report.study_summary import is_study, summary_markdown, summary_rows

CAPTIONS = {
    ENERGIES: r"Energies and extremes of the displacement; the paper truncates its digits.",
    COSTS: r"Work by one clock: building the programs, solving them, and the audit, which is not a cost.",
    COMMON: r"Cost to the audited energy, or other objective, and to the first-order residual that all "
    r"strategies reach.",
    RESIDUALS: r"Residuals of each strategy's own state, and of the referee's contact solve on its mesh.",
    ERRORS: r"Theorem 4.1: errors in energy, contact and friction, and the energy above the exact one.",
    OBJECTIVES: r"Outer objectives.",
    CERTIFICATES: r"Bounds of the least energy, and of the error in the energy norm in per cent of the norm.",
}


def markdown(records: Sequence[Record]) -> str:
    """Tables of each example, and the notes."""
    if is_study(records):
        return for_markdown(f"# Study\n\n{summary_markdown(records)}")
    parts = ["# Comparison of strategies\n"]
    for block in blocks(records):
        parts.append(f"## {block.title}\n")
        parts += [
            markdown_table([column.head for column in columns], body(columns, block))
            for columns in _tables(block.records)
        ]
    for name, rows in multistart.multistart_rows(records):
        parts.append(f"## {multistart.TITLE}: {name}\n")
        parts.append(markdown_table(multistart.HEAD, rows))
    for name, rows in refinement_rows(records):
        parts.append(f"## {TITLE}: {name}\n")
        parts.append(markdown_table(HEAD, rows))
    parts += [f"{note}\n" for note in refinement_notes(records)]
    if not records:
        parts.append("No solve has ended yet.\n")
    parts.append("## Notes\n")
    parts.append("".join(f"- {note}\n" for note in notes(records)))
    return for_markdown("\n".join(parts))


def latex(records: Sequence[Record]) -> str:
    r"""One ``table`` per kind, examples below each other, each as wide as a column of a page at most.

    Needs ``\usepackage{booktabs,threeparttable}``. The notes stand below the last table.
    """
    parts = ["% made by rmesh table; needs \\usepackage{booktabs,threeparttable}\n"]
    if is_study(records):
        head, rows = summary_rows(records)
        caption = "Medians over successful solves, in brackets their range; failures count as failures."
        joined = [[f"{row[0]}, {row[1]}", *row[2:]] for row in rows]  # wide tables repeat one column only
        names = ["family, strategy", *map(latex_text, head[2:])]
        return parts[0] + latex_table(names, [("medians", joined)], caption)
    tables = [
        ([column.tex for column in columns], [(b.title, body(columns, b)) for b in blocks(records)], columns)
        for columns in _tables(records)
    ]
    finer = refinement_rows(records)
    said = [latex_text(note) for note in refinement_notes(records)]
    for head, groups, columns in tables:
        last = columns is tables[-1][2]
        below = notes(records) if last else ()
        parts.append(latex_table(head, groups, CAPTIONS[columns], below))
    several = multistart.multistart_rows(records)
    if several:
        parts.append(latex_table(multistart.HEAD, several, f"{multistart.TITLE}."))
    if finer:
        parts.append(latex_table(HEAD, finer, " ".join([f"{TITLE}.", *said])))
    return "\n".join(parts)


def frame(records: Sequence[Record]) -> pd.DataFrame:
    """One row per record with every scalar field, the paper's values beside ours."""
    rows = []
    for block in blocks(records):
        paper = block.paper
        for record in block.records:
            row = {name: value for name, value in record.items() if not isinstance(value, (dict, list))}
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


def write_tables(records: Sequence[Record], folder: Path) -> str:
    """Write ``table.md``, ``table.tex`` and ``table.csv``; returns the Markdown.

    Raises
    ------
    BadInputError
        If a file of one of these names is there that this package did not write.
    """
    Results(folder).manifest.claim(*TABLES)
    text = markdown(records)
    for name, content in (
        ("table.md", text),
        ("table.tex", latex(records)),
        ("table.csv", csv(records)),
    ):
        write_text(folder / name, content)
    return text


def _tables(records: Sequence[Record]) -> list[tuple[Column, ...]]:
    """The tables these records need: those of outer objectives and certificates only where there are any."""
    kinds: list[tuple[Column, ...]] = [ENERGIES, COSTS]
    if any(record.get("common_objective") is not None for record in records):
        kinds.append(COMMON)
    kinds.append(RESIDUALS)
    if any(record.get("I1") is not None for record in records):
        kinds.append(ERRORS)
    if any(record["objective"] != "energy" for record in records):
        kinds.append(OBJECTIVES)
    if any("certificate_remark" in record for record in records):
        kinds.append(CERTIFICATES)
    return kinds
