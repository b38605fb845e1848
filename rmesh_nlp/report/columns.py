"""Columns of the tables: what stands in a cell, and with how many digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.examples import PaperValues
from rmesh_nlp.io.records import Record
from rmesh_nlp.report.blocks import Block, contact_units, gain_in_per_cent, label

MISSING = "-"


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes
    ----------
    head, tex : str
        Heading in plain text and in LaTeX.
    cell : callable
        The text of a record's cell.
    """

    head: str
    tex: str
    cell: Callable[[Record], str]


def _number(name: str, form: str) -> Callable[[Record], str]:
    def cell(record: Record) -> str:
        value = record.get(name)
        if value is None:
            return MISSING
        return "0" if value == 0 and form.endswith("e") else format(value, form)

    return cell


def _text(name: str) -> Callable[[Record], str]:
    return lambda record: str(record.get(name) or MISSING)


def _in_contact_solves(record: Record) -> str:
    units = contact_units(record)
    return MISSING if units is None else f"{units:.3g}" if units < 100 else f"{units:.0f}"


def _seconds(part: str) -> Callable[[Record], str]:
    """Seconds, with their range where the solve was repeated."""

    def cell(record: Record) -> str:
        value, ends = record.get(f"{part}_time_s"), record.get(f"{part}_time_range_s")
        if value is None:
            return MISSING
        return f"{value:.3g}" if not ends else f"{value:.3g} ({ends[0]:.2g} to {ends[1]:.2g})"

    return cell


def _solves(record: Record) -> str:
    """Contact solves, cold and warm ones apart where that is known."""
    total, cold = record.get("contact_solves"), record.get("cold_contact_solves")
    if total is None:
        return MISSING
    return f"{total}" if cold is None else f"{cold} + {total - cold}"


def _factorisations(record: Record) -> str:
    """Those of the contact solver, and at least how many of KKT matrices there were."""
    contact, kkt = record.get("contact_factorisations"), record.get("kkt_factorisations")
    if contact is None:
        return MISSING
    return f"{contact}" if not kkt else f"{contact}; {kkt} or more"


def _cost(name: str) -> Callable[[Record], str]:
    def cell(record: Record) -> str:
        value = record.get(name)
        return MISSING if value is None else f"{value:.3g}" if value < 100 else f"{value:.0f}"

    return cell


def label_in_words(record: Record) -> str:
    """The label of stationarity, and whether it says more than that of an ordinary program."""
    label = str(record.get("stationarity") or MISSING)
    return "S (KKT)" if label == "S" and record.get("biactive") == 0 else label


def _sum_of_errors(record: Record) -> str:
    terms = [record[name] for name in ("I1", "I2", "I3") if record.get(name) is not None]
    return f"{sum(terms):.6f}" if len(terms) == 3 else MISSING


def _two(first: str, second: str) -> str:
    """A LaTeX heading of two lines."""
    return rf"\begin{{tabular}}[b]{{@{{}}r@{{}}}}{first}\\ {{{second}}}\end{{tabular}}"


def _gain(record: Record) -> str:
    gain = gain_in_per_cent(record)
    return MISSING if gain is None else f"{gain:.2f}" if abs(gain) < 1000 else f"{gain:.3g}"


def _bound(name: str, side: str) -> Callable[[Record], str]:
    """A bound of the error in per cent, called "about" if it is not guaranteed."""

    def cell(record: Record) -> str:
        value = record.get(name)
        if value is None:
            return MISSING
        guaranteed = record.get("guaranteed_lower") and record.get(f"guaranteed_{side}")
        return f"{'at most' if guaranteed else 'about'} {100 * value:.3g}"

    return cell


def _energy(name: str) -> Callable[[Record], str]:
    """Six decimals, or seven digits where an energy is very large or very small."""

    def cell(record: Record) -> str:
        value = record.get(name)
        if value is None:
            return MISSING
        return f"{value:.6f}" if value == 0 or 1e-3 <= abs(value) < 1e3 else f"{value:.7g}"

    return cell


def _time(record: Record) -> str:
    """Wall time of build, solve and audit."""
    value = record.get("wall_time_s")
    return MISSING if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"


FORMULATION = Column("formulation", "formulation", label)

MAIN = (
    FORMULATION,
    Column("J given", _two("$J$", "given"), _energy("energy_initial_audited")),
    Column("J relocated", _two("$J$", "relocated"), _energy("energy_audited")),
    Column("gain [%]", _two("gain", r"[\%]"), _gain),
    Column("iterations", "iterations", _number("iterations", "d")),
    Column("contact solves", _two("contact", "solves"), _number("contact_solves", "d")),
    Column("time [s]", _two("time", "[s]"), _time),
    Column("status", "status", _text("status")),
)
"""What a first reader wants to know: audited energies, work and how each solve ended."""

ENERGIES = (
    FORMULATION,
    Column("J given, own rule", _two("$J$ given,", "own rule"), _energy("energy_initial")),
    Column("J relocated, own rule", _two("$J$ relocated,", "own rule"), _energy("energy")),
    Column("u min", r"$u_{\min}$", _number("u_min", ".4g")),
    Column("u max", r"$u_{\max}$", _number("u_max", ".4g")),
    Column("least area ratio", _two("least", "area ratio"), _number("min_area_ratio", ".3f")),
)
"""Energies by the rule of the problem, extremes of the displacement, least area over the given one."""

COSTS = (
    FORMULATION,
    Column("start", "start", _text("start")),
    Column("contact solves, cold + warm", _two("contact solves,", "cold + warm"), _solves),
    Column("factorisations, contact; KKT", _two("factorisations,", "contact; KKT"), _factorisations),
    Column("build [s]", _two("build", "[s]"), _seconds("build")),
    Column("solve [s]", _two("solve", "[s]"), _seconds("solve")),
    Column("audit [s]", _two("audit", "[s]"), _seconds("audit")),
    Column("cost [contact solves]", _two("cost", "[contact solves]"), _in_contact_solves),
)
"""Work by one clock, the audit apart."""

RESIDUALS = (
    FORMULATION,
    Column("equilibrium, own", _two("equil.,", "own"), _number("own_equilibrium_residual", ".1e")),
    Column(
        "equilibrium, assessed", _two("equil.,", "assessed"), _number("assessed_equilibrium_residual", ".1e")
    ),
    Column("complementarity, own", _two("compl.,", "own"), _number("own_complementarity_residual", ".1e")),
    Column(
        "complementarity, assessed",
        _two("compl.,", "assessed"),
        _number("assessed_complementarity_residual", ".1e"),
    ),
    Column("first-order residual", _two("first-", "order"), _number("stationarity_residual", ".1e")),
    Column("biactive", "biactive", lambda record: _count(record.get("biactive_nodes"))),
    Column("label", "label", lambda record: label_in_words(record)),
)
"""Residuals of the formulation's own state and of the assessment's contact solve, and the label."""

COMMON = (
    FORMULATION,
    Column("J reached by all", _two("$J$ reached", "by all"), _number("common_objective", ".7g")),
    Column("cost to that J", _two("cost to", "that $J$"), _cost("cost_to_objective")),
    Column(
        "residual reached by all", _two("residual", "reached by all"), _number("common_stationarity", ".1e")
    ),
    Column("cost to that residual", _two("cost to", "that residual"), _cost("cost_to_stationarity")),
    Column("cost to the end", _two("cost to", "the end"), _in_contact_solves),
)
"""Cost in contact solves until the level that all formulations reach, and to the end of each."""

ERRORS = (
    FORMULATION,
    Column("I1", "$I_1$", _number("I1", ".6f")),
    Column("I2", "$I_2$", _number("I2", ".2e")),
    Column("I3", "$I_3$", _number("I3", ".2e")),
    Column("sum", "sum", lambda record: _sum_of_errors(record)),
    Column("J audited - J exact", _two("$J-J(u)$,", "audited"), _number("energy_above_exact", ".6f")),
)
"""Theorem 4.1: the three errors, and the difference of the energies that their sum is."""

OBJECTIVES = (
    FORMULATION,
    Column("initial", "initial", _number("objective_initial", ".6e")),
    Column("final", "final", _number("objective_value", ".6e")),
    Column("biactive", "biactive", lambda record: _count(record.get("biactive_nodes"))),
    Column("label", "label", lambda record: label_in_words(record)),
    Column("status", "status", _text("status")),
)
"""Outer objectives other than the energy."""


CERTIFICATES = (
    FORMULATION,
    Column("lower bound", _two("lower", "bound"), _energy("energy_lower_bound")),
    Column("upper bound", _two("upper", "bound"), _energy("energy_upper_bound")),
    Column(
        "error before [%]", _two("error before", r"[\%]"), _bound("relative_error_bound_initial", "initial")
    ),
    Column("error after [%]", _two("error after", r"[\%]"), _bound("relative_error_bound", "upper")),
)
"""Bounds of the least energy, and of the error in the energy norm."""


def _count(values: Any) -> str:
    return MISSING if values is None else str(len(values))


def body(columns: tuple[Column, ...], block: Block) -> list[list[str]]:
    """The rows of a block, those of the paper first where its settings were used."""
    common = {} if block.unit is None else {"contact_time_s": block.unit}
    records = [{**record, **common} if record.get("contact_time_s") else record for record in block.records]
    rows = [[column.cell(record) for column in columns] for record in records]
    if columns is ENERGIES and block.paper is not None:
        rows = [*_paper_rows(block.paper), *rows]
    return rows


def _paper_rows(paper: PaperValues) -> list[list[str]]:
    given, final = f"{paper.energy_initial:.4f}", f"{paper.energy_final:.4f}"
    return [
        [
            "paper, given grid",
            given,
            MISSING,
            _optional(paper.u_min_initial),
            _optional(paper.u_max_initial),
            MISSING,
        ],
        [
            "paper, relocated",
            given,
            final,
            _optional(paper.u_min_final),
            _optional(paper.u_max_final),
            MISSING,
        ],
    ]


def _optional(value: float | None) -> str:
    return MISSING if value is None else f"{value:.4f}"
