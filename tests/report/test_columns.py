"""Cells of tables, literally."""

from __future__ import annotations

from typing import Any

import pytest

from rmesh_nlp.report import columns
from rmesh_nlp.report.columns import Column

MAIN, COST, COMMON = columns.MAIN, columns.COSTS, columns.COMMON
ENERGY, RESIDUAL, CERTIFICATE = columns.ENERGIES, columns.RESIDUALS, columns.CERTIFICATES
PAID, REACHED, BOTH = "cost [contact solves]", "cost to that J", ("guaranteed_lower", "guaranteed_upper")


def cell(table: tuple[Column, ...], head: str, record: dict[str, Any]) -> str:
    (column,) = [column for column in table if column.heading.replace("|", " ") == head]
    return column.cell(record)


@pytest.mark.parametrize(
    ("table", "head", "record", "text"),
    [
        (COST, "build [s]", {}, "-"),
        (COST, "build [s]", {"build_time_s": 0.12345}, "0.123"),
        (COST, "build [s]", {"build_time_s": 0.12, "build_time_range_s": [0.1, 0.256]}, "0.12 (0.1 to 0.26)"),
        (COST, "contact solves, cold + warm", {"contact_solves": 7, "cold_contact_solves": 2}, "2 + 5"),
        (COST, PAID, {"build_time_s": 1.0, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5},
         "6"),
        (COST, PAID, {"build_time_s": None, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5},
         "18"),
        (COST, PAID, {"wall_time_s": 9.0, "contact_time_s": 0.0}, "-"),
        (COST, PAID, {"wall_time_s": 0.0, "contact_time_s": 0.5}, "0"),
        (COST, PAID, {"wall_time_s": 49.97, "contact_time_s": 0.5}, "99.9"),
        (COST, "factorisations, contact; KKT", {"kkt_factorisations": 3}, "-"),
        (COST, "factorisations, contact; KKT", {"contact_factorisations": 9, "kkt_factorisations": 0}, "9"),
        (COST, "factorisations, contact; KKT", {"contact_factorisations": 9, "kkt_factorisations": 4},
         "9; 4 or more"),
        (ENERGY, "J relocated, own rule", {"energy": 0.0}, "0.000000"),
        (MAIN, "J relocated", {"energy_audited": -1.23456789e-5}, "-1.234568e-05"),
        (MAIN, "J relocated", {"energy_audited": 1000.5}, "1000.5"),
        (MAIN, "J relocated", {"energy_audited": 0.00099}, "0.00099"),
        (MAIN, "gain [%]", {"energy_audited": -2.5, "energy_initial_audited": -2.0}, "25.00"),
        (MAIN, "gain [%]", {"energy_audited": -200.0, "energy_initial_audited": -2.0}, "9.9e+03"),
        (MAIN, "gain [%]", {"energy_audited": 0.5, "energy_initial_audited": 0.0}, "-"),
        (MAIN, "time [s]", {"wall_time_s": 123.4}, "123"),
        (RESIDUAL, "biactive", {"biactive_nodes": [4, 5]}, "2"),
        (RESIDUAL, "label", {"stationarity": "S", "biactive": 0}, "S (KKT)"),
        (RESIDUAL, "label", {"stationarity": "S", "biactive": 1}, "S"),
        (COMMON, REACHED, {"cost_to_objective": 1234.4}, "1234"),
        (columns.ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": 0.125}, "0.875000"),
        (columns.ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": None}, "-"),
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
