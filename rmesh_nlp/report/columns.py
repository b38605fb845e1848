"""Columns of the tables: what stands in a cell, and with how many digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.examples import PaperValues
from rmesh_nlp.io.results import Record
from rmesh_nlp.report.blocks import Block, label

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


def seconds_of_work(record: Record) -> float | None:
    """Seconds of build and solve: the audit is no cost of a strategy.

    Records of older versions have no split time: their wall time counts.
    """
    build, solve = record.get("build_time_s"), record.get("solve_time_s")
    return record.get("wall_time_s") if build is None or solve is None else build + solve


def contact_units(record: Record) -> float | None:
    """Build and solve over the time of one contact solve measured in the same run."""
    seconds, unit = seconds_of_work(record), record.get("contact_time_s")
    return seconds / unit if seconds is not None and unit else None


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
    return rf"\shortstack[r]{{{first}\\ {{{second}}}}}"


def _gain_in_per_cent(record: Record) -> str:
    """The audited gain in per cent of the audited energy on the given mesh."""
    gain, initial = record.get("gain_audited"), record.get("energy_initial_audited")
    return MISSING if gain is None or not initial else f"{100 * gain / abs(initial):.3g}"


def _bound(name: str, side: str) -> Callable[[Record], str]:
    """A bound of the error in per cent, called "about" if it is not guaranteed."""

    def cell(record: Record) -> str:
        value = record.get(name)
        if value is None:
            return MISSING
        guaranteed = record.get("guaranteed_lower") and record.get(f"guaranteed_{side}")
        return f"{'at most' if guaranteed else 'about'} {100 * value:.3g}"

    return cell


STRATEGY = Column("strategy", "strategy", label)

ENERGIES = (
    STRATEGY,
    Column("J initial", _two("$J$", "initial"), _number("energy_initial", ".6f")),
    Column("J final", _two("$J$", "final"), _number("energy", ".6f")),
    Column("audited initial", _two("audited", "initial"), _number("energy_initial_audited", ".6f")),
    Column("audited final", _two("audited", "final"), _number("energy_audited", ".6f")),
    Column("audited gain", _two("audited", "gain"), _number("gain_audited", ".6f")),
    Column("gain [%]", _two("gain", r"[\%]"), _gain_in_per_cent),
    Column("u min", r"$u_{\min}$", _number("u_min", ".4g")),
    Column("u max", r"$u_{\max}$", _number("u_max", ".4g")),
    Column("least area", _two("least", "area"), _number("min_area_ratio", ".3f")),
)
"""Energies by the rule of the problem and by that of the audit, whose gain is what counts; extremes of the
displacement; least element area over its initial one."""

COSTS = (
    STRATEGY,
    Column("start", "start", _text("start")),
    Column("iterations", "iter.", _number("iterations", "d")),
    Column("contact solves, cold + warm", _two("contact", "solves"), _solves),
    Column("factorisations, contact; KKT", _two("factor-", "isations"), _factorisations),
    Column("build [s]", _two("build", "[s]"), _seconds("build")),
    Column("solve [s]", _two("solve", "[s]"), _seconds("solve")),
    Column("audit [s]", _two("audit", "[s]"), _seconds("audit")),
    Column("build + solve [solves]", _two("cost", "[solves]"), _in_contact_solves),
    Column("tolerance", "tol.", _number("tolerance", ".0e")),
    Column("status", "status", _text("status")),
)
"""Work by one clock, the audit apart, and how it ended."""

RESIDUALS = (
    STRATEGY,
    Column("equilibrium, own", _two("equil.", "own"), _number("own_equilibrium_residual", ".1e")),
    Column("equilibrium, referee", _two("equil.", "referee"), _number("referee_equilibrium_residual", ".1e")),
    Column("complementarity, own", _two("compl.", "own"), _number("own_complementarity_residual", ".1e")),
    Column(
        "complementarity, referee",
        _two("compl.", "referee"),
        _number("referee_complementarity_residual", ".1e"),
    ),
    Column("stationarity", "stat.", _number("stationarity_residual", ".1e")),
    Column("biactive", "biactive", lambda record: _count(record.get("biactive_nodes"))),
    Column("label", "label", lambda record: label_in_words(record)),
)
"""Residuals of the strategy's own state and of the referee's contact solve on its mesh, and the label."""

COMMON = (
    STRATEGY,
    Column("common level", _two("common", "level"), _number("common_objective", ".7g")),
    Column("cost to level [solves]", _two("cost", "to level"), _cost("cost_to_objective")),
    Column("common stationarity", _two("common", "stat."), _number("common_stationarity", ".1e")),
    Column("cost to stationarity [solves]", _two("cost", "to stat."), _cost("cost_to_stationarity")),
    Column("cost to the end [solves]", _two("cost to", "the end"), _in_contact_solves),
)
"""Cost until the level that all strategies reach, and to the end of each."""

ERRORS = (
    STRATEGY,
    Column("I1", "$I_1$", _number("I1", ".6f")),
    Column("I2", "$I_2$", _number("I2", ".2e")),
    Column("I3", "$I_3$", _number("I3", ".2e")),
    Column("sum", "sum", lambda record: _sum_of_errors(record)),
    Column("J audited - J exact", _two("$J-J(u)$", "audited"), _number("energy_above_exact", ".6f")),
)
"""Theorem 4.1: the three errors, and the difference of the energies that their sum is."""

OBJECTIVES = (
    STRATEGY,
    Column("objective", "objective", _text("objective")),
    Column("initial", "initial", _number("objective_initial", ".6e")),
    Column("final", "final", _number("objective_value", ".6e")),
    Column("biactive", "biactive", lambda record: _count(record.get("biactive_nodes"))),
    Column("label", "label", lambda record: label_in_words(record)),
    Column("status", "status", _text("status")),
)
"""Outer objectives other than the energy."""


CERTIFICATES = (
    STRATEGY,
    Column("lower bound", _two("lower", "bound"), _number("energy_lower_bound", ".6f")),
    Column("upper bound", _two("upper", "bound"), _number("energy_upper_bound", ".6f")),
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
    before = [f"{paper.energy_initial:.4f}", "", "", "", "", ""]
    after = [f"{paper.energy_initial:.4f}", f"{paper.energy_final:.4f}", "", "", "", ""]
    rows = [
        ["paper, given grid", *before, _optional(paper.u_min_initial), _optional(paper.u_max_initial), ""],
        ["paper, relocated", *after, _optional(paper.u_min_final), _optional(paper.u_max_final), ""],
    ]
    return [[cell or MISSING for cell in row] for row in rows]


def _optional(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"
