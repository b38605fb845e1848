"""What stands below a table: which printed values of the paper are met, and what failed."""

from __future__ import annotations

from collections.abc import Sequence

from rmesh_nlp.examples import PAPER, PaperValues
from rmesh_nlp.examples.paper import PRINTED_DIGITS, truncated
from rmesh_nlp.io.results import Record
from rmesh_nlp.problem.units import units_of
from rmesh_nlp.report.blocks import Block, audited, blocks, label

ROUNDING = 1e-9
"""An energy is below a bound if by more than this part of it."""

TIED = 1e-8
"""Energies that differ by less than this part of them are one: two solvers' ends of the same minimum."""

LEGEND = (
    "J is the energy with the example's own quadrature. Audited is that of the contact problem solved "
    "again with a rule of degree 20, on the given mesh and on the final one: strategies are compared by "
    "the latter.",
    "Least area: smallest element area over its initial value. Build + solve [solves]: their time over that "
    "of one contact solve on the initial mesh, measured in the same run; the audit is no cost.",
    "Residuals are dimensionless. Own: those of the displacement and contact forces that the strategy "
    "itself ended with. Referee: those of an independent contact solve on its final mesh; they say how well "
    "that mesh can be solved on, not how well the strategy did. Stationarity: the first-order residual of "
    "the outer problem, computed by the referee for every strategy, relative to that on the given mesh. "
    "Biactive: pairs of gap and contact force that both vanish. Label: the kind of stationarity that was "
    "computed; S (KKT) is S-stationarity without a biactive pair, which says no more than that the point is "
    "a KKT point.",
    "Factorisations: those of the contact solver, and of KKT matrices at least as many as Ipopt took "
    "iterations; it does not say how often it repeated one. Common level and stationarity: what all "
    "successful strategies reach, and the cost until each was there first.",
)


def notes(records: Sequence[Record]) -> list[str]:
    """All notes to the tables of these records."""
    found = list(LEGEND)
    for block in blocks(records):
        found += units_note(block)
        found += paper_notes(block)
        found += stick_zone(block)
        found += ranking(block)
        found += below_infimum(block)
        found += [
            f"{block.example}, {label(record)}: {record['status']}: {record.get('message', '')}"
            for record in block.records
            if not record["success"]
        ]
    return found


def units_note(block: Block) -> list[str]:
    """The units of u and J where the problem names its own."""
    units = units_of(block.records[0].get("units"))
    if not (units.length and units.force):
        return []
    return [f"{block.name}: u in {units.length}, J in {units.force}, the energy per {units.length} of depth."]


def stick_zone(block: Block) -> list[str]:
    """Says so where no node with friction sticks: what such an example cannot show."""
    known = [record for record in block.records if record.get("sticking_nodes") is not None]
    if not known or any(record["sticking_nodes"] for record in known):
        return []
    return [
        f"{block.name}: no node sticks in any row, so there is no stick zone. Where all slide one "
        "way, friction acts like a load of size g: no change between stick and slip is met."
    ]


def ranking(block: Block) -> list[str]:
    """The successful strategies by audited energy, of those that minimised it."""
    rows = [record for record in block.succeeded if record["objective"] == "energy"]
    if len(rows) < 2:
        return []
    places: list[tuple[float, list[str]]] = []
    for record in sorted(rows, key=audited):
        if not places or not _tied(audited(record), places[-1][0]):
            places.append((audited(record), []))
        places[-1][1].append(label(record))
    order = "; ".join(f"{' = '.join(names)} {energy:.6f}" for energy, names in places)
    return [f"{block.name}: by audited energy {order}."]


def _tied(energy: float, lower: float) -> bool:
    return energy - lower <= TIED * max(abs(energy), abs(lower))


def below_infimum(block: Block) -> list[str]:
    """Energies that no mesh can have: below the exact one, or below a guaranteed bound."""
    found = []
    for record in block.records:
        above, lower = record.get("energy_above_exact"), None
        if above is not None and record.get("energy_audited") is not None:
            lower = record["energy_audited"] - above
        elif record.get("guaranteed_lower"):
            lower = record.get("energy_lower_bound")
        if lower is None:
            continue
        for name, words in (("energy", "energy"), ("energy_audited", "audited energy")):
            value = record.get(name)
            if value is not None and value < lower - ROUNDING * abs(lower):
                found.append(
                    f"{block.name}, {label(record)}: the {words} {value:.6f} lies BELOW the "
                    f"infimum {lower:.6f}: its quadrature was exploited."
                )
    return found


def paper_notes(block: Block) -> list[str]:
    """What of the paper's printed values these records meet."""
    paper = block.paper
    if block.example not in PAPER:
        return []
    if paper is None:
        return [f"{block.title}: not the paper's settings, so not compared with its values."]
    notes = [*_initial(block, paper), *_final(block, paper)]
    if paper.misprint:
        notes.insert(0, paper.misprint)
    return [f"{block.name}: {note}" for note in notes]


def _initial(block: Block, paper: PaperValues) -> list[str]:
    notes = []
    given = next((r["energy_initial"] for r in block.records if r["energy_initial"] is not None), None)
    if given is not None:
        met = truncated(given) == truncated(paper.energy_initial)
        notes.append(_met(f"printed initial energy {paper.energy_initial:.4f}", met, f"{given:.6f}"))
    fixed = next((r for r in block.succeeded if r["formulation"] == "fixed"), None)
    if fixed is not None and paper.u_min_initial is not None and paper.u_max_initial is not None:
        pairs = ((fixed["u_min"], paper.u_min_initial), (fixed["u_max"], paper.u_max_initial))
        # one unit in the last place: the paper truncates some of its figures and rounds others
        met = all(abs(ours - printed) < 10.0**-PRINTED_DIGITS for ours, printed in pairs)
        printed = f"printed extremes {paper.u_min_initial:.4f}, {paper.u_max_initial:.4f} on the given grid"
        notes.append(_met(printed, met, f"{fixed['u_min']:.5f}, {fixed['u_max']:.5f}"))
    return notes


def _final(block: Block, paper: PaperValues) -> list[str]:
    moved = [r for r in block.succeeded if r["formulation"] != "fixed" and r["objective"] == "energy"]
    if not moved:
        return ["no strategy relocated the grid here, so the printed final energy is not compared."]
    lowest = min(record["energy"] for record in moved)
    best = next(record for record in moved if _tied(record["energy"], lowest))
    ours = f"the lowest here is {best['energy']:.6f} ({label(best)})"
    printed = f"printed final energy {paper.energy_final:.4f}"
    if truncated(best["energy"]) > truncated(paper.energy_final):
        return [f"{printed} is NOT reached: {ours}. {paper.remark}".rstrip()]
    if truncated(best["energy"]) == truncated(paper.energy_final):
        return [f"{printed} is met: {ours}."]
    notes = [f"{printed} is passed: {ours}."]
    if paper.u_min_final is not None and paper.u_max_final is not None:
        notes.append(
            f"printed extremes {paper.u_min_final:.4f}, {paper.u_max_final:.4f} on the relocated grid "
            f"belong to that higher energy and so to another grid; here {best['u_min']:.4f}, "
            f"{best['u_max']:.4f} ({label(best)})."
        )
    return notes


def _met(printed: str, met: bool, ours: str) -> str:
    return f"{printed}: {'met' if met else 'NOT met'}, here {ours}."
