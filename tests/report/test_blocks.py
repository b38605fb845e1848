"""Records of one example on one grid with the same move limits and rule: names, and cells of tables."""

from typing import Any

import pytest

from rmesh_nlp.io.records import Records
from rmesh_nlp.report.blocks import Case, block_key, blocks, delta_text, label
from rmesh_nlp.report.columns import KINDS, Column
from rmesh_nlp.report.tables import sections_of
from support.reporting import designed, fixed_61, joint_61, joint_62

MAIN, CERTIFICATE, _, _, ENERGY, COST, COMMON, RESIDUAL, ERRORS = (kind.columns for kind in KINDS)


def names_of_solves(records: Records) -> list[str]:
    return [row["solve"] for _, block in sections_of(records) for row in block.records]


def test_records_are_grouped_in_the_order_of_their_appearance() -> None:
    other = ({"order": 2}, {"n": "16"}, {"quadrature": 6}, {"example": "6.2"}, {"delta": [0.1, 0.1]})
    rows = [fixed_61(), fixed_61(**other[0]), joint_61(), *(fixed_61(**one) for one in other[1:])]
    rows.append(joint_61(objective="error-l2", order=1))
    groups = blocks(rows)
    assert [len(group.records) for group in groups] == [3, 1, 1, 1, 1, 1]
    assert groups[0].records == (rows[0], rows[2], rows[7])
    older = fixed_61()
    del older["quadrature"]
    assert block_key(older) == block_key(fixed_61())


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"formulation": "mpcc", "start": "joint"}, "joint, certified as an MPCC solution"),
        ({"formulation": "nested", "start": "joint"}, "nested"),
        ({"formulation": "mpcc", "relaxation": "lin-fukushima"}, "mpcc, lin-fukushima"),
        ({"objective": "error-l2", "seed": 0}, "fixed, error-l2, seed 0"),
        ({"objective": "energy + 0.01*shape-size", "regularisation": 0.01}, "fixed, regularised"),
        ({"objective": "energy + 1*s", "regularisation": 1.0, "chosen_by": "auto"}, "auto (fixed)"),
    ],
)
def test_labels(changes: dict[str, Any], text: str) -> None:
    assert label(fixed_61(**changes)) == text


def test_titles_and_names_tell_the_settings_that_differ() -> None:
    assert Case((fixed_61(),)).title == "Example 6.1: n = 8, delta = 0.0275, midpoint rule"
    rule = Case((fixed_61(quadrature=6, delta=None),))
    assert rule.title == "Example 6.1: n = 8, delta = none, rule of degree 6"
    quadratic = fixed_61(order=2)
    assert Case((quadratic,)).title == "Example 6.1: n = 8, order 2, delta = 0.0275, midpoint rule"
    assert names_of_solves([quadratic]) == ["6.1, order 2, fixed"]
    assert names_of_solves([fixed_61(), quadratic]) == ["6.1, order 1, fixed", "6.1, order 2, fixed"]
    assert delta_text({"relative": 0.3}) == "0.3 x shortest edge"
    assert delta_text([0.1, 0.25]) == "0.1 x 0.25"
    finer = [joint_62(n="24x12", delta=[delta, delta]) for delta in (0.1, 0.2)]
    assert names_of_solves([joint_62(), *finer, joint_61(seed=7)]) == [
        "6.2, n = 12x6, joint",
        "6.2, n = 24x12, delta = 0.1, joint",
        "6.2, n = 24x12, delta = 0.2, joint",
        "6.1, joint, seed 7",
    ]


def test_the_best_is_the_success_of_least_energy_or_of_the_least_value_of_another_objective() -> None:
    low, bad = joint_61(energy_audited=-1.2), joint_61(energy_audited=-9.0, success=False)
    block = Case((bad, low, fixed_61(energy_audited=-1.1)))
    assert block.best is low
    assert Case((bad,)).best is None
    one, two = designed(), designed(objective_value=5e-4, energy_audited=9.0)
    assert Case((one, two)).best is two
    assert Case((one, {**two, "objective_value": None})).best is one


PAID, REACHED, BOTH = "cost [contact solves]", "cost to that J", ("guaranteed_lower", "guaranteed_upper")


def cell(table: tuple[Column, ...], head: str, record: dict[str, Any]) -> str:
    (column,) = [column for column in table if column.heading.replace("|", " ") == head]
    return column.cell(record)


@pytest.mark.parametrize(
    ("table", "head", "record", "text"),
    [
        (COST, "build [s]", {"build_time_s": 0.12, "build_time_range_s": [0.1, 0.256]}, "0.12 (0.1 to 0.26)"),
        (COST, "contact solves, cold + warm", {"contact_solves": 7, "cold_contact_solves": 2}, "2 + 5"),
        (COST, PAID, {"build_time_s": 1.0, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5},
         "6"),
        (COST, PAID, {"build_time_s": None, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5},
         "18"),
        (COST, PAID, {"wall_time_s": 9.0, "contact_time_s": 0.0}, "-"),
        (COST, PAID, {"wall_time_s": 49.97, "contact_time_s": 0.5}, "99.9"),
        (COST, "factorisations, contact; KKT", {"contact_factorisations": 9, "kkt_factorisations": 0}, "9"),
        (ENERGY, "J relocated, own rule", {"energy": 0.0}, "0.000000"),
        (MAIN, "J relocated", {"energy_audited": -1.23456789e-5}, "-1.234568e-05"),
        (MAIN, "J relocated", {"energy_audited": 1000.5}, "1000.5"),
        (MAIN, "gain [%]", {"energy_audited": -200.0, "energy_initial_audited": -2.0}, "9.9e+03"),
        (MAIN, "gain [%]", {"energy_audited": 0.5, "energy_initial_audited": 0.0}, "-"),
        (MAIN, "time [s]", {"wall_time_s": 123.4}, "123"),
        (RESIDUAL, "label", {"stationarity": "S", "biactive": 1}, "S"),
        (COMMON, REACHED, {"cost_to_objective": 1234.4}, "1234"),
        (ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": 0.125}, "0.875000"),
        (ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": None}, "-"),
        (CERTIFICATE, "error after [%]", {"relative_error_bound": 0.1234, **dict.fromkeys(BOTH, True)},
         "at most 12.3"),
        (CERTIFICATE, "error after [%]", {"relative_error_bound": 0.1, BOTH[1]: True}, "about 10"),
        (CERTIFICATE, "error after [%]", {"relative_error_bound": 0.1, BOTH[0]: True}, "about 10"),
        (CERTIFICATE, "error before [%]",
         {"relative_error_bound_initial": 0.2, BOTH[0]: True, "guaranteed_initial": True}, "at most 20"),
    ],
)  # fmt: skip
def test_cells(table: tuple[Column, ...], head: str, record: dict[str, Any], text: str) -> None:
    assert cell(table, head, record) == text
