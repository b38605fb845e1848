"""What stands below the tables: units, how solves ended, impossible energies."""

from __future__ import annotations

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.io.records import Records
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.problem.units import units_of
from rmesh_nlp.report.blocks import blocks, grouped, label
from rmesh_nlp.report.joined import refinement_notes


def main_notes(records: Records) -> list[str]:
    """What is needed to read the main tables: units, what refinement gains, and how solves ended."""
    failures = [
        f"{block.example}, {label(record)}: {record['status']}: {record.get('message', '')}"
        for block in blocks(records)
        for record in block.records
        if not record["success"]
    ]
    return [*(note for said in MAIN_NOTES for note in said(records)), *failures]


def block_notes(records: Records) -> list[str]:
    """Energies that no mesh can have: below the exact one, or below a guaranteed bound."""
    notes = []
    for block, record in ((own, record) for own in blocks(records) for record in own.records):
        above, lower = record.get("energy_above_exact"), None
        if above is not None and record.get("energy_audited") is not None:
            lower = record["energy_audited"] - above
        elif record.get("guaranteed_lower"):
            lower = record.get("energy_lower_bound")
        for name, words in (("energy", "energy"), ("energy_audited", "audited energy")):
            value = record.get(name)
            if lower is not None and value is not None and value < lower - ROUNDING * abs(lower):
                notes.append(
                    f"{block.name}, {label(record)}: the {words} {value:.6f} lies BELOW the "
                    f"infimum {lower:.6f}: its quadrature was exploited."
                )
    return notes


def settings_notes(records: Records) -> list[str]:
    """Size, order, move limits and rule of each block."""
    return [f"{block.title}." for block in blocks(records)]


def stopped_early(records: Records) -> list[str]:
    """What a success is whose status is not "converged"."""
    early = {str(record["status"]) for record in records if record["success"]} - {Status.CONVERGED.value}
    return [f"{', '.join(sorted(early))}: a success that is {NOT_STATIONARY_YET}."] if early else []


def shared_notes(records: Records) -> list[str]:
    """How many times are those of solves that had no core alone."""
    shared = sum(bool(record.get("shared")) for record in records)
    said = (
        f"{shared} of {len(records)} solves shared their core with something: compare their costs in contact "
        "solves, which were measured beside each of them."
    )
    return [said] if shared else []


def units_notes(records: Records) -> list[str]:
    """The units of lengths, forces and energies of the problems that name theirs."""
    named = grouped(blocks(records), lambda block: (units_of(block.records[0]), block.has_energy))
    return [
        f"{', '.join(dict.fromkeys(block.name for block in own))}: lengths in {units.length}, forces in "
        f"{units.force} {'of the whole revolution' if units.per else f'per {units.length} of depth'}"
        f"{f', J in {units.energy}' * energy}."
        for (units, energy), own in named.items()
        if units.length and units.force
    ]


MAIN_NOTES = (refinement_notes, units_notes, block_notes, stopped_early, shared_notes)
