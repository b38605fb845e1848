"""Profiles against ones computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rmesh_nlp.report.histories import cost_of_gain
from rmesh_nlp.report.profiles import (
    data_profiles,
    performance_profiles,
    quality_profiles,
)

INF = float("inf")


def test_a_performance_profile_computed_by_hand() -> None:
    # ratios of a: 1, 2, 1, inf, fails; of b: 2, 1, 3, 1, fails
    profiles = performance_profiles({"a": [10, 40, 5, INF, INF], "b": [20, 20, 15, 7, INF]})
    assert profiles["a"]([0.99, 1, 1.9, 2, 100]).tolist() == [0, 0.4, 0.4, 0.6, 0.6]
    assert profiles["b"]([1, 2, 2.9, 3, 100]).tolist() == [0.4, 0.6, 0.6, 0.8, 0.8]


def test_a_cost_of_zero_is_the_cheapest_and_no_division() -> None:
    profiles = performance_profiles({"a": [0.0, 0.0], "b": [0.0, 3.0]})
    assert profiles["a"](1) == 1.0
    assert profiles["b"]([1, 1e9]).tolist() == [0.5, 0.5]


def test_a_formulation_that_fails_everywhere_never_rises() -> None:
    profile = performance_profiles({"a": [INF, INF], "b": [1.0, 2.0]})["a"]
    assert profile([1, 1e300]).tolist() == [0, 0]
    assert profile.at.shape == profile.share.shape


def test_a_data_profile_computed_by_hand() -> None:
    profiles = data_profiles({"a": [1, 10, 100, INF]})
    assert profiles["a"]([0, 1, 9, 10, 99, 100, 1e9]).tolist() == [0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75]


def test_a_quality_profile_computed_by_hand() -> None:
    # best gains 10 and 4; b misses 10 % of the first and fails the second; c gains nothing
    energies = {"a": [-10.0, -4.0], "b": [-9.0, INF], "c": [0.0, 0.0]}
    profiles = quality_profiles(energies, [0.0, 0.0])
    assert profiles["a"](0) == 1.0
    assert profiles["b"]([0.09, 0.1, 1]).tolist() == [0, 0.5, 0.5]
    assert profiles["c"]([0.99, 1.0]).tolist() == [0, 1]


def test_the_cost_of_a_part_of_the_gain() -> None:
    energy, cost = [0.0, -5.0, np.nan, -9.0, -10.0], [1, 2, 3, 4, 5]
    assert cost_of_gain(energy, cost, 0.0, -10.0, 0.5) == 2
    assert cost_of_gain(energy, cost, 0.0, -10.0, 0.9) == 4
    assert cost_of_gain(energy, cost, 0.0, -11.0, 0.99) == INF


@pytest.mark.parametrize("costs", [{"a": [1.0], "b": [1.0, 2.0]}, {"a": [-1.0]}, {"a": [np.nan]}])
def test_what_is_no_table_of_costs_is_refused(costs: dict) -> None:
    with pytest.raises(ValueError, match=r"every formulation|negative|inhomogeneous"):
        performance_profiles(costs)
