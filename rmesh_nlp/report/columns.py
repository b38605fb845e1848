"""Columns of the tables: what stands in a cell, and with how many digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, contact_units, gain_in_per_cent, label
from rmesh_nlp.report.markup import MISSING, latex_heading

Cell = Callable[[Record], str]


@dataclass(frozen=True)
class Column:
    """One column: lines of its heading separated by a bar, cells, and a heading in LaTeX if it is shorter."""

    heading: str
    cell: Cell
    short: str = ""

    @property
    def head(self) -> str:
        """The heading in plain text."""
        return self.heading.replace("|", " ")

    @property
    def tex(self) -> str:
        """The heading in LaTeX."""
        return latex_heading(self.short or self.heading)


def shown(value: float | None, form: str) -> str:
    """A number, or what stands for one that is not known."""
    if value is None:
        return MISSING
    return "0" if value == 0 and form.endswith("e") else format(value, form)


def _number(name: str, form: str) -> Cell:
    return lambda record: shown(record.get(name), form)


def _text(name: str) -> Cell:
    return lambda record: str(record.get(name) or MISSING)


def _energy(name: str) -> Cell:
    """Six decimals, or seven digits where an energy is very large or very small."""

    def cell(record: Record) -> str:
        value = record.get(name)
        usual = value is None or value == 0 or 1e-3 <= abs(value) < 1e3
        return shown(value, ".6f" if usual else ".7g")

    return cell


def _solves_of_contact(value: float | None) -> str:
    """A cost: three digits, and all of them before the point."""
    return shown(value, ".3g" if value is None or value < 100 else ".0f")


def _cost(name: str) -> Cell:
    return lambda record: _solves_of_contact(record.get(name))


def _cost_to_the_end(record: Record) -> str:
    return _solves_of_contact(contact_units(record))


def _seconds(part: str) -> Cell:
    """Seconds, with their range where the solve was repeated."""

    def cell(record: Record) -> str:
        ends = record.get(f"{part}_time_range_s")
        text = shown(record.get(f"{part}_time_s"), ".3g")
        return f"{text} ({ends[0]:.2g} to {ends[1]:.2g})" if ends and text != MISSING else text

    return cell


def _wall_time(record: Record) -> str:
    """Build, solve and audit."""
    value = record.get("wall_time_s")
    return shown(value, ".2g" if value is None or value < 10 else ".0f")


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
    label = str(record.get("stationarity") or MISSING)
    return "S (KKT)" if label == "S" and record.get("biactive") == 0 else label


def _biactive(record: Record) -> str:
    nodes = record.get("biactive_nodes")
    return MISSING if nodes is None else str(len(nodes))


def _sum_of_errors(record: Record) -> str:
    terms = [record[name] for name in ("I1", "I2", "I3") if record.get(name) is not None]
    return f"{sum(terms):.6f}" if len(terms) == 3 else MISSING


def _gain(record: Record) -> str:
    gain = gain_in_per_cent(record)
    return shown(gain, ".2f" if gain is None or abs(gain) < 1000 else ".3g")


def _bound(name: str, side: str) -> Cell:
    """A bound of the error in per cent, called "about" if it is not guaranteed."""

    def cell(record: Record) -> str:
        value = record.get(name)
        guaranteed = record.get("guaranteed_lower") and record.get(f"guaranteed_{side}")
        return MISSING if value is None else f"{'at most' if guaranteed else 'about'} {100 * value:.3g}"

    return cell


FORMULATION = Column("formulation", label)
STATUS = Column("status", _text("status"))
BIACTIVE, LABEL = Column("biactive", _biactive), Column("label", _stationarity)

MAIN = (
    FORMULATION,
    Column("J|given", _energy("energy_initial_audited")),
    Column("J|relocated", _energy("energy_audited")),
    Column("gain|[%]", _gain),
    Column("iterations", _number("iterations", "d")),
    Column("contact|solves", _number("contact_solves", "d")),
    Column("time|[s]", _wall_time),
    STATUS,
)
"""What a first reader wants to know: audited energies, work and how each solve ended."""

ENERGIES = (
    FORMULATION,
    Column("J given,|own rule", _energy("energy_initial")),
    Column("J relocated,|own rule", _energy("energy")),
    Column("u min", _number("u_min", ".4g"), r"$u_{\min}$"),
    Column("u max", _number("u_max", ".4g"), r"$u_{\max}$"),
    Column("least|area ratio", _number("min_area_ratio", ".3f")),
)
"""Energies by the rule of the problem, extremes of the displacement, least area over the given one."""

COSTS = (
    FORMULATION,
    Column("start", _text("start")),
    Column("contact solves,|cold + warm", _solves),
    Column("factorisations,|contact; KKT", _factorisations),
    Column("build|[s]", _seconds("build")),
    Column("solve|[s]", _seconds("solve")),
    Column("audit|[s]", _seconds("audit")),
    Column("cost|[contact solves]", _cost_to_the_end),
)
"""Work by one clock, the audit apart."""

RESIDUALS = (
    FORMULATION,
    Column("equilibrium,|own", _number("own_equilibrium_residual", ".1e"), "equil.,|own"),
    Column("equilibrium,|assessed", _number("assessed_equilibrium_residual", ".1e"), "equil.,|assessed"),
    Column("complementarity,|own", _number("own_complementarity_residual", ".1e"), "compl.,|own"),
    Column(
        "complementarity,|assessed", _number("assessed_complementarity_residual", ".1e"), "compl.,|assessed"
    ),
    Column("first-order residual", _number("stationarity_residual", ".1e"), "first-|order"),
    BIACTIVE,
    LABEL,
)
"""Residuals of the formulation's own state and of the assessment's contact solve, and the label."""

COMMON = (
    FORMULATION,
    Column("J reached|by all", _number("common_objective", ".7g")),
    Column("cost to|that J", _cost("cost_to_objective")),
    Column("residual|reached by all", _number("common_stationarity", ".1e")),
    Column("cost to|that residual", _cost("cost_to_stationarity")),
    Column("cost to|the end", _cost_to_the_end),
)
"""Cost in contact solves until the level that all formulations reach, and to the end of each."""

ERRORS = (
    FORMULATION,
    *(
        Column(name, _number(name, form), f"$I_{name[1]}$")
        for name, form in (("I1", ".6f"), ("I2", ".2e"), ("I3", ".2e"))
    ),
    Column("sum", _sum_of_errors),
    Column("J audited - J exact", _number("energy_above_exact", ".6f"), "$J-J(u)$,|audited"),
)
"""Theorem 4.1: the three errors, and the difference of the energies that their sum is."""

OBJECTIVES = (
    FORMULATION,
    Column("initial", _number("objective_initial", ".6e")),
    Column("final", _number("objective_value", ".6e")),
    BIACTIVE,
    LABEL,
    STATUS,
)
"""Outer objectives other than the energy."""

CERTIFICATES = (
    FORMULATION,
    Column("lower|bound", _energy("energy_lower_bound")),
    Column("upper|bound", _energy("energy_upper_bound")),
    Column("error before|[%]", _bound("relative_error_bound_initial", "initial")),
    Column("error after|[%]", _bound("relative_error_bound", "upper")),
)
"""Bounds of the least energy, and of the error in the energy norm."""


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
        return [
            ["paper, given grid", given, MISSING, *first, MISSING],
            ["paper, relocated", given, final, *last, MISSING],
            *rows,
        ]
    return rows
