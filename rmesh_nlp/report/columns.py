"""Columns of the tables, what stands in a cell and with how many digits; and the tables that they make."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.io.records import Record, Records, ends_of, gain_of, objective_of
from rmesh_nlp.report.blocks import Case, contact_units, label
from rmesh_nlp.report.table import MISSING, Table
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import Digits


def cost(value: float) -> str:
    """Three digits, and all of them before the point."""
    return ".3g" if value < 100 else ".0f"


def shown(value: float | None, digits: Digits) -> str:
    """A number in a format, or one that it chooses; or what stands for a number that is not known."""
    if value is None or math.isnan(value):
        return MISSING
    form = digits if isinstance(digits, str) else digits(value)
    return "0" if value == 0 and form.endswith("e") else format(value, form)


@dataclass(frozen=True)
class Column:
    """One column: its heading, and the entry of a record that it shows or what it makes of the record.

    Lines of the heading are separated by a bar.
    """

    heading: str
    of: str | Callable[[Record], str | float | None]
    digits: Digits = "d"

    def cell(self, record: Record) -> str:
        """The cell of a record."""
        value = record.get(self.of) if isinstance(self.of, str) else self.of(record)
        return value or MISSING if isinstance(value, str) else shown(value, self.digits)


def of(*names: str) -> tuple[Column, ...]:
    """The columns of entries, as they are declared."""
    entries = (ENTRIES[name] for name in names)
    return tuple(Column(one.heading or one.name.replace("_", "|"), one.name, one.digits) for one in entries)


RESULTS = (
    "normal_force",
    "tangential_force",
    "peak_pressure",
    "contact_length",
    "force_x",
    "force_y",
    "moment",
)
OF_ALL = ("resultant", "peak_pressure")  # of all contact boundaries together: shown where there is one


def of_boundaries(records: Records, least: int = 2) -> list[Record]:
    """A row for each contact boundary where there are ``least`` or more, with its results at the end."""
    return [
        {**record, **results, "boundary": " and ".join(pairs.get(name, [label])), "contact": None}
        for record in records
        for contact, pairs in [(record.get("contact") or {}, record.get("pairs") or {})]
        for name, results in contact.items()
        for label in [name + " (length: an area)" * (name == "interior")]
        if len(contact) >= least
    ]


def cells(columns: Sequence[Column], records: Records) -> list[list[str]]:
    """A row for each record; of several contact boundaries none has what is of all."""
    rows = [{**record, **dict.fromkeys(OF_ALL if _of_several(record) else ())} for record in records]
    return [[column.cell(row) for column in columns] for row in rows]


def _of_several(record: Record) -> bool:
    return len(record.get("contact") or ()) > 1


def table_of(columns: Sequence[Column], records: Records, **options: Any) -> Table:
    """A table with a row for each record, without the columns that none of them fills.

    Of several columns with one heading the last counts.
    """
    columns = [*{column.heading: column for column in columns}.values()]
    rows = cells(columns, records)
    filled = [place for place in range(len(columns)) if {row[place] for row in rows} != {MISSING}]
    kept = [[row[place] for place in filled] for row in rows]
    return Table([columns[place].heading for place in filled], kept, **options)


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


def _violation(record: Record) -> float | None:
    """The largest violation of a constraint; None where nothing is constrained."""
    constraints = (record.get("constraints") or {}).values()
    return max((one["violation"] for one in constraints if one.get("violation") is not None), default=None)


def short_label(record: Record) -> str:
    """The label below a heading that names the objective."""
    return label({**record, "objective": "energy"})


COST = Column("cost|[contact solves]", contact_units, cost)


@dataclass(frozen=True)
class Kind:
    """A table of solves: columns beside that of the solve, and caption.

    ``is_wanted`` says which blocks it has.
    """

    columns: tuple[Column, ...]
    caption: str
    is_wanted: Callable[[Case], bool] = lambda block: True


def _with(entry: str) -> Callable[[Case], bool]:
    """Blocks with a record that has an entry."""
    return lambda block: any(record.get(entry) is not None for record in block.records)


OF_BOUNDARIES = "Results of each contact boundary on the relocated mesh."
CONTACT = (
    Column("boundary", "boundary"),
    *(Column(name.replace("_", "|"), name, ".4g") for name in RESULTS),
)
PRINTED = (
    Kind(
        (
            *of("energy_initial_audited", "energy_audited"),
            Column(
                "gain|[%]",
                lambda record: gain_of(record.get("energy_initial_audited"), record.get("energy_audited")),
                lambda gain: ".2f" if abs(gain) < 1000 else ".3g",
            ),
            *of("iterations", "contact_solves", "wall_time_s", "status"),
        ),
        "Relocation by each formulation. J is the total potential energy of the contact solution on the "
        "given and on the relocated mesh, as assessed: loads by an adaptive rule, gaps along whole edges, "
        "friction and curves integrated. Gain: in per cent of |J| on the given mesh. Time: build, solve and "
        "audit.",
        lambda block: block.has_energy,
    ),
    Kind(
        (
            *of("energy_lower_bound", "energy_upper_bound"),
            Column("error before|[%]", _bound("relative_error_bound_initial", "initial")),
            Column("error after|[%]", _bound("relative_error_bound", "upper")),
        ),
        "Bounds of the least energy, and of the error in the energy norm in per cent of the norm.",
        _with("certificate_remark"),
    ),
    Kind(
        (
            *of("nodes", "energy_audited"),
            Column("gain over the|given mesh", "refinement_gain", ".4g"),
            *of("wall_time_s"),
        ),
        "Relocation against uniform refinement: audited energies and gains over the given mesh.",
        _with("refinement_gain"),
    ),
    Kind(
        (
            *of("objective_initial", "objective_value"),
            Column("gain|[%]", lambda record: gain_of(*ends_of(record)), ".4g"),
            Column(
                "left on refined|meshes [%]",
                lambda row: None if row.get("gain_surviving") is None else 100 * row["gain_surviving"],
                ".3g",
            ),
            Column("violation", _violation, ".1e"),
            *of("iterations", "status"),
        ),
        "Objective: with mesh and design at the start and at the end of the solve. Gain: in per cent of its "
        "size at the start. Left on refined meshes: the part of the gain that is there when both meshes are "
        "refined uniformly. Violation: the largest of a constraint, over its bound.",
        lambda block: not block.has_energy or any(objective_of(row) != "energy" for row in block.records),
    ),
)
"""Columns that are printed; :data:`KINDS` has those that can be asked for too."""
KINDS = (
    *PRINTED,
    Kind(
        of("energy_initial", "energy", "u_min", "u_max", "resultant", "peak_pressure", "min_area_ratio"),
        "Own rule: the energy with the quadrature of the problem. Extremes of the displacement u and the "
        "contact are those on the relocated mesh. Least area ratio: the smallest element area over its value "
        "on the given mesh. rmesh reproduce examines each of the paper's values.",
        lambda block: block.has_energy,
    ),
    Kind(
        (
            *of("start"),
            Column("contact solves,|cold + warm", _solves),
            Column("factorisations,|contact; KKT", _factorisations),
            Column("build|[s]", _seconds("build")),
            Column("solve|[s]", _seconds("solve")),
            Column("audit|[s]", _seconds("audit")),
            COST,
        ),
        "Cost: time of build and solve over that of one contact solve on the given mesh, the median of those "
        "that the rows measured. Factorisations of KKT matrices: at least as many as Ipopt took iterations.",
    ),
    Kind(
        (
            Column("J reached|by all", "common_objective", ".7g"),
            Column("cost to|that J", "cost_to_objective", cost),
            Column("residual|reached by all", "common_stationarity", ".1e"),
            Column("cost to|that residual", "cost_to_stationarity", cost),
            COST,
        ),
        "Reached by all: an energy or other objective, and a first-order residual, that all successful "
        "formulations reach, and the cost until each was there first, in contact solves on the given mesh.",
        _with("common_objective"),
    ),
    Kind(
        (
            *of("own_equilibrium_residual", "equilibrium_residual"),
            *of("own_complementarity_residual", "complementarity_residual", "stationarity_residual"),
            Column(
                "biactive",
                lambda row: None if row.get("biactive_nodes") is None else len(row["biactive_nodes"]),
            ),
            Column("label", _stationarity),
        ),
        "Residuals of equilibrium and complementarity are dimensionless. Own: of the displacement and "
        "contact forces that the formulation ended with. Assessed: of an independent contact solve on its "
        "mesh. First-order residual: of the outer problem, over that on the given mesh. Label: the "
        "stationarity that was computed; S (KKT) is S-stationarity without a biactive pair, that is, a KKT "
        "point. Biactive: pairs of gap and contact force that both vanish.",
    ),
    Kind(
        (
            *of("I1", "I2", "I3"),
            Column("sum", _sum_of_errors, ".6f"),
            *of("energy_above_exact"),
        ),
        "Theorem 4.1: errors in energy (I1), contact (I2) and friction (I3), and the energy above the exact "
        "one.",
        _with("I1"),
    ),
)
