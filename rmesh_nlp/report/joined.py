"""Tables whose rows join several records: ends of several starts, and relocation against refinement."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from rmesh_nlp.io.records import Record, has_energy
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    blocks,
    contact_units,
    ends_of,
    grouped,
    label,
    seedless,
    with_order,
)
from rmesh_nlp.report.columns import shown
from rmesh_nlp.report.table import Table

STARTS = ("formulation", "starts", "best", "median", "worst", "failures", "cost [contact solves]")
MESHES = ("mesh", "formulation", "nodes", "J audited", "gain", "time [s]")
STARTS_CAPTION = (
    "Ends of solves from several starts: audited energies, or values of another objective. The cost "
    "is the median of one start."
)
MESHES_CAPTION = (
    "Relocation against uniform refinement: audited energies $J$ and gains over the given mesh, with "
    "the wall time of each solve."
)


def joined_tables(records: Sequence[Record]) -> dict[str, Table]:
    """Those of the two that have rows, by their titles."""
    finer = refinement_rows(records), MESHES_CAPTION, refinement_notes(records)
    tables = {
        "Several starts": Table(STARTS, multistart_rows(records), STARTS_CAPTION),
        "Relocation against uniform refinement": Table(MESHES, *finer),
    }
    return {title: table for title, table in tables.items() if table.groups}


def multistart_rows(records: Sequence[Record]) -> list[tuple[str, list[list[str]]]]:
    """Per block, a row for each formulation and objective that was solved from two starts or more."""
    tables = []
    for block in blocks(records):
        groups = grouped((r for r in block.records if r["status"] != "refused"), seedless)
        rows = [row for name, group in groups.items() if (row := _starts(name, group))]
        tables.append((block.title, rows))
    return [(title, rows) for title, rows in tables if rows]


def _starts(name: str, group: Sequence[Record]) -> list[str] | None:
    """Best, median and worst end of several solves, or of one whose solve had starts of its own."""
    ends: list[float | None]
    if len(group) == 1 and group[0].get("start_energies"):
        ends = list(group[0].get("start_values") or group[0]["start_energies"])
        costs: list[float] = []
    elif len({record["seed"] for record in group}) > 1:
        ends = [ends_of(record)[1] if record["success"] else None for record in group]
        costs = [cost for r in group if r["success"] and (cost := contact_units(r)) is not None]
    else:
        return None
    values = [end for end in ends if end is not None]
    figures = [shown(f(values) if values else None, ".7g") for f in (min, median, max)]
    middle = shown(median(costs) if costs else None, ".3g")
    return [name, str(len(ends)), *figures, str(len(ends) - len(values)), middle]


def refinement_rows(records: Sequence[Record]) -> list[tuple[str, list[list[str]]]]:
    """Per example that was solved on several meshes, its rows: the given mesh first, then finer ones.

    Gains are those of the audited energy over the given mesh, the one of fewest nodes.
    """
    return [
        (
            name,
            [
                [
                    "as given" if record["nodes"] == own[0]["nodes"] else "refined",
                    "no motion" if record["formulation"] == RELOCATING_NOTHING else label(record),
                    f"{record['nodes']}",
                    f"{record['energy_audited']:.6g}",
                    f"{own[0]['energy_initial_audited'] - record['energy_audited']:.4g}",
                    f"{record['wall_time_s']:.3g}",
                ]
                for record in own
            ],
        )
        for name, own in _several_meshes(records).items()
    ]


def refinement_notes(records: Sequence[Record]) -> list[str]:
    """One sentence per example: what one refinement gains against the best relocation."""
    notes = []
    for name, own in _several_meshes(records).items():
        start, coarsest = own[0]["energy_initial_audited"], own[0]["nodes"]
        moved = [r for r in own if r["formulation"] != RELOCATING_NOTHING and r["nodes"] == coarsest]
        finer = [r for r in own if r["formulation"] == RELOCATING_NOTHING and r["nodes"] > coarsest]
        if not moved or not finer:
            continue
        best, refined = min(moved, key=lambda record: record["energy_audited"]), finer[0]
        gain = start - best["energy_audited"]
        if gain <= 0:
            notes.append(f"{name}: no formulation gained on the given mesh.")
            continue
        ratio, times = (
            (start - refined["energy_audited"]) / gain,
            refined["wall_time_s"] / best["wall_time_s"],
        )
        notes.append(
            f"{name}: one uniform refinement ({refined['nodes']} nodes) gains {ratio:.2g} times as "
            f"much as {label(best)} on {coarsest} nodes, in {times:.2g} times its time."
        )
    return notes


def _several_meshes(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Successful records of the energy by problem, of those with several meshes; coarser meshes first."""
    solved = [
        record
        for record in records
        if record["success"] and record.get("nodes") and record.get("energy_initial_audited") is not None
        if str(record["objective"]).startswith("energy") and has_energy(record)
    ]
    problems = grouped(solved, lambda record: with_order(str(record["example"]), record))
    several = {name: own for name, own in problems.items() if len({record["nodes"] for record in own}) > 1}
    return {name: sorted(own, key=lambda record: int(record["nodes"])) for name, own in several.items()}
