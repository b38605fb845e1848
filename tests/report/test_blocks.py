"""Records of one example on one grid with the same move limits and rule, and their names."""

from __future__ import annotations

from typing import Any

import pytest

from rmesh_nlp.report.blocks import Block, audited, block_key, blocks, delta_text, label, names_of_solves
from rmesh_nlp.report.columns import COSTS, ENERGIES, body
from support.reporting import designed, fixed_61, joint_61, joint_62


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


def test_unit_of_cost_is_the_median_of_those_measured() -> None:
    rows = tuple(fixed_61(contact_time_s=time) for time in (0.5, None, 0.1, 0.3, 0.0))
    assert Block(rows).unit == 0.3
    assert Block(rows[1:2]).unit is None
    costs = [
        row[-1]
        for row in body(
            COSTS, Block(tuple(joint_61(wall_time_s=3.0, contact_time_s=t) for t in (0.1, 0.3, 0.5)))
        )
    ]
    assert costs == ["10", "10", "10"]
    unmeasured = body(COSTS, Block((joint_61(wall_time_s=3.0, contact_time_s=None), *rows)))
    assert unmeasured[0][-1] == "-"


def test_failures_are_neither_best_nor_successes() -> None:
    low, bad = joint_61(energy_audited=-1.2), joint_61(energy_audited=-9.0, success=False)
    block = Block((bad, low, fixed_61(energy_audited=-1.1)))
    assert block.best is low
    assert len(block.succeeded) == 2
    assert Block((bad,)).best is None
    assert audited(fixed_61(energy=-3.0, energy_audited=None)) == -3.0
    assert audited(fixed_61(energy=-3.0, energy_audited=0.0)) == 0.0


@pytest.mark.parametrize(
    ("changes", "is_paper"),
    [
        ({}, True),
        ({"n": "8x8"}, True),
        ({"delta": [0.0275, 0.1]}, False),
        ({"order": 2}, False),
        ({"example": "mine"}, False),
        ({"example": "6.2", "n": "12x6", "delta": [0.15667, 0.07333]}, True),
    ],
)
def test_values_of_the_paper_are_for_its_settings(changes: dict[str, Any], is_paper: bool) -> None:
    block = Block((fixed_61(**changes),))
    assert (block.paper is not None) == is_paper
    rows = body(ENERGIES, block)
    assert len(rows) == (3 if is_paper else 1)
    assert len(body(COSTS, block)) == 1
    if not changes:
        assert rows[0] == ["paper, given grid", "-1.1246", "-", "-0.4549", "0.4753", "-"]
        assert rows[1][:3] == ["paper, relocated", "-1.1246", "-1.4445"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"formulation": "mpcc", "start": "joint"}, "joint, certified as an MPCC solution"),
        ({"formulation": "mpcc", "start": "random"}, "mpcc"),
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
    assert Block((fixed_61(),)).title == "Example 6.1: n = 8, delta = 0.0275, midpoint rule"
    rule = Block((fixed_61(quadrature=6, delta=None),))
    assert rule.title == "Example 6.1: n = 8, delta = none, rule of degree 6"
    quadratic = fixed_61(order=2)
    assert Block((quadratic,)).title == "Example 6.1: n = 8, order 2, delta = 0.0275, midpoint rule"
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


def test_the_best_of_one_other_objective_has_its_lowest_value() -> None:
    one, two = designed(), designed(objective_value=5e-4, energy_audited=9.0)
    assert Block((one, two)).best is two
    assert Block((one, {**two, "objective_value": None})).best is one
    energies = joint_62(), joint_62(energy_audited=-5.0)
    assert Block(energies).best is energies[1]
