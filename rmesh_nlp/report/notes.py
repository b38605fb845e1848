"""What stands below the tables: the meaning of columns, how solves ended, which printed values are met."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.examples import PAPER, PaperValues
from rmesh_nlp.examples.paper import PRINTED_DIGITS, truncated
from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.problem.units import Units, units_of
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    Block,
    audited,
    blocks,
    grouped,
    label,
)

TIED = 1e-8  # energies that differ by less than this part are one: two solvers' ends of the same minimum

ENERGY = (
    "J is the total potential energy of the contact solution on the given and on the relocated mesh, as "
    "assessed: loads by an adaptive rule, gaps along whole edges, friction and curves integrated."
)
LEGEND = (f"{ENERGY} Gain: in per cent of |J| on the given mesh. Time: build, solve and audit.",)
DESIGN_LEGEND = (
    "Objective: with mesh and design at the start and at the end of the solve. Gain: in per cent of its size "
    "at the start. Left on refined meshes: the part of the gain that is there when both meshes are "
    "refined uniformly. Violation: the largest of a constraint, over its bound. Label: stationarity over the "
    "branches of the contact; S (KKT) is S-stationarity without a biactive pair, that is, a KKT point. "
    "Biactive: pairs whose members both vanish. KKT factorisations: at least as many as Ipopt took "
    "iterations. First-order residual: of the outer problem, over that at the start. Time: build, solve and "
    "audit."
)
DETAILED_LEGEND = (
    "Own rule: the energy with the quadrature of the problem. Least area ratio: the smallest element area "
    "over its value on the given mesh.",
    "Cost: time of build and solve over that of one contact solve on the given mesh, measured in the same "
    "run. Reached by all: what all successful formulations reach, and the cost until each was there first. "
    "Factorisations of KKT matrices: at least as many as Ipopt took iterations.",
    "Residuals are dimensionless. Own: of the displacement and contact forces that the formulation ended "
    "with. Assessed: of an independent contact solve on its mesh. First-order residual: of the outer "
    "problem, over that on the given mesh. Biactive: pairs of gap and contact force that both vanish. "
    "Label: the stationarity that was computed; S (KKT) is S-stationarity without a biactive pair, that is, "
    "a KKT point.",
)


def main_notes(records: Sequence[Record]) -> list[str]:
    """What is needed to read the main table: meaning of its columns, units, and how solves ended."""
    below = [note for block in blocks(records) for note in below_infimum(block)]
    failures = [
        f"{block.example}, {label(record)}: {record['status']}: {record.get('message', '')}"
        for block in blocks(records)
        for record in block.records
        if not record["success"]
    ]
    return [*legends(records), *units_notes(records), *below, *stopped_early(records), *failures]


def legends(records: Sequence[Record]) -> list[str]:
    """What the columns of the main tables mean: of energies, and of what has none that compare."""
    every = blocks(records)
    own = [] if all(block.has_energy for block in every) else [DESIGN_LEGEND]
    return own if own and not any(block.has_energy for block in every) else [*own, *LEGEND]


def detailed_notes(records: Sequence[Record]) -> list[str]:
    """What is needed to read the other tables, and what they show."""
    return [*DETAILED_LEGEND, *block_notes(records)]


def block_notes(records: Sequence[Record]) -> list[str]:
    """What the records show: impossible energies, printed values that are met, stick zones, a ranking."""
    kinds = (below_infimum, paper_notes, stick_zone, ranking)
    return [note for block in blocks(records) for kind in kinds for note in kind(block)]


def stopped_early(records: Sequence[Record]) -> list[str]:
    """What a success is whose status is not "converged"."""
    early = {str(record["status"]) for record in records if record["success"]} - {Status.CONVERGED.value}
    return [f"{', '.join(sorted(early))}: a success that is {NOT_STATIONARY_YET}."] if early else []


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


def ranking(block: Block) -> Iterator[str]:
    """The successful formulations by audited energy, of those that minimised it."""
    rows = [record for record in block.succeeded if objective_of(record) == "energy"]
    places: list[tuple[float, list[str]]] = []
    for record in sorted(rows, key=audited):
        if not places or not _tied(audited(record), places[-1][0]):
            places.append((audited(record), []))
        places[-1][1].append(label(record))
    order = "; ".join(f"{' = '.join(names)} {energy:.6f}" for energy, names in places)
    if len(rows) > 1 and block.has_energy:
        yield f"{block.name}: by audited energy {order}."


def _tied(energy: float, lower: float) -> bool:
    return energy - lower <= TIED * max(abs(energy), abs(lower))


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
            *_initial(block, paper),
            *_final(block, paper),
        ]
        yield from (f"{block.name}: {note}" for note in notes)
    elif block.example in PAPER:
        yield f"{block.title}: not the paper's settings, so not compared with its values."


def _initial(block: Block, paper: PaperValues) -> Iterator[str]:
    given = next((r["energy_initial"] for r in block.records if r["energy_initial"] is not None), None)
    if given is not None:
        met = truncated(given) == truncated(paper.energy_initial)
        yield _met(f"initial energy {paper.energy_initial:.4f}", met, f"{given:.6f}")
    fixed = next((r for r in block.succeeded if r["formulation"] == RELOCATING_NOTHING), None)
    if fixed is not None and paper.u_min_initial is not None and paper.u_max_initial is not None:
        pairs = ((fixed["u_min"], paper.u_min_initial), (fixed["u_max"], paper.u_max_initial))
        # one unit in the last place: the paper truncates some of its figures and rounds others
        met = all(abs(ours - printed) < 10.0**-PRINTED_DIGITS for ours, printed in pairs)
        printed = f"extremes {paper.u_min_initial:.4f}, {paper.u_max_initial:.4f} on the given grid"
        yield _met(printed, met, f"{fixed['u_min']:.5f}, {fixed['u_max']:.5f}")


def _met(printed: str, met: bool, ours: str) -> str:
    return f"printed {printed}: {'met' if met else 'NOT met'}, here {ours}."


def _final(block: Block, paper: PaperValues) -> Iterator[str]:
    moved = [
        record
        for record in block.succeeded
        if record["formulation"] != RELOCATING_NOTHING and objective_of(record) == "energy"
    ]
    if not moved:
        yield "no formulation relocated the grid here, so the printed final energy is not compared."
        return
    lowest = min(record["energy"] for record in moved)
    best = next(record for record in moved if _tied(record["energy"], lowest))
    ours = f"the lowest here is {best['energy']:.6f} ({label(best)})"
    printed = f"printed final energy {paper.energy_final:.4f}"
    reached, wanted = truncated(best["energy"]), truncated(paper.energy_final)
    if reached > wanted:
        yield f"{printed} is NOT reached: {ours}. {paper.remark}".rstrip()
        return
    yield f"{printed} is {'met' if reached == wanted else 'passed'}: {ours}."
    if reached < wanted and paper.u_min_final is not None and paper.u_max_final is not None:
        yield (
            f"printed extremes {paper.u_min_final:.4f}, {paper.u_max_final:.4f} on the relocated grid "
            f"belong to that higher energy and so to another grid; here {best['u_min']:.4f}, "
            f"{best['u_max']:.4f} ({label(best)})."
        )
