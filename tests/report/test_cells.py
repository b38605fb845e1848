"""Cells of tables, groups of records, and lines of stress figures, literally."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rmesh_nlp.io.vtu import Fields
from rmesh_nlp.problem.units import Units
from rmesh_nlp.report import columns
from rmesh_nlp.report.blocks import Block, audited, block_key, blocks, contact_units, delta_text, label
from rmesh_nlp.report.columns import Column, body
from rmesh_nlp.report.figures import stress_figure
from support.reporting import fixed_61, joint_61


def cell(table: tuple[Column, ...], head: str, /, **record: Any) -> str:
    (column,) = [column for column in table if column.head == head]
    return column.cell(record)


MAIN, COST = columns.MAIN, columns.COSTS
ENERGY, RESIDUAL = columns.ENERGIES, columns.RESIDUALS


@pytest.mark.parametrize(
    ("table", "head", "record", "text"),
    [
        (COST, "build [s]", {}, "-"),
        (COST, "build [s]", {"build_time_s": 0.12345}, "0.123"),
        (COST, "build [s]", {"build_time_s": 0.12, "build_time_range_s": [0.1, 0.256]}, "0.12 (0.1 to 0.26)"),
        (COST, "contact solves, cold + warm", {"contact_solves": 7}, "7"),
        (COST, "contact solves, cold + warm", {"contact_solves": 7, "cold_contact_solves": 2}, "2 + 5"),
        (COST, "factorisations, contact; KKT", {"kkt_factorisations": 3}, "-"),
        (COST, "factorisations, contact; KKT", {"contact_factorisations": 9, "kkt_factorisations": 0}, "9"),
        (COST, "factorisations, contact; KKT", {"contact_factorisations": 9, "kkt_factorisations": 4},
         "9; 4 or more"),
        (COST, "start", {"start": "joint"}, "joint"),
        (ENERGY, "J relocated, own rule", {"energy": 0.0}, "0.000000"),
        (MAIN, "J relocated", {"energy_audited": -1.23456789e-5}, "-1.234568e-05"),
        (MAIN, "J relocated", {"energy_audited": -123456.789}, "-123456.8"),
        (MAIN, "gain [%]", {"energy_audited": -2.5, "energy_initial_audited": -2.0}, "25.00"),
        (MAIN, "gain [%]", {"energy_audited": 2.5, "energy_initial_audited": 2.0}, "-25.00"),
        (MAIN, "gain [%]", {"energy_audited": -200.0, "energy_initial_audited": -2.0}, "9.9e+03"),
        (MAIN, "gain [%]", {"energy_audited": 0.5, "energy_initial_audited": 0.0}, "-"),
        (MAIN, "gain [%]", {"energy_initial_audited": 2.0}, "-"),
        (MAIN, "time [s]", {"wall_time_s": 0.0751}, "0.075"),
        (MAIN, "time [s]", {"wall_time_s": 123.4}, "123"),
        (RESIDUAL, "biactive", {"biactive_nodes": [4, 5]}, "2"),
        (RESIDUAL, "biactive", {"biactive_nodes": []}, "0"),
        (RESIDUAL, "label", {"stationarity": "S", "biactive": 0}, "S (KKT)"),
        (RESIDUAL, "label", {"stationarity": "S", "biactive": 1}, "S"),
        (RESIDUAL, "label", {"stationarity": "", "biactive": 0}, "-"),
        (columns.COMMON, "cost to that J", {"cost_to_objective": 99.94}, "99.9"),
        (columns.COMMON, "cost to that J", {"cost_to_objective": 1234.4}, "1234"),
        (columns.COMMON, "cost to that J", {}, "-"),
        (columns.ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": 0.125}, "0.875000"),
        (columns.ERRORS, "sum", {"I1": 0.5, "I2": 0.25, "I3": None}, "-"),
        (columns.CERTIFICATES, "error after [%]",
         {"relative_error_bound": 0.1234, "guaranteed_lower": True, "guaranteed_upper": True},
         "at most 12.3"),
        (columns.CERTIFICATES, "error after [%]",
         {"relative_error_bound": 0.1, "guaranteed_lower": False, "guaranteed_upper": True}, "about 10"),
        (columns.CERTIFICATES, "error after [%]",
         {"relative_error_bound": 0.1, "guaranteed_lower": True, "guaranteed_upper": False}, "about 10"),
        (columns.CERTIFICATES, "error before [%]",
         {"relative_error_bound_initial": 0.2, "guaranteed_lower": True, "guaranteed_initial": True},
         "at most 20"),
    ],
)  # fmt: skip
def test_a_cell(table: tuple[Column, ...], head: str, record: dict[str, Any], text: str) -> None:
    assert cell(table, head, **record) == text


@pytest.mark.parametrize(
    ("record", "units", "text"),
    [
        ({"build_time_s": 1.0, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5}, 6.0, "6"),
        ({"build_time_s": None, "solve_time_s": 2.0, "wall_time_s": 9.0, "contact_time_s": 0.5}, 18.0, "18"),
        ({"wall_time_s": 9.0}, None, "-"),
        ({"wall_time_s": 9.0, "contact_time_s": 0.0}, None, "-"),
        ({"wall_time_s": 0.0, "contact_time_s": 0.5}, 0.0, "0"),
        ({"wall_time_s": 49.97, "contact_time_s": 0.5}, 99.94, "99.9"),
        ({"wall_time_s": 617.2, "contact_time_s": 0.5}, 1234.4, "1234"),
    ],
)
def test_costs_are_counted_in_contact_solves(record: dict[str, Any], units: float | None, text: str) -> None:
    assert contact_units(record) == (None if units is None else pytest.approx(units))
    assert cell(COST, "cost [contact solves]", **record) == text


class TestBlocks:
    """Records of one example on one grid with one box and rule."""

    def test_records_are_grouped_in_the_order_of_their_appearance(self) -> None:
        rows = [fixed_61(), fixed_61(n="16"), joint_61(), fixed_61(quadrature=6), fixed_61(example="6.2"),
                fixed_61(delta=[0.1, 0.1]), joint_61(objective="error-l2")]  # fmt: skip
        groups = blocks(rows)
        assert [len(group.records) for group in groups] == [3, 1, 1, 1, 1]
        assert groups[0].records == (rows[0], rows[2], rows[6])
        older = fixed_61()
        del older["quadrature"]
        assert block_key(older) == block_key(fixed_61())

    def test_the_unit_of_cost_is_the_median_of_those_measured(self) -> None:
        times = (0.5, None, 0.1, 0.3, 0.0)
        rows = tuple(fixed_61(contact_time_s=time) for time in times)
        assert Block(rows).unit == 0.3
        assert Block(rows[1:2]).unit is None
        table = body(COST, Block(tuple(joint_61(wall_time_s=3.0, contact_time_s=t) for t in (0.1, 0.3, 0.5))))
        place = [column.head for column in COST].index("cost [contact solves]")
        assert [row[place] for row in table] == ["10", "10", "10"]
        unmeasured = body(COST, Block((joint_61(wall_time_s=3.0, contact_time_s=None), *rows)))
        assert unmeasured[0][place] == "-"

    def test_failures_are_neither_best_nor_counted_as_successes(self) -> None:
        low, failed = joint_61(energy_audited=-1.2), joint_61(energy_audited=-9.0, success=False)
        block = Block((failed, low, fixed_61(energy_audited=-1.1)))
        assert block.best is low
        assert len(block.succeeded) == 2
        assert Block((failed,)).best is None
        assert audited(fixed_61(energy=-3.0, energy_audited=None)) == -3.0
        assert audited(fixed_61(energy=-3.0, energy_audited=0.0)) == 0.0

    @pytest.mark.parametrize(
        ("changes", "is_paper"),
        [
            ({}, True),
            ({"n": "8x8"}, True),
            ({"n": "16"}, False),
            ({"delta": [0.0275, 0.1]}, False),
            ({"quadrature": 4}, False),
            ({"example": "mine"}, False),
            ({"example": "6.2", "n": "12x6", "delta": [0.15667, 0.07333]}, True),
            ({"example": "6.2", "n": "12", "delta": [0.15667, 0.07333]}, False),
        ],
    )
    def test_the_paper_s_values_are_for_the_paper_s_settings(
        self, changes: dict[str, Any], is_paper: bool
    ) -> None:
        block = Block((fixed_61(**changes),))
        assert (block.paper is not None) == is_paper
        rows = body(ENERGY, block)
        assert len(rows) == (3 if is_paper else 1)
        assert len(body(COST, block)) == 1
        if is_paper and not changes:
            given, relocated = rows[:2]
            assert given == ["paper, given grid", "-1.1246", "-", "-0.4549", "0.4753", "-"]
            assert relocated[:3] == ["paper, relocated", "-1.1246", "-1.4445"]

    def test_titles(self) -> None:
        assert Block((fixed_61(),)).title == "Example 6.1: n = 8, delta = 0.0275, midpoint rule"
        assert Block((fixed_61(quadrature=6, delta=None),)).title == (
            "Example 6.1: n = 8, delta = none, rule of degree 6"
        )
        assert delta_text({"relative": 0.3}) == "0.3 x shortest edge"
        assert delta_text([0.1, 0.25]) == "0.1 x 0.25"

    @pytest.mark.parametrize(
        ("changes", "text"),
        [
            ({"formulation": "mpcc"}, "mpcc"),
            ({"formulation": "mpcc", "start": "joint"}, "joint, certified as an MPCC solution"),
            ({"formulation": "mpcc", "start": "random"}, "mpcc"),
            ({"formulation": "nested", "start": "joint"}, "nested"),
            ({"formulation": "mpcc", "relaxation": "scholtes"}, "mpcc"),
            ({"formulation": "mpcc", "relaxation": "lin-fukushima"}, "mpcc, lin-fukushima"),
            ({"objective": "error-l2", "seed": 0}, "fixed, error-l2, seed 0"),
            ({"objective": "energy + 0.01*shape-size", "regularisation": 0.01}, "fixed, regularised"),
            ({"objective": "energy + 1*s", "regularisation": 1.0, "chosen_by": "auto"}, "auto (fixed)"),
            ({"objective": "energy + 1*quality"}, "fixed, energy + 1*quality"),
        ],
    )
    def test_labels(self, changes: dict[str, Any], text: str) -> None:
        assert label(fixed_61(**changes)) == text


def fields(friction: float, components: int = 2, upright: bool = False) -> Fields:
    """Three contact nodes out of order, and one that is none."""
    nodes = np.array([[2.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.1, 3.0]])
    nodes = nodes[::-1] if upright else nodes
    return Fields(
        nodes=nodes, initial=nodes, triangles=np.array([[0], [1], [2]]),
        displacement=np.zeros((components, 4)), pressure=np.array([20.0, 0.0, 10.0, 99.0]),
        tangential_stress=np.array([2.0, 0.0, -1.0, 99.0]),
        friction_bound=np.array([friction, friction, 2 * friction, 0.0]),
        contact=np.array([True, True, True, False]), foundation=nodes,
    )  # fmt: skip


class TestStresses:
    """Lines along the contact boundary, in the order of the nodes there."""

    def test_without_friction_there_is_one_axis(self) -> None:
        figure = stress_figure({"given grid": fields(0.0), "joint": fields(0.0)})
        (axis,) = figure.axes
        assert [line.get_label() for line in axis.lines] == ["given grid", "joint"]
        for line in axis.lines:
            np.testing.assert_array_equal(line.get_xydata(), [[0, 0], [1, 10], [2, 20]])
        assert axis.get_xlabel().startswith("$x_1$")
        assert axis.get_ylabel() == "contact stress"

    def test_with_friction_a_second_one_has_the_bounds(self) -> None:
        figure = stress_figure({"given grid": fields(3.0)})
        contact, tangential = figure.axes
        assert len(contact.lines) == 1
        drawn = [line.get_xydata().tolist() for line in tangential.lines]
        assert drawn[0] == [[0, 0], [1, -1], [2, 2]]
        assert drawn[1] == [[0, 3], [1, 6], [2, 3]]
        assert drawn[2] == [[0, -3], [1, -6], [2, -3]]
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.get_texts()] == ["given grid", "friction bound ±g"]
        assert figure.get_size_inches()[1] > stress_figure({"a": fields(0.0)}).get_size_inches()[1]

    def test_friction_of_a_single_node_or_of_a_later_curve_is_enough(self) -> None:
        smooth, rough = fields(0.0), fields(0.0)
        rough.friction_bound[2] = 1.0
        assert len(stress_figure({"a": smooth, "b": rough}).axes) == 2

    def test_an_upright_boundary_is_drawn_along_its_height(self) -> None:
        (axis,) = stress_figure({"a": fields(0.0, upright=True)}).axes
        np.testing.assert_array_equal(axis.lines[0].get_xydata()[:, 0], [0, 1, 2])
        assert axis.get_xlabel().startswith("$x_2$")

    def test_a_membrane_has_no_unit_of_stress(self) -> None:
        units = Units("m", "N")
        assert "[" not in stress_figure({"a": fields(0.0, 1)}, units).axes[0].get_ylabel()
        assert "[N/m²]" in stress_figure({"a": fields(0.0, 2)}, units).axes[0].get_ylabel()
