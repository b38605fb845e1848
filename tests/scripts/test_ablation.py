"""The ablation switches off what it names, puts it back, and counts failures as failures."""

from __future__ import annotations

import importlib

import pytest

import ablation


@pytest.mark.parametrize("rule", ablation.RULES, ids=lambda rule: rule.name)
def test_every_rule_that_is_named_exists_and_is_put_back(rule: ablation.Rule) -> None:
    places = {place: place.split(":") for place in rule.values}
    before = {
        place: getattr(importlib.import_module(module), name) for place, (module, name) in places.items()
    }
    with ablation.without(rule):
        for place, (module, name) in places.items():
            assert getattr(importlib.import_module(module), name) is rule.values[place]
    for place, (module, name) in places.items():
        assert getattr(importlib.import_module(module), name) is before[place]
    assert rule.values or rule.settings


def test_table_has_gains_failures_and_cost() -> None:
    rule = ablation.RULES[0]
    good = {"success": True, "status": "converged", "gain": 2.0, "cost": 10}
    rows = {
        ("as it is", "joint", "a"): good,
        ("as it is", "joint", "b"): good,
        ("as it is", "joint", "c"): good,
        (rule.name, "joint", "a"): {**good, "gain": 1.0, "cost": 30},
        (rule.name, "joint", "b"): good,
        (rule.name, "joint", "c"): {**good, "success": False, "status": "worse"},
    }
    assert (
        ablation.table(rows).splitlines()[-1] == f"| {rule.name} | 3 | 0.7500 | 0.500 | 1, 0 | 1, 0 | 2.00 |"
    )
