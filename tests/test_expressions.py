"""Formulas in files: nothing but arithmetic is let through, and they mean what they say."""

import re

import numpy as np
import pytest

from rmesh_nlp.expressions import Expression

FORBIDDEN = [
    "__import__('os')", "x.real", "[x]", "lambda: 1", "'a'", "True", "1j", "f'{x}'", "sin(*[x])",
    "x if y else 1", "x in y", "x @ y", "x; y", "", "(" * 500, "-" * 5000 + "x", "sin(x=1)",
    "x := 1", "9" * 999, "x\0", "sin",
]  # fmt: skip


@pytest.mark.parametrize("text", FORBIDDEN)
def test_nothing_but_arithmetic_is_let_through(text: str) -> None:
    with pytest.raises(ValueError, match=r"not allowed|not an expression|too long|unknown"):
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
        np.testing.assert_allclose(Expression(text).on(points), expected, rtol=1e-14, atol=1e-15)


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


def test_branch_with_a_pole_elsewhere_is_allowed() -> None:
    points = np.array([[0.5, -1.0], [0, 0]])
    assert np.all(np.isfinite(Expression("where(x > 0, 1/(x + 1), 1)").on(points)))


def test_powers_are_written_with_stars() -> None:
    with pytest.raises(ValueError, match=r"powers are written with \*\*, not \^"):
        Expression("1 + x^2")
