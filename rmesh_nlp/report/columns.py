"""Columns of the tables: what stands in a cell, and with how many digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, contact_units, gain_in_per_cent, label
from rmesh_nlp.report.markup import MISSING, latex_heading

Form = str | Callable[[float], str]


def energy(value: float) -> str:
    """Six decimals, or seven digits where an energy is very large or very small."""
    return ".6f" if value == 0 or 1e-3 <= abs(value) < 1e3 else ".7g"


def cost(value: float) -> str:
    """Three digits, and all of them before the point."""
    return ".3g" if value < 100 else ".0f"


def shown(value: float | None, form: Form) -> str:
    """A number in a format, or one that it chooses; or what stands for a number that is not known."""
    if value is None:
        return MISSING
    form = form if isinstance(form, str) else form(value)
    return "0" if value == 0 and form.endswith("e") else format(value, form)


@dataclass(frozen=True)
class Column:
    """One column: lines of its heading separated by a bar, the entry of a record or what is made of it.

    Numbers are shown in a ``form``; ``short`` is the heading in LaTeX where it is another.
    """

    heading: str
    of: str | Callable[[Record], str | float | None]
    form: Form = "d"
    short: str = ""

    def cell(self, record: Record) -> str:
        """The cell of a record."""
        value = record.get(self.of) if isinstance(self.of, str) else self.of(record)
        return value or MISSING if isinstance(value, str) else shown(value, self.form)

    @property
    def head(self) -> str:
        """The heading in plain text."""
        return self.heading.replace("|", " ")

    @property
    def tex(self) -> str:
        """The heading in LaTeX."""
        return latex_heading(self.short or self.heading)


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
    known = str(record.get("stationarity") or "")
    return "S (KKT)" if known == "S" and record.get("biactive") == 0 else known


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


FORMULATION, STATUS = Column("formulation", label), Column("status", "status")
TIME = Column("time|[s]", "wall_time_s", lambda seconds: ".2g" if seconds < 10 else ".0f")
BIACTIVE, LABEL = Column("biactive", _biactive), Column("label", _stationarity)

# what a first reader wants to know: audited energies, work and how each solve ended
MAIN = (
    FORMULATION,
    Column("J|given", "energy_initial_audited", energy),
    Column("J|relocated", "energy_audited", energy),
    Column("gain|[%]", gain_in_per_cent, lambda gain: ".2f" if abs(gain) < 1000 else ".3g"),
    Column("iterations", "iterations"),
    Column("contact|solves", "contact_solves"),
    TIME,
    STATUS,
)
# by the rule of the problem
ENERGIES = (
    FORMULATION,
    Column("J given,|own rule", "energy_initial", energy),
    Column("J relocated,|own rule", "energy", energy),
    Column("u min", "u_min", ".4g", r"$u_{\min}$"),
    Column("u max", "u_max", ".4g", r"$u_{\max}$"),
    Column("least|area ratio", "min_area_ratio", ".3f"),
)
# work by one clock, the audit apart
COSTS = (
    FORMULATION,
    Column("start", "start"),
    Column("contact solves,|cold + warm", _solves),
    Column("factorisations,|contact; KKT", _factorisations),
    Column("build|[s]", _seconds("build")),
    Column("solve|[s]", _seconds("solve")),
    Column("audit|[s]", _seconds("audit")),
    Column("cost|[contact solves]", contact_units, cost),
)
# of the formulation's own state and of the assessment's contact solve
RESIDUALS = (
    FORMULATION,
    Column("equilibrium,|own", "own_equilibrium_residual", ".1e", "equil.,|own"),
    Column("equilibrium,|assessed", "assessed_equilibrium_residual", ".1e", "equil.,|assessed"),
    Column("complementarity,|own", "own_complementarity_residual", ".1e", "compl.,|own"),
    Column("complementarity,|assessed", "assessed_complementarity_residual", ".1e", "compl.,|assessed"),
    Column("first-order residual", "stationarity_residual", ".1e", "first-|order"),
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
ERRORS = (
    FORMULATION,
    Column("I1", "I1", ".6f", "$I_1$"),
    Column("I2", "I2", ".2e", "$I_2$"),
    Column("I3", "I3", ".2e", "$I_3$"),
    Column("sum", _sum_of_errors, ".6f"),
    Column("J audited - J exact", "energy_above_exact", ".6f", "$J-J(u)$,|audited"),
)
# other than the energy
OBJECTIVES = (
    FORMULATION,
    Column("initial", "objective_initial", ".6e"),
    Column("final", "objective_value", ".6e"),
    BIACTIVE,
    LABEL,
    STATUS,
)
# bounds of the least energy, and of the error in the energy norm
CERTIFICATES = (
    FORMULATION,
    Column("lower|bound", "energy_lower_bound", energy),
    Column("upper|bound", "energy_upper_bound", energy),
    Column("error before|[%]", _bound("relative_error_bound_initial", "initial")),
    Column("error after|[%]", _bound("relative_error_bound", "upper")),
)


def body(columns: tuple[Column, ...], block: Block) -> list[list[str]]:
    """The rows of a block, those of the paper first where its settings were used."""
    common = {} if block.unit is None else {"contact_time_s": block.unit}
    records = [{**record, **common} if record.get("contact_time_s") else record for record in block.records]
    rows = [[column.cell(record) for column in columns] for record in records]
    paper = block.paper
    if columns is ENERGIES and paper is not None:
        given, final = f"{paper.energy_initial:.4f}", f"{paper.energy_final:.4f}"
        ends = (paper.u_min_initial, paper.u_max_initial), (paper.u_min_final, paper.u_max_final)
        first, last = ([shown(value, ".4f") for value in pair] for pair in ends)
        given_grid = ["paper, given grid", given, MISSING, *first, MISSING]
        return [given_grid, ["paper, relocated", given, final, *last, MISSING], *rows]
    return rows
