"""Values in problem files: each kind is checked by one small function that says what was expected.

An error is then one sentence rather than pydantic's list of all branches of a union.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from rmesh_nlp.expressions import Expression

LARGEST = 1e100
"""Numbers must be smaller than this, so that their squares are finite."""

FREE = "free"
"""Written in ``[dirichlet]`` for a component that is not given."""

SYMMETRY = "symmetry"
"""Written in ``[dirichlet]`` for a straight boundary whose nodes stay on it."""


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LARGEST:
        raise ValueError("expected a finite number")
    return float(value)


def _positive(value: Any) -> float:
    return _positive_or(value, "expected a positive number")


def _poisson(value: Any) -> float:
    number = _number_or(value, "expected a number between -1 and 0.5")
    if not -1 < number < 0.5:
        raise ValueError("expected a number between -1 and 0.5")
    return number


def _number_or(value: Any, message: str) -> float:
    try:
        return _number(value)
    except ValueError:
        raise ValueError(message) from None


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 10_000:
        raise ValueError("expected a whole number from 1 to 10000")
    return value


def _pair(value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("expected two numbers such as [0.0, 1.0]")
    return tuple(_number_or(v, "expected two numbers such as [0.0, 1.0]") for v in value)  # type: ignore[return-value]


def _triple(value: Any) -> tuple[float, float, float]:
    expected = "expected centre and radius such as [0.0, 0.0, 1.0]"
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(expected)
    x, y, radius = (_number_or(v, expected) for v in value)
    return x, y, _positive_or(radius, expected)


def _points(value: Any) -> list[tuple[float, float]]:
    if not isinstance(value, list) or len(value) < 2:
        raise ValueError("expected two or more points such as [[0, 0], [1, 0.1]]")
    return [_pair(point) for point in value]


def _coefficient(value: Any) -> Any:
    if isinstance(value, str):
        expression = Expression(value)
        if not expression.is_constant:
            return expression
        # a number after all: nodes held at it may slide, those held at a function may not
        value = float(expression(0.0, 0.0))
    return _number_or(value, "expected a finite number or an expression of x and y such as 'sin(pi*x)*y'")


def _condition(value: Any) -> Expression:
    if not isinstance(value, str):
        raise ValueError("expected a condition on x and y such as 'y == 1 and x > 2'")
    return Expression(value)


def _vector(value: Any) -> tuple[Any, ...]:
    items = value if isinstance(value, list) else [value]
    if not 1 <= len(items) <= 2:
        raise ValueError("expected one value, or two in a list, one per displacement component")
    return tuple(_coefficient(item) for item in items)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("expected true or false")
    return value


def _given(value: Any) -> Any:
    if value == SYMMETRY:
        return SYMMETRY
    items = value if isinstance(value, list) else [value]
    if not 1 <= len(items) <= 2:
        raise ValueError("expected one value, or two in a list, one per displacement component")
    return tuple(None if item == FREE else _coefficient(item) for item in items)


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("expected a text")
    return value


def _quadrature(value: Any) -> str | int:
    whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 50
    if value not in ("auto", "midpoint") and not whole:
        raise ValueError("expected 'auto', 'midpoint' or a degree from 1 to 50")
    return value


def _delta(value: Any) -> Any:
    expected = "expected a positive number, two of them, {relative = number} or 'none'"
    if value == "none":
        return None
    if isinstance(value, dict):
        if set(value) != {"relative"}:
            raise ValueError(expected)
        return {"relative": _positive_or(value["relative"], expected)}
    if isinstance(value, list):
        if len(value) != 2:
            raise ValueError(expected)
        return tuple(_positive_or(v, expected) for v in value)
    return _positive_or(value, expected)


def _positive_or(value: Any, message: str) -> float:
    number = _number_or(value, message)
    if number <= 0:
        raise ValueError(message)
    return number


def _places(value: Any) -> tuple[Any, ...]:
    good = isinstance(value, list) and all(
        isinstance(v, str) or (isinstance(v, int) and not isinstance(v, bool)) for v in value
    )
    if not good:
        raise ValueError("expected a list of boundary names and node numbers such as ['top', 17]")
    return tuple(value)


def _ties(value: Any) -> tuple[tuple[int, int], ...]:
    good = isinstance(value, list) and all(
        isinstance(v, list) and len(v) == 2 and all(type(k) is int for k in v) for v in value
    )
    if not good:
        raise ValueError("expected pairs of node numbers such as [[12, 40], [13, 41]]")
    return tuple((a, b) for a, b in value)


def _fraction(value: Any) -> float:
    number = _number_or(value, "expected a number between 0 and 1")
    if not 0 < number < 1:
        raise ValueError("expected a number between 0 and 1")
    return number


def _angle(value: Any) -> float:
    number = _number_or(value, "expected degrees from 0 to less than 60")
    if not 0 <= number < 60:
        raise ValueError("expected degrees from 0 to less than 60")
    return number


def _seed(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError("expected a whole number of at least 0")
    return value


def _weights(value: Any) -> tuple[float, ...]:
    """Positive weights, of which the last may be 0."""
    expected = (
        "expected a positive number, or a list of them such as [1, 0.1, 0.01], of which the last may be 0"
    )
    found = tuple(_number_or(v, expected) for v in (value if isinstance(value, list) else [value]))
    if not found or min(found) < 0 or 0 in found[:-1]:
        raise ValueError(expected)
    return found


def _levels(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 4:
        raise ValueError("expected a whole number from 0 to 4")
    return value


Flag = Annotated[Any, BeforeValidator(_flag)]
Finite = Annotated[Any, BeforeValidator(_number)]
Positive = Annotated[Any, BeforeValidator(_positive)]
Poisson = Annotated[Any, BeforeValidator(_poisson)]
Count = Annotated[Any, BeforeValidator(_count)]
Pair = Annotated[Any, BeforeValidator(_pair)]
Triple = Annotated[Any, BeforeValidator(_triple)]
Points = Annotated[Any, BeforeValidator(_points)]
Scalar = Annotated[Any, BeforeValidator(_coefficient)]
Condition = Annotated[Any, BeforeValidator(_condition)]
Vector = Annotated[Any, BeforeValidator(_vector)]
Given = Annotated[Any, BeforeValidator(_given)]
Text = Annotated[Any, BeforeValidator(_text)]
Delta = Annotated[Any, BeforeValidator(_delta)]
Places = Annotated[Any, BeforeValidator(_places)]
Ties = Annotated[Any, BeforeValidator(_ties)]
Fraction = Annotated[Any, BeforeValidator(_fraction)]
Angle = Annotated[Any, BeforeValidator(_angle)]
Seed = Annotated[Any, BeforeValidator(_seed)]
Weights = Annotated[Any, BeforeValidator(_weights)]
Levels = Annotated[Any, BeforeValidator(_levels)]
Quadrature = Annotated[Any, BeforeValidator(_quadrature)]
