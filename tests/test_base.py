"""What everything stands on: numbers that settings may be, tables for people, errors, names of units."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rmesh_nlp import display
from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.expressions import Expression
from rmesh_nlp.problem.units import Units, after, bracketed, units_of
from rmesh_nlp.settings import Number, check_positive


@pytest.mark.parametrize(
    ("number", "taken", "refused", "message"),
    [
        (Number(), [1e-300, 1, 1e300], [0, -1, math.inf, math.nan, True, "1", None], "positive and finite"),
        (Number(below=1.0), [0.999], [1.0, 2], "below 1"),
        (Number(above=1.0), [1.001], [1.0, 0.5], "above 1"),
        (Number(whole=True), [1, 10**9], [2.0], "a whole number"),
        (Number(whole=True, zero=True), [0, 3], [-1, math.inf, "0"], "finite and not negative"),
        (Number(infinite=True), [math.inf, 0.1], [0, -math.inf], "positive and finite"),
    ],
)
def test_numbers_of_settings(number: Number, taken: list, refused: list, message: str) -> None:
    for value in taken:
        number.check("it", value)
    for value in refused:
        with pytest.raises(BadInputError, match=f"it must be {message}, got ") as caught:
            number.check("it", value)
        assert str(caught.value).endswith(repr(value))


def test_none_stands_for_a_default() -> None:
    check_positive(a=None, b=1)
    with pytest.raises(BadInputError, match="c must be positive and finite, got 0"):
        check_positive(a=None, c=0)


def test_unknown_names_come_with_the_nearest() -> None:
    assert str(unknown("formulation", "jont", ["mpcc", "joint"])) == (
        "unknown formulation 'jont': did you mean joint? choose from mpcc, joint"
    )
    assert str(unknown("thing", "x", [])) == "unknown thing 'x': choose from none"


def test_tables_for_people() -> None:
    lines = display.plain_table("t" * 90, [("a", "b" * 100), ("cc", "d" * 74)]).splitlines()
    assert lines == ["t" * 80, f"  a   {'b' * 71}...", f"  cc  {'d' * 74}"]
    assert display.html_table("<t>", [("a", "&")]) == (
        "<table><caption>&lt;t&gt;</caption><tr><th>a</th><td>&amp;</td></tr></table>"
    )


@pytest.mark.parametrize(
    ("value", "text"), [(1 / 3, "0.333333"), (None, "free"), (Expression("x*y"), "x*y"), (abs, "f(x, y)")]
)
def test_coefficients_in_words(value: Any, text: str) -> None:
    assert display.describe(value) == text


def test_no_spreadsheet_runs_a_text() -> None:
    for text in ("=1", "+1", "-1", "@a", "\t=1", "＝1"):
        assert display.for_spreadsheet(text) == f"'{text}"
    assert [display.for_spreadsheet(value) for value in ("a=1", 3, None)] == ["a=1", 3, None]


def test_units_are_named_where_they_are_known() -> None:
    assert [Units("mm", "N").stress, Units("mm").stress, Units("", "N").stress] == ["N/mm²", "", ""]
    assert units_of({"length": "m", "force": None}) == Units("m")
    assert units_of("nonsense") == Units()
    assert [bracketed("m"), bracketed(""), after("m"), after("")] == [" [m]", "", " m", ""]
