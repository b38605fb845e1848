"""Columns of the tables: what stands in a cell, and with how many digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, contact_units, gain_of, label
from rmesh_nlp.report.table import MISSING, Groups, Table, latex_heading
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import Digits


def cost(value: float) -> str:
    """Three digits, and all of them before the point."""
    return ".3g" if value < 100 else ".0f"


def shown(value: float | None, digits: Digits) -> str:
    """A number in a format, or one that it chooses; or what stands for a number that is not known."""
    if value is None:
        return MISSING
    form = digits if isinstance(digits, str) else digits(value)
    return "0" if value == 0 and form.endswith("e") else format(value, form)


@dataclass(frozen=True)
class Column:
    """One column: its heading, and the entry of a record that it shows or what it makes of the record.

    Lines of the heading are separated by a bar; ``tex`` is a shorter one for LaTeX.
    """

    heading: str
    of: str | Callable[[Record], str | float | None]
    digits: Digits = "d"
    tex: str = ""

    def cell(self, record: Record) -> str:
        """The cell of a record."""
        value = record.get(self.of) if isinstance(self.of, str) else self.of(record)
        return value or MISSING if isinstance(value, str) else shown(value, self.digits)


def of(*names: str) -> tuple[Column, ...]:
    """The columns of entries, as they are declared."""
    entries = (ENTRIES[name] for name in names)
    return tuple(Column(entry.heading, entry.name, entry.digits, entry.tex) for entry in entries)


def _seconds(part: str) -> Callable[[Record], str]:
    """Seconds, with their range where the solve was repeated."""

    def cell(record: Record) -> str:
        ends = record.get(f"{part}_time_range_s")
        text = shown(record.get(f"{part}_time_s"), ".3g")
        return f"{text} ({ends[0]:.2g} to {ends[1]:.2g})" if ends and text != MISSING else text

    return cell


def _solves(record: Record) -> str:
    """Contact solves, cold and warm ones apart where that is known."""
    total, cold = record.get("contact_solves"), record.get("cold_contact_solves")
    return shown(total, "d") if total is None or cold is None else f"{cold} + {total - cold}"


def _factorisations(record: Record) -> str:
    """Those of the contact solver, and at least how many of KKT matrices there were."""
    contact, kkt = record.get("contact_factorisations"), record.get("kkt_factorisations")
    return shown(contact, "d") if contact is None or not kkt else f"{contact}; {kkt} or more"


def _stationarity(record: Record) -> str:
    """The label of stationarity, and whether it says more than that of an ordinary program."""
    kind = str(record.get("stationarity") or "")
    return "S (KKT)" if kind == "S" and record.get("biactive") == 0 else kind


def _biactive(record: Record) -> int | None:
    nodes = record.get("biactive_nodes")
    return None if nodes is None else len(nodes)


def _sum_of_errors(record: Record) -> float | None:
    terms = [record[name] for name in ("I1", "I2", "I3") if record.get(name) is not None]
    return sum(terms) if len(terms) == 3 else None


def _bound(name: str, side: str) -> Callable[[Record], str]:
    """A bound of the error in per cent, called "about" if it is not guaranteed."""

    def cell(record: Record) -> str:
        value = record.get(name)
        guaranteed = record.get("guaranteed_lower") and record.get(f"guaranteed_{side}")
        return "" if value is None else f"{'at most' if guaranteed else 'about'} {100 * value:.3g}"

    return cell


FORMULATION = Column("formulation", label)
COST = Column("cost|[contact solves]", contact_units, cost)
BIACTIVE, LABEL = Column("biactive", _biactive), Column("label", _stationarity)
GAIN = Column(
    "gain|[%]",
    lambda record: gain_of(record.get("energy_initial_audited"), record.get("energy_audited")),
    lambda gain: ".2f" if abs(gain) < 1000 else ".3g",
)

# what a first reader wants to know: audited energies, work and how each solve ended
MAIN = (
    FORMULATION,
    *of("energy_initial_audited", "energy_audited"),
    GAIN,
    *of("iterations", "contact_solves", "wall_time_s", "status"),
)
# by the rule of the problem
ENERGIES = (
    FORMULATION,
    *of("energy_initial", "energy", "u_min", "u_max", "resultant", "peak_pressure", "min_area_ratio"),
)
# work by one clock, the audit apart
COSTS = (
    FORMULATION,
    *of("start"),
    Column("contact solves,|cold + warm", _solves),
    Column("factorisations,|contact; KKT", _factorisations),
    Column("build|[s]", _seconds("build")),
    Column("solve|[s]", _seconds("solve")),
    Column("audit|[s]", _seconds("audit")),
    COST,
)
# of the formulation's own state and of the assessment's contact solve
RESIDUALS = (
    FORMULATION,
    *of("own_equilibrium_residual", "equilibrium_residual"),
    *of("own_complementarity_residual", "complementarity_residual", "stationarity_residual"),
    BIACTIVE,
    LABEL,
)
# in contact solves until the level that all formulations reach, and to the end of each
COMMON = (
    FORMULATION,
    Column("J reached|by all", "common_objective", ".7g"),
    Column("cost to|that J", "cost_to_objective", cost),
    Column("residual|reached by all", "common_stationarity", ".1e"),
    Column("cost to|that residual", "cost_to_stationarity", cost),
    Column("cost to|the end", contact_units, cost),
)
# Theorem 4.1: the three errors, and the difference of the energies that their sum is
ERRORS = (FORMULATION, *of("I1", "I2", "I3"), Column("sum", _sum_of_errors, ".6f"), *of("energy_above_exact"))
# other than the energy
OBJECTIVES = (FORMULATION, *of("objective_initial", "objective_value"), BIACTIVE, LABEL, *of("status"))
# bounds of the least energy, and of the error in the energy norm
CERTIFICATES = (
    FORMULATION,
    *of("energy_lower_bound", "energy_upper_bound"),
    Column("error before|[%]", _bound("relative_error_bound_initial", "initial")),
    Column("error after|[%]", _bound("relative_error_bound", "upper")),
)


def table_of(
    columns: Sequence[Column], groups: Groups, caption: str = "", notes: Sequence[str] = (), **options: Any
) -> Table:
    """A table of rows that :func:`body` made."""
    tex = [latex_heading(column.tex or column.heading) for column in columns]
    return Table([column.heading for column in columns], groups, caption, notes, tex, **options)


def body(columns: Sequence[Column], block: Block) -> list[list[str]]:
    """The rows of a block, those of the paper first where its settings were used."""
    common = {} if block.unit is None else {"contact_time_s": block.unit}
    records = [{**record, **common} if record.get("contact_time_s") else record for record in block.records]
    rows = [[column.cell(record) for column in columns] for record in records]
    paper = block.paper
    if columns is ENERGIES and paper is not None:
        given, final = f"{paper.energy_initial:.4f}", f"{paper.energy_final:.4f}"
        ends = (paper.u_min_initial, paper.u_max_initial), (paper.u_min_final, paper.u_max_final)
        first, last = ([shown(value, ".4f") for value in pair] for pair in ends)
        rest = [MISSING] * (len(columns) - 5)
        given_grid = ["paper, given grid", given, MISSING, *first, *rest]
        return [given_grid, ["paper, relocated", given, final, *last, *rest], *rows]
    return rows
