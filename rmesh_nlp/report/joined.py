"""Tables whose rows join several records.

Ends of several starts, relocation against refinement, and by name what each solve found: design variables and
constrained quantities beside their bounds.
"""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from rmesh_nlp.display import bounds_in_words
from rmesh_nlp.evaluation import difference
from rmesh_nlp.io.records import Record, Records, ends_of, has_energy
from rmesh_nlp.report.blocks import (
    blocks,
    contact_units,
    grouped,
    label,
    names_of_blocks,
    relocates,
    seedless,
    with_order,
)
from rmesh_nlp.report.columns import Column, cells, short_label, table_of
from rmesh_nlp.report.table import Table
from rmesh_nlp.solving.parts import FEW

STARTS = (
    Column("formulation", "formulation"),
    Column("starts", "starts"),
    *(Column(end, end, ".7g") for end in ("best", "median", "worst")),
    Column("failures", "failures"),
    Column("cost|[contact solves]", "cost", ".3g"),
)
ESTIMATES = (
    Column("formulation", label),
    *(Column(name, name, ".6g") for name in ("example", "nodes", "quantity", "computed", "value")),
    Column("error", "error", ".2g"),
    Column(
        "guaranteed", lambda row: bounds_in_words(row["lower"], row["upper"]) if row.get("guaranteed") else ""
    ),
)
NAMED = {"design": "Design variables", "constraints": "Constrained quantities"}


def joined_tables(records: Records) -> list[Table]:
    """Those of several starts and of estimated errors, perhaps without rows."""
    return [
        table_of(
            STARTS,
            multistart_rows(records),
            title="Several starts",
            caption="Ends of solves from several starts: audited energies, or values of another objective. "
            "The cost is the median of one start.",
        ),
        table_of(
            ESTIMATES,
            estimate_rows(records),
            title="Estimated errors",
            caption="Quantities on the final mesh: computed values, the best known ones, and the estimated "
            "errors of the former; bounds, where those are guaranteed.",
        ),
    ]


def estimate_rows(records: Records) -> list[Record]:
    """Where an accuracy was asked for, a row for each quantity of each solve."""
    is_asked = any("meshes" in record for record in records)
    return [
        {**record, **of, "quantity": text}
        for record in records
        for text, of in record.get("estimates", {}).items()
        if is_asked
    ]


def multistart_rows(records: Records) -> list[Record]:
    """A row for each formulation and objective of a block that was solved from two starts or more."""
    starts, groups = list[Record](), blocks(records)
    for block, name in zip(groups, names_of_blocks(groups), strict=True):
        solves = grouped((r for r in block.records if r["status"] != "refused"), seedless)
        starts += [row for of, group in solves.items() if (row := _starts(f"{name}, {of}", group))]
    return starts


def _starts(name: str, group: Records) -> Record | None:
    """Best, median and worst end of several solves, or of one whose solve had starts of its own."""
    first, costs = group[0], []
    if len(group) == 1 and first.get("start_energies"):
        ends = first.get("start_values") or first["start_energies"]
    elif len({record["seed"] for record in group}) > 1:
        ends = [ends_of(record)[1] if record["success"] else None for record in group]
        costs = [contact_units(record) for record in group if record["success"]]
    else:
        return None
    values = pd.Series(ends, dtype=float)
    return {
        **{"formulation": name, "starts": values.size, "failures": int(values.isna().sum())},
        **{"best": values.min(), "median": values.median(), "worst": values.max()},
        "cost": pd.Series(costs, dtype=float).median(),
    }


def with_refinement_gains(records: Records) -> list[Record]:
    """The records, with gains over the coarsest mesh where an example was solved on several."""
    gains = {
        id(record): difference(own[0]["energy_initial_audited"], record["energy_audited"])
        for own in _several_meshes(records).values()
        for record in own
    }
    return [{**record, "refinement_gain": gains.get(id(record))} for record in records]


def refinement_notes(records: Records) -> list[str]:
    """One sentence per example: what one refinement gains against the best relocation."""
    notes = []
    for name, own in _several_meshes(records).items():
        start, coarsest = own[0]["energy_initial_audited"], own[0]["nodes"]
        moved = [r for r in own if relocates(r) and r["nodes"] == coarsest]
        finer = [r for r in own if not relocates(r) and r["nodes"] > coarsest]
        if not moved or not finer:
            continue
        best, refined = min(moved, key=lambda record: record["energy_audited"]), finer[0]
        gain = difference(start, best["energy_audited"])
        if gain <= 0:
            notes.append(f"{name}: no formulation gained on the given mesh.")
            continue
        ratio = difference(start, refined["energy_audited"]) / gain
        notes.append(
            f"{name}: one uniform refinement ({refined['nodes']} nodes) gains {ratio:.2g} times as much as "
            f"{label(best)} on {coarsest} nodes, in {refined['wall_time_s'] / best['wall_time_s']:.2g} times "
            "its time."
        )
    return notes


def _several_meshes(records: Records) -> dict[str, list[Record]]:
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


def named_tables(title: str, records: Records, entry: str) -> Iterator[Table]:
    """Design variables or constrained quantities: bounds, the first design, and where each solve ended."""
    solved = [record for record in records if record.get(entry)]
    if not solved:
        return
    if entry == "design":
        values, bounds = [record["design"] for record in solved], solved[0].get("design_bounds") or {}
    else:
        constraints = [record["constraints"].items() for record in solved]
        values = [{name: one.get("value") for name, one in own} for own in constraints]
        bounds = {
            name: (one.get("lower"), one.get("upper")) for own in constraints[::-1] for name, one in own
        }
    start = solved[0].get(f"{entry}_initial")
    rows = [{"": "bounds", **{name: bounds_in_words(*pair) for name, pair in bounds.items()}}]
    rows += [{"": "start", **start}] if start else []
    solves = [
        {"": short_label(record), **own}
        for record, own in zip(solved, values, strict=True)
        if relocates(record) or entry == "constraints"
    ]
    names = list(dict.fromkeys(name for own in values for name in own))
    columns = [Column("", ""), *(Column(name, name, ".5g") for name in names)]
    said = f"{NAMED[entry]}, {title}: bounds, where there is one the start, and the end of each solve."
    for first in range(0, max(len(solves), 1), FEW):
        some = cells(columns, rows + solves[first : first + FEW])
        head, *body = zip(["name", *names], *some, strict=True)
        yield Table(head, body, said, NAMED[entry], is_detail=len(names) > FEW)
