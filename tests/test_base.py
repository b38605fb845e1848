"""What everything stands on: numbers and formulas of settings, tables for people, errors, units."""

import math
import re

import numpy as np
import pytest

from rmesh_nlp import display
from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.evaluation import difference
from rmesh_nlp.expressions import Expression
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.problem.units import Units, after, bracketed, units_of
from rmesh_nlp.settings import Number, check_positive


@pytest.mark.parametrize(
    ("a", "b", "wanted"),
    [
        (0.1 + 3e-17, 0.1, 0.0),
        (-1e6, -1e6 - 1e-4, 0.0),
        (1e-300, 0.0, 1e-300),
        (-1.0, -1.0 - 2e-9, 2e-9),
        (math.inf, 1.0, math.inf),
    ],
)
def test_a_difference_within_rounding_is_none(a: float, b: float, wanted: float) -> None:
    assert difference(a, b) == pytest.approx(wanted, rel=1e-6, abs=0)
    assert math.isnan(difference(a, math.nan))


@pytest.mark.parametrize(
    ("number", "taken", "refused", "message"),
    [
        (Number(), [1e-300, 1, 1e300], [0, -1, math.inf, math.nan, True, "1", None], "positive and finite"),
        (Number(below=1.0), [0.999], [1.0, 2], "below 1"),
        (Number(above=1.0), [1.001], [1.0, 0.5], "above 1"),
        (Number(least=1), [1, 10**9], [2.0], "a whole number of at least 1"),
        (Number(least=0), [0, 3], [-1, math.inf, "0"], "a whole number of at least 0"),
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
    check_positive(a=1e-9, b=1)


def test_unknown_names_come_with_the_nearest() -> None:
    assert str(unknown("formulation", "jont", ["mpcc", "joint"])) == (
        "unknown formulation 'jont': did you mean joint? choose from mpcc, joint"
    )
    assert str(unknown("thing", "x", [])) == "unknown thing 'x': choose from none"


def test_tables_for_people() -> None:
    lines = display.plain_table("t" * 90, [("a", "b" * 100), ("cc", "d" * 74)]).splitlines()
    assert lines == ["t" * 90, f"  a   {'b' * 74}", f"      {'b' * 26}", f"  cc  {'d' * 74}"]
    assert display.html_table("<t>", [("a", "&")]) == (
        "<table><caption>&lt;t&gt;</caption><tr><th>a</th><td>&amp;</td></tr></table>"
    )


@pytest.mark.parametrize(
    ("value", "text"), [(1 / 3, "0.333333"), (None, "free"), (Expression("x*y"), "x*y"), (abs, "f(x, y)")]
)
def test_coefficients_in_words(value, text):
    assert display.describe(value) == text


def test_no_spreadsheet_runs_a_text() -> None:
    for text in ("=1", "+1", "-1", "@a", "\t=1", "＝1"):
        assert display.for_spreadsheet(text) == f"'{text}"
    assert [display.for_spreadsheet(value) for value in ("a=1", 3, None)] == ["a=1", 3, None]


def test_units_are_named_where_they_are_known() -> None:
    assert [Units("mm", "N").stress, Units("mm").stress, Units("", "N").stress] == ["N/mm²", "", ""]
    assert units_of({"units": {"length": "m"}}) == Units("m")
    assert units_of({"units": None}) == units_of({}) == Units()
    assert [bracketed("m"), bracketed(""), after("m"), after("")] == [" [m]", "", " m", ""]


FORBIDDEN = [
    "__import__('os')", "x.real", "[x]", "lambda: 1", "'a'", "True", "1j", "f'{x}'", "sin(*[x])",
    "x if y else 1", "x in y", "x @ y", "x; y", "", "(" * 500, "-" * 5000 + "x", "sin(x=1)",
    "x := 1", "9" * 999, "x\0", "sin", "1 + x^2",
]  # fmt: skip


@pytest.mark.parametrize("text", FORBIDDEN)
def test_nothing_but_arithmetic_is_let_through(text: str) -> None:
    with pytest.raises(ValueError, match=r"not allowed|not an expression|too long|unknown|\*\*, not \^"):
        Expression(text)


def test_values_are_those_of_numpy() -> None:
    points = np.array([[0.0, 0.3, 1.0], [2.0, 0.5, -1.0]])
    x, y = points
    chosen = np.where((x < 0.5) & (y <= 1), np.hypot(x, y), -np.maximum(x, y))
    for text, expected in [
        ("sin(2*pi*x)*y - x**2/3", np.sin(2 * np.pi * x) * y - x**2 / 3),
        ("where(x < 0.5 and not y > 1, hypot(x, y), -max(x, y))", chosen),
        ("0 < x <= 1", (x > 0) & (x <= 1)),
        ("x >= 0.3", x >= 0.3),
        ("+x - -y", x + y),
        ("atan2(y, x) + min(x, y)*abs(y)", np.arctan2(y, x) + np.minimum(x, y) * np.abs(y)),
        ("tan(x) + asin(x) + acos(x) + atan(y)", np.tan(x) + np.arcsin(x) + np.arccos(x) + np.arctan(y)),
        ("sinh(x) + cosh(y) + tanh(y) + cos(y)", np.sinh(x) + np.cosh(y) + np.tanh(y) + np.cos(y)),
        ("exp(y) + log(x + 1) + sqrt(x) + 1e5", np.exp(y) + np.log(x + 1) + np.sqrt(x) + 1e5),
        ("x == 0.1 + 0.2 or y != 0.5", (x == 0.3) | (y != 0.5)),
    ]:
        np.testing.assert_allclose(on_points(Expression(text), points), expected, rtol=1e-14, atol=1e-15)
    points = np.array([[0.5, -1.0], [0, 0]])
    assert np.all(np.isfinite(on_points(Expression("where(x > 0, 1/(x + 1), 1)"), points)))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("where(x > 0, 1/0, 1)", "1 / 0"),
        ("x*log(0)", "log(0)"),
        ("y + sqrt(2 - 3)", "sqrt(2 - 3)"),
        ("where(x > 0, x/(2 - 2), 1)", "x / (2 - 2)"),
        ("9**9**9**9", "9 ** 9 ** 9"),  # at once: whole numbers are floats
    ],
)
def test_part_that_is_finite_nowhere_is_named(text: str, part: str) -> None:
    with pytest.raises(ValueError, match=rf"'{re.escape(part)}' is not a finite number"):
        Expression(text)
