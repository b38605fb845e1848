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
from rmesh_nlp.fem.objective_text import beside, parse_objective
from rmesh_nlp.io.problem_messages import Source
from rmesh_nlp.problem import Coefficient, Relative
from rmesh_nlp.problem.motion import Where

LARGEST = 1e100  # numbers must be smaller than this, so that their squares are finite
FREE = "free"  # written in ``[dirichlet]`` for a component that is not given
SYMMETRY = "symmetry"  # written in ``[dirichlet]`` for a straight boundary whose nodes stay on it


def expected(text: str) -> WrapValidator:
    """One sentence in the place of all that pydantic has to say; a message of our own goes first."""

    def check(value: object, read: ValidatorFunctionWrapHandler) -> object:
        try:
            return read(value)
        except ValidationError as error:
            own = (str(item["ctx"]["error"]) for item in error.errors() if item["type"] == "value_error")
            raise ValueError(next(own, f"expected {text}")) from None

    return WrapValidator(check)


def source_of(info: ValidationInfo) -> Source:
    """The file that a value stands in."""
    assert isinstance(info.context, Source)
    return info.context


Value: TypeAlias = float | ca.SX | Expression
"""A number, an expression of design variables, or one of position."""


def _coefficient(value: Any, info: ValidationInfo) -> Value:
    if isinstance(value, str):
        expression = Expression(value, source_of(info).symbols)
        if expression.value is None:
            return expression
        if not expression.value.is_constant():
            return expression.value
        # a number after all: nodes fixed at it may slide, those fixed at a function may not
        value = float(expression.value)
    if type(value) in (int, float) and -LARGEST < value < LARGEST:
        return float(value)
    raise ValueError("expected a finite number or an expression of x and y such as 'sin(pi*x)*y'")


def _designed(value: object, read: ValidatorFunctionWrapHandler, info: ValidationInfo) -> float | ca.SX:
    """A number, or where there are design variables an expression of them."""
    if not isinstance(value, str) or not source_of(info).symbols:
        return float(read(value))
    number = _coefficient(value, info)
    if isinstance(number, Expression):
        raise ValueError("expected a number or an expression of design variables alone")
    return number


def _given(value: object, read: ValidatorFunctionWrapHandler) -> object:
    """A component may be free; a word stands for those of a boundary on an axis."""
    return SYMMETRY if value == SYMMETRY else read([None if v == FREE else v for v in as_list(value)])


def _objective(text: str, info: ValidationInfo) -> str:
    """The text of an objective that can be read, whose files are beside the file that it stands in."""
    parse_objective(text)
    return beside(text, source_of(info).path.parent)


def as_list(value: object) -> list[object]:
    """One for a list of one: ``[contact]`` for ``[[contact]]``."""
    return value if isinstance(value, list) else [value]


PAIR = "two numbers such as [0.0, 1.0]"
COMPONENTS = "one value, or two in a list, one per displacement component"

_Real = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
_Whole = Annotated[int, Field(strict=True)]
_Two = tuple[_Real, _Real]
_Relative = Annotated[
    dict[Literal["relative"], _Real],
    Field(min_length=1),
    AfterValidator(lambda value: Relative(value["relative"])),
]

Flag = Annotated[bool, Field(strict=True), expected("true or false")]
Finite = Annotated[_Real, expected("a finite number")]
Whole = Annotated[_Whole, expected("a whole number")]
Seed = Annotated[_Whole, Field(ge=0), expected("a whole number of at least 0")]
Text = Annotated[str, Field(strict=True, pattern=r"\S"), expected("a text")]
ObjectiveText = Annotated[Text, AfterValidator(_objective)]
Pair = Annotated[_Two, expected(PAIR)]
Limits = Annotated[
    tuple[Annotated[float, Field(strict=True, allow_inf_nan=True)], Annotated[float, Field(strict=True)]],
    expected("least and largest value such as [0.0, 2.5]; -inf or inf for none"),
]
Designed = Annotated[_Real, WrapValidator(_designed), expected("a finite number")]
Forces = Annotated[tuple[Designed, ...], BeforeValidator(as_list), expected(COMPONENTS)]
Triple = Annotated[tuple[_Real, _Real, _Real], expected("centre and radius such as [0.0, 0.0, 1.0]")]
Points = Annotated[
    list[_Two], Field(min_length=2), expected("points such as [[0, 0], [1, 0.1]], two or more")
]
Scalar = Annotated[Any, BeforeValidator(_coefficient), expected("a number or an expression")]
Vector = Annotated[
    tuple[Scalar, ...],
    BeforeValidator(as_list),
    Field(min_length=1, max_length=2),
    expected(COMPONENTS),
]
Given = Annotated[
    tuple[Scalar | None, ...],
    Field(min_length=1, max_length=2),
    WrapValidator(_given),
    expected(COMPONENTS),
]
Condition = Annotated[
    str,
    Field(strict=True),
    AfterValidator(Expression),
    expected("a condition on x and y such as 'y == 1 and x > 2'"),
]
Delta = Annotated[
    _Real | _Two | _Relative | None,
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

KINDS: Mapping[object, Any] = {
    bool: Flag,
    int: Whole,
    str: Text,
    float: Finite,
    float | ca.SX: Designed,
    Coefficient: Scalar,
    tuple[float, float]: Pair,
    tuple[float | ca.SX, float | ca.SX]: Annotated[tuple[Designed, Designed], expected(PAIR)],
    tuple[float, float, float]: Triple,
    tuple[float, ...]: Forces,
    tuple[Coefficient, Coefficient]: Vector,
    list[tuple[float, float]]: Points,
    tuple[Where, ...]: Places,
    tuple[tuple[int, int], ...]: Ties,
    float | tuple[float, float] | Relative | None: Delta,
}
"""What may stand in a file for an argument of each type."""
