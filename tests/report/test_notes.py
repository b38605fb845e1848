"""What is said below the tables: the paper's printed energies, and what failed."""

from __future__ import annotations

from typing import Any

import pytest

from rmesh_nlp.report.notes import detailed_notes, main_notes, stopped_early, units_notes
from rmesh_nlp.report.tables import markdown
from support.table_rows import ROWS, record


def test_the_note_says_what_is_not_reached_and_what_failed() -> None:
    text = [*main_notes(ROWS), *detailed_notes(ROWS)]
    assert "Example 6.2: printed initial energy -4.8541: met, here -4.854190." in text
    (final,) = [note for note in text if "printed final energy" in note]
    assert final.startswith(
        "Example 6.2: printed final energy -4.9188 is NOT reached: the lowest here is -4.910330 (joint). "
    )
    assert "6.2, mpcc: failed: RuntimeError: 100% & more_" in text


@pytest.mark.parametrize(
    ("energy", "said"),
    [
        (-4.91879, "is NOT reached"),  # truncated, not rounded, it would be printed as -4.9187
        (-4.91889, "is met"),
        (-4.9189, "is passed"),
    ],
)
def test_the_note_follows_the_records_and_truncates(energy: float, said: str) -> None:
    (final,) = [note for note in detailed_notes([record(energy=energy)]) if "printed final energy" in note]
    assert said in final


def test_an_unmet_initial_energy_is_said() -> None:
    text = detailed_notes([record(energy_initial=-4.85409)])
    assert "Example 6.2: printed initial energy -4.8541: NOT met, here -4.854090." in text


def test_a_problem_of_ones_own_has_nothing_to_do_with_the_paper() -> None:
    rows = [record(example="mine", n="144 triangles")]
    text = markdown(rows)
    assert "### Problem mine: 144 triangles, delta = " in text
    assert "Example" not in text
    assert "paper" not in text


@pytest.mark.parametrize("changes", [{"n": "24x12"}, {"delta": [0.2, 0.07333]}, {"quadrature": 6}])
def test_other_settings_are_not_compared(changes: dict[str, Any]) -> None:
    rows = [record(**changes)]
    assert any("not the paper's settings" in note for note in detailed_notes(rows))
    assert "paper, given grid" not in markdown(rows)


def test_extremes_of_61_are_compared() -> None:
    common = {"example": "6.1", "n": "8", "delta": [0.0275, 0.0275], "energy_initial": -1.124602}
    rows = [
        record(**common, formulation="fixed", energy=-1.124602, u_min=-0.454855, u_max=0.475281),
        record(**common, energy=-1.475161, u_min=-0.5228, u_max=0.5266),
    ]
    text = "\n".join(detailed_notes(rows))
    assert "extremes -0.4549, 0.4753 on the given grid: met, here -0.45486, 0.47528." in text
    assert "final energy -1.4445 is passed: the lowest here is -1.475161 (joint)." in text
    assert "here -0.5228, 0.5266 (joint)" in text
    rows[0]["u_max"] = 0.4755
    assert "on the given grid: NOT met" in "\n".join(detailed_notes(rows))


def test_a_success_that_is_not_stationary_is_explained() -> None:
    early = record(status="iteration_limit")
    (said,) = [note for note in main_notes([record(), early]) if note.startswith("iteration_limit")]
    assert said.endswith("valid and not worse than the given mesh, but not stationary to the tolerance.")
    assert not stopped_early([record(), record(status="iteration_limit", success=False)])


def test_units_of_several_examples_are_named_once() -> None:
    units = {"length": "m", "force": "N"}
    rows = [record(units=units), record(example="6.3", units=units), record(example="6.1", units={})]
    assert units_notes(rows) == ["Example 6.2, Example 6.3: u in m, J in N, the energy per m of depth."]


@pytest.mark.parametrize(("counted", "said"), [([0, 0], True), ([0, 1], False), ([None, None], False)])
def test_missing_stick_zone_is_said(counted: list[int | None], said: bool) -> None:
    text = "\n".join(detailed_notes([record(sticking_nodes=number) for number in counted]))
    assert ("there is no stick zone" in text) is said
