"""The kinds of values in problem files: what may stand there, and one sentence for what may not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

import casadi as ca
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from rmesh_nlp.expressions import Expression
from rmesh_nlp.problem.design import RESERVED, symbol

LARGEST = 1e100  # numbers must be smaller than this, so that their squares are finite
FREE = "free"  # written in ``[dirichlet]`` for a component that is not given
SYMMETRY = "symmetry"  # written in ``[dirichlet]`` for a straight boundary whose nodes stay on it


def expected(text: str) -> WrapValidator:
    """One sentence in the place of all that pydantic has to say; a message of our own goes first."""

    def check(value: Any, read: ValidatorFunctionWrapHandler) -> Any:
        try:
            return read(value)
        except ValidationError as error:
            own = str(error.errors()[0].get("ctx", {}).get("error", ""))
            raise ValueError(own or f"expected {text}") from None

    return WrapValidator(check)


Value: TypeAlias = float | ca.SX | Expression
"""A number, an expression of design variables, or one of position."""


def design_names(data: Mapping[str, Any]) -> dict[str, ca.SX]:
    """Symbols of the design variables that a file declares, before it is checked."""
    design = data.get("design")
    found = [*design, *(design.get("shapes") or ())] if isinstance(design, dict) else []
    return {name: symbol(name) for name in found if name.isidentifier() and name not in ("shapes", *RESERVED)}


def _coefficient(value: Any, info: ValidationInfo) -> Value:
    if isinstance(value, str):
        expression = Expression(value, info.context or {})
        if expression.value is None:
            return expression
        if not expression.value.is_constant():
            return expression.value
        # a number after all: nodes fixed at it may slide, those fixed at a function may not
        value = float(expression.value)
    if type(value) in (int, float) and -LARGEST < value < LARGEST:
        return float(value)
    raise ValueError("expected a finite number or an expression of x and y such as 'sin(pi*x)*y'")


def _number(value: Any, info: ValidationInfo) -> Any:
    """An expression of design variables in the place of a number, or what stands there."""
    if not isinstance(value, str) or not info.context:
        return value
    expression = Expression(value, info.context)
    if expression.value is None:
        raise ValueError("expected a number or an expression of design variables alone")
    return float(expression.value) if expression.value.is_constant() else expression.value


def _designed(value: Any, read: ValidatorFunctionWrapHandler) -> Any:
    """An expression of design variables as it is; anything else as its kind of number."""
    return value if isinstance(value, ca.SX) else read(value)


def _components(value: Any, info: ValidationInfo) -> tuple[Value | None, ...]:
    """One or two; in ``[dirichlet]`` one may be free."""
    items = value if isinstance(value, list) else [value]
    if not 1 <= len(items) <= 2:
        raise ValueError
    return tuple(None if item is None else _coefficient(item, info) for item in items)


def _given(value: Any, info: ValidationInfo) -> str | tuple[Value | None, ...]:
    if value == SYMMETRY:
        return SYMMETRY
    items = value if isinstance(value, list) else [value]
    return _components([None if item == FREE else item for item in items], info)


def _condition(value: Any) -> Expression:
    if not isinstance(value, str):
        raise ValueError
    return Expression(value)


def as_list(value: Any) -> Any:
    """One for a list of one: ``[contact]`` for ``[[contact]]``, a weight for a schedule."""
    return value if isinstance(value, list) else [value]


def _weights(values: tuple[float, ...]) -> tuple[float, ...]:
    if 0 in values[:-1]:
        raise ValueError
    return values


POSITIVE_OR_LIST = "a positive number, or a list of them such as [1, 0.1, 0.01], of which the last may be 0"
ONE_OR_TWO = "one value, or two in a list, one per displacement component"

_Real = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
_Above0 = Annotated[_Real, Field(gt=0)]
_Whole = Annotated[int, Field(strict=True)]
_Two = tuple[_Real, _Real]
_Relative = Annotated[dict[Literal["relative"], _Above0], Field(min_length=1)]

Flag = Annotated[bool, Field(strict=True), expected("true or false")]
Remesh = Annotated[
    Annotated[bool, Field(strict=True)] | Annotated[int, Field(strict=True, ge=3)],
    expected("true, or the number of nodes of the new mesh, 3 or more"),
]
Finite = Annotated[_Real, expected("a finite number")]
Positive = Annotated[_Above0, expected("a positive number")]
Poisson = Annotated[_Real, Field(gt=-1, lt=0.5), expected("a number between -1 and 0.5")]
Fraction = Annotated[_Real, Field(gt=0, lt=1), expected("a number between 0 and 1")]
Angle = Annotated[_Real, Field(ge=0, lt=60), expected("degrees from 0 to less than 60")]
Count = Annotated[_Whole, Field(ge=1, le=10_000), expected("a whole number from 1 to 10000")]
Seed = Annotated[_Whole, Field(ge=0), expected("a whole number of at least 0")]
Text = Annotated[str, Field(strict=True, pattern=r"\S"), expected("a text")]
Pair = Annotated[_Two, expected("two numbers such as [0.0, 1.0]")]
Limits = Annotated[
    tuple[Annotated[float, Field(strict=True, allow_inf_nan=True)], Annotated[float, Field(strict=True)]],
    expected("least and largest value such as [0.0, 2.5]; -inf or inf for none"),
]
DesignedFinite = Annotated[Finite, WrapValidator(_designed), BeforeValidator(_number)]
DesignedPositive = Annotated[Positive, WrapValidator(_designed), BeforeValidator(_number)]
DesignedPoisson = Annotated[Poisson, WrapValidator(_designed), BeforeValidator(_number)]
DesignedPair = Annotated[tuple[DesignedFinite, DesignedFinite], expected("two numbers such as [0.0, 1.0]")]
Triple = Annotated[tuple[_Real, _Real, _Above0], expected("centre and radius such as [0.0, 0.0, 1.0]")]
Points = Annotated[
    list[_Two], Field(min_length=2), expected("points such as [[0, 0], [1, 0.1]], two or more")
]
Scalar = Annotated[Any, BeforeValidator(_coefficient), expected("a number or an expression")]
Vector = Annotated[Any, BeforeValidator(_components), expected(ONE_OR_TWO)]
Given = Annotated[Any, BeforeValidator(_given), expected(ONE_OR_TWO)]
Condition = Annotated[
    Any, BeforeValidator(_condition), expected("a condition on x and y such as 'y == 1 and x > 2'")
]
Order = Annotated[
    Annotated[_Whole, Field(ge=1, le=2)], expected("1 for linear displacements or 2 for quadratic ones")
]
Quadrature = Annotated[
    Literal["auto", "midpoint"] | Annotated[_Whole, Field(ge=1, le=50)],
    expected("'auto', 'midpoint' or a degree from 1 to 50"),
]
Delta = Annotated[
    Annotated[_Real, Field(ge=0)]
    | tuple[_Above0, _Above0]
    | Annotated[dict[Literal["relative"], _Above0], Field(min_length=1)]
    | None,
    BeforeValidator(lambda value: None if value == "none" else value),
    expected("a positive number, two of them, 0, {relative = number} or 'none'"),
]
Places = Annotated[
    tuple[Annotated[str, Field(strict=True)] | _Whole, ...],
    expected("a list of boundary names and node numbers such as ['top', 17]"),
]
Ties = Annotated[
    tuple[tuple[_Whole, _Whole], ...], expected("pairs of node numbers such as [[12, 40], [13, 41]]")
]
Weights = Annotated[
    tuple[Annotated[_Real, Field(ge=0)], ...],
    Field(min_length=1),
    BeforeValidator(as_list),
    AfterValidator(_weights),
    expected(POSITIVE_OR_LIST),
]
