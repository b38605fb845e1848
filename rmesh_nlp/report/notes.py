"""What stands below the tables: the meaning of columns, how solves ended, which printed values are met."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.examples import PAPER, PaperValues
from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.problem.units import Units, units_of
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, Block, blocks, grouped, label
from rmesh_nlp.report.joined import refinement_notes
from rmesh_nlp.study.reproduction import MET, NOT_MET, PASSED, given_statements, reached


def main_notes(records: Sequence[Record]) -> list[str]:
    """What is needed to read the main tables: units, what refinement gains, and how solves ended."""
    below = [note for block in blocks(records) for note in below_infimum(block)]
    failures = [
        f"{block.example}, {label(record)}: {record['status']}: {record.get('message', '')}"
        for block in blocks(records)
        for record in block.records
        if not record["success"]
    ]
    finer = refinement_notes(records)
    return [*finer, *units_notes(records), *below, *stopped_early(records), *shared_notes(records), *failures]


def block_notes(records: Sequence[Record]) -> list[str]:
    """What the records show: impossible energies, printed values that are met, stick zones."""
    kinds = (below_infimum, paper_notes, stick_zone)
    return [note for block in blocks(records) for kind in kinds for note in kind(block)]


def stopped_early(records: Sequence[Record]) -> list[str]:
    """What a success is whose status is not "converged"."""
    early = {str(record["status"]) for record in records if record["success"]} - {Status.CONVERGED.value}
    return [f"{', '.join(sorted(early))}: a success that is {NOT_STATIONARY_YET}."] if early else []


def shared_notes(records: Sequence[Record]) -> list[str]:
    """How many times are those of solves that had no core alone."""
    shared = sum(bool(record.get("shared")) for record in records)
    said = (
        f"{shared} of {len(records)} solves shared their core with something: compare their costs in contact "
        "solves, which were measured beside each of them."
    )
    return [said] if shared else []


def units_notes(records: Sequence[Record]) -> list[str]:
    """The units of u and J of the problems that name theirs."""
    named = grouped(
        blocks(records), lambda block: (units_of(block.records[0].get("units")), block.has_energy)
    )
    return [
        f"{', '.join(dict.fromkeys(block.name for block in own))}: {_units_in_words(units, energy)}"
        for (units, energy), own in named.items()
        if units.length and units.force
    ]


def _units_in_words(units: Units, energy: bool) -> str:
    if energy:
        return f"u in {units.length}, J in {units.force}, the energy per {units.length} of depth."
    return f"lengths in {units.length}, forces in {units.force} per {units.length} of depth."


def stick_zone(block: Block) -> Iterator[str]:
    """A remark where no node with friction sticks: what such an example cannot show."""
    frictional = [record for record in block.records if record.get("sticking_nodes") is not None]
    if frictional and not any(record["sticking_nodes"] for record in frictional):
        yield (
            f"{block.name}: no node sticks in any row, so there is no stick zone. Where all slide one "
            "way, friction acts like a load of size g: no change between stick and slip is met."
        )


def below_infimum(block: Block) -> Iterator[str]:
    """Energies that no mesh can have: below the exact one, or below a guaranteed bound."""
    for record in block.records:
        above, lower = record.get("energy_above_exact"), None
        if above is not None and record.get("energy_audited") is not None:
            lower = record["energy_audited"] - above
        elif record.get("guaranteed_lower"):
            lower = record.get("energy_lower_bound")
        for name, words in (("energy", "energy"), ("energy_audited", "audited energy")):
            value = record.get(name)
            if lower is not None and value is not None and value < lower - ROUNDING * abs(lower):
                yield (
                    f"{block.name}, {label(record)}: the {words} {value:.6f} lies BELOW the "
                    f"infimum {lower:.6f}: its quadrature was exploited."
                )


def paper_notes(block: Block) -> Iterator[str]:
    """What of the paper's printed values these records meet."""
    paper = block.paper
    if paper is not None:
        notes = [
            *([paper.misprint] if paper.misprint else []),
            *_initial(block),
            *_final(block, paper),
        ]
        yield from (f"{block.name}: {note}" for note in notes)
    elif block.example in PAPER:
        yield f"{block.title}: not the paper's settings, so not compared with its values."


def _initial(block: Block) -> Iterator[str]:
    given = next((r["energy_initial"] for r in block.records if r["energy_initial"] is not None), None)
    fixed = next((r for r in block.succeeded if r["formulation"] == RELOCATING_NOTHING), {})
    for one in given_statements(block.example, (given, fixed.get("u_min"), fixed.get("u_max"))):
        outcome = "met" if one.outcome == MET else "NOT met"
        yield f"printed {one.what} {one.printed}: {outcome}, here {one.ours}."


def _final(block: Block, paper: PaperValues) -> Iterator[str]:
    moved = [
        record
        for record in block.succeeded
        if record["formulation"] != RELOCATING_NOTHING and objective_of(record) == "energy"
    ]
    if not moved:
        yield "no formulation relocated the grid here, so the printed final energy is not compared."
        return
    best = min(moved, key=lambda record: float(record["energy"]))
    ours = f"the lowest here is {best['energy']:.6f} ({label(best)})"
    printed = f"printed final energy {paper.energy_final:.4f}"
    outcome = reached(best["energy"], paper.energy_final)
    if outcome == NOT_MET:
        yield f"{printed} is NOT reached: {ours}. {paper.remark}".rstrip()
        return
    yield f"{printed} is {outcome}: {ours}."
    if outcome == PASSED and paper.u_min_final is not None and paper.u_max_final is not None:
        yield (
            f"printed extremes {paper.u_min_final:.4f}, {paper.u_max_final:.4f} on the relocated grid "
            f"belong to that higher energy and so to another grid; here {best['u_min']:.4f}, "
            f"{best['u_max']:.4f} ({label(best)})."
        )
