"""Relocation against uniform refinement: what a user must know before moving nodes."""

from __future__ import annotations

from collections.abc import Sequence

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, label

HEAD = ("mesh", "formulation", "nodes", "J audited", "gain", "time [s]")
TITLE = "Relocation against uniform refinement"
CAPTION = (
    "Relocation against uniform refinement: audited energies $J$ and gains over the given mesh, with the "
    "wall time of each solve."
)


def refinement_rows(records: Sequence[Record]) -> list[tuple[str, list[list[str]]]]:
    """Per example that was solved on several meshes, its rows: the given mesh first, then finer ones.

    Gains are those of the audited energy over the given mesh, the one of fewest nodes.
    """
    groups = []
    for name, own in _several_meshes(records).items():
        coarsest = _nodes(own[0])
        start = own[0]["energy_initial_audited"]
        rows = []
        for record in own:
            mesh = "as given" if _nodes(record) == coarsest else "refined"
            energy, seconds = record["energy_audited"], record["wall_time_s"]
            rows.append(
                [
                    mesh,
                    "no motion" if record["formulation"] == RELOCATING_NOTHING else label(record),
                    f"{_nodes(record)}",
                    f"{energy:.6g}",
                    f"{start - energy:.4g}",
                    f"{seconds:.3g}",
                ]
            )
        groups.append((name, rows))
    return groups


def refinement_notes(records: Sequence[Record]) -> list[str]:
    """One sentence per example: what one refinement gains against the best relocation."""
    notes = []
    for name, own in _several_meshes(records).items():
        start, coarsest = own[0]["energy_initial_audited"], _nodes(own[0])
        moved = [r for r in own if r["formulation"] != RELOCATING_NOTHING and _nodes(r) == coarsest]
        finer = [r for r in own if r["formulation"] == RELOCATING_NOTHING and _nodes(r) > coarsest]
        if not moved or not finer:
            continue
        best = min(moved, key=lambda record: record["energy_audited"])
        gain, other = start - best["energy_audited"], start - finer[0]["energy_audited"]
        if gain <= 0:
            notes.append(f"{name}: no formulation gained on the given mesh.")
            continue
        times = finer[0]["wall_time_s"] / best["wall_time_s"]
        notes.append(
            f"{name}: one uniform refinement ({_nodes(finer[0])} nodes) gains {other / gain:.2g} times as "
            f"much as {label(best)} on {coarsest} nodes, in {times:.2g} times its time."
        )
    return notes


def _several_meshes(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Successful records of the energy by problem, of those with several meshes; coarser meshes first."""
    found: dict[str, list[Record]] = {}
    for record in records:
        known = record.get("nodes") and record.get("energy_initial_audited") is not None
        if record["success"] and known and str(record["objective"]).startswith("energy"):
            found.setdefault(str(record["example"]), []).append(record)
    several = {}
    for name, own in found.items():
        if len({_nodes(record) for record in own}) > 1:
            several[name] = sorted(own, key=_nodes)
    return several


def _nodes(record: Record) -> int:
    return int(record["nodes"])
