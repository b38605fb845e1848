"""Entries of a record: which are written, under which names, and what they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.solving.parts import (
    Certificate,
    Choices,
    Step,
    Work,
    entries,
    plain,
)
from support.endings import Own

NAN = float("nan")


@pytest.mark.parametrize(
    ("value", "expected"),
    [(np.int64(3), 3), (np.bool_(True), True), (np.nan, None), (-np.inf, None), (np.float64(np.inf), None),
     ("x", "x"), (0.5, 0.5), (0, 0)],
)  # fmt: skip
def test_values_become_plain(value: Any, expected: Any) -> None:
    assert (plain(value), type(plain(value))) == (expected, type(expected))


def test_what_is_not_known_is_written_only_where_it_has_no_default() -> None:
    assert Choices().record() == {}
    assert Choices(safe="s", chosen="c").record() == {"safe": "s", "chosen": "c"}
    assert entries(Own(1), None, Choices(safe="s"), Own(2)) == {"own": 2, "safe": "s"}


def test_work_is_added_up_and_contact_solves_stand_in_the_record_already() -> None:
    total = Work(1, 1, 5) + Work(2, 3, 0, 7)
    assert total == Work(3, 4, 5, 7) + Work()
    assert total.record() == {"cold_contact_solves": 4, "contact_factorisations": 5, "kkt_factorisations": 7}
    assert Work(8, 0, 1).record() == {"contact_factorisations": 1}


def test_histories_are_plain_and_keep_an_infinite_t() -> None:
    step = Step(3, -1.0, float("inf"), 0.0, NAN, 7, 0.25, np.ones(2), product=0.5)
    row = {"iteration": 3, "energy": -1.0, "t": float("inf"), "primal_residual": 0.0, "dual_residual": None}
    row |= {"contact_solves": 7, "seconds": 0.25, "product": 0.5}
    unknown = ("objective", "biactive", "stationarity", "energy_given")
    assert step.row() == row | dict.fromkeys(unknown)
    assert replace(step, t=NAN).row()["t"] is None
    assert replace(step, design={"E": 2.0}).row() == step.row() | {"design.E": 2.0}
    assert "q=" not in repr(step)  # thousands of numbers


CERTIFIED = Certificate(
    lower=-3.0, upper=-2.0, error_bound_initial=2.0, error_bound=1.0, relative_initial=0.5, relative=0.125,
    guaranteed_lower=True, guaranteed_upper=True, guaranteed_initial=True, why="because",
    local=np.zeros(1), local_initial=np.zeros(1), field=np.zeros((2, 1)), residual=0.0,
)  # fmt: skip
KNOWN = ("guaranteed_lower", "guaranteed_upper", "guaranteed_initial")


@pytest.mark.parametrize("lacks", [None, *KNOWN])
def test_a_certificate_tells_its_bounds_and_whether_they_are_ones(lacks: str | None) -> None:
    found = CERTIFIED if lacks is None else replace(CERTIFIED, **{lacks: False})
    word = "at most" if lacks is None else "estimated at"
    assert found.sentence == f"error in the energy norm {word} 50 % before, 12.5 % after"
    claim = ErrorReduction((1, 2), (1, 2), 1, 2, "refinement", 9, 3)
    proved = found.of_reduction(claim)
    if lacks is None:  # half the squares of 2 and 1
        assert (proved.source, proved.factor) == ("certified", 4.0)
        assert (proved.error_initial, proved.error) == ((1.5, 2.0), (0.0, 0.5))
    else:
        assert proved == claim


@pytest.mark.parametrize(
    ("upper", "proved", "disproved"), [(-3.5, True, True), (-3.5, False, False), (-3.0, True, False)]
)
def test_an_energy_below_a_proven_bound_is_not_admissible(
    upper: float, proved: bool, disproved: bool
) -> None:
    found = replace(CERTIFIED, upper=upper, guaranteed_lower=proved)
    assert found.is_disproved is disproved
    assert ("-3.5 lies below the proven bound -3," in found.sentence) is disproved
