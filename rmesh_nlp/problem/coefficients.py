"""Numbers or functions of position: sources, tractions, obstacles, friction bounds, given displacements.

Functions are written with CasADi or numpy operations on ``x`` and ``y`` and are called with
CasADi symbols, because loads move with the nodes and must be differentiated.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from functools import lru_cache, wraps
from numbers import Real
from typing import Any, ParamSpec, TypeAlias, TypeGuard, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError, located, one_line
from rmesh_nlp.evaluation import Array, Expression, is_finite
from rmesh_nlp.settings import real
from rmesh_nlp.vectorised import columnwise

PositionFunction = Callable[[Expression, Expression], Expression]
Parameter: TypeAlias = float | ca.SX
"""A number, or an expression of design variables."""

Coefficient: TypeAlias = Parameter | PositionFunction
"""A number, an expression of design variables, or a function of position (x, y), which may depend on them."""

OPEN = {"allow_free": True}
"""Option of CasADi Functions whose expressions may contain the symbols of design variables."""


P = ParamSpec("P")
T = TypeVar("T")


def once(make: Callable[P, T]) -> Callable[P, T]:
    """Kept per arguments: functions of position are pure, and the meshes of a problem share them."""
    kept = lru_cache(make)

    @wraps(make)
    def made(*given: P.args, **named: P.kwargs) -> T:
        try:
            return kept(*given, **named)  # type: ignore[arg-type]
        except TypeError:  # one of them cannot be hashed
            return make(*given, **named)

    return made


POSITION = ca.SX.sym("x"), ca.SX.sym("y")

BRANCH = (
    "a function of position cannot branch on x or y with if, and, or, min or max: use "
    "rmesh_nlp.where(condition, a, b), casadi.logic_and, casadi.fmin or casadi.fmax"
)

NOT_SYMBOLIC = (
    "a function of position is nan for symbols: use functions of numpy or casadi in it, not those of math"
)


def at(coefficient: Coefficient, x: Expression, y: Expression) -> Expression:
    """Value of a coefficient at a point; a ValueError says what to use instead of branches and ``math``."""
    value = _called(coefficient, x, y) if callable(coefficient) else coefficient
    if isinstance(x, ca.SX | ca.MX) and getattr(value, "shape", None) != x.shape:
        return real("a coefficient", value)
    return value


def _called(coefficient: PositionFunction, x: Expression, y: Expression) -> Expression:
    with warnings.catch_warnings():
        # numpy's functions of one and two arguments work on symbols, which CasADi remarks upon
        warnings.filterwarnings("ignore", message="(?s).*numpy function was called on a casadi value")
        try:
            value = coefficient(x, y)
        except TypeError as error:
            raise BadInputError(f"a function of position must take x and y: {error}") from error
        except RuntimeError as error:
            if "truth value" not in str(error):
                raise
            raise BadInputError(BRANCH) from None
    if isinstance(x, ca.SX | ca.MX) and isinstance(value, float) and np.isnan(value):
        raise BadInputError(NOT_SYMBOLIC)
    return value


def where(condition: Expression, a: Expression, b: Expression) -> Expression:
    """``a`` where the condition holds, else ``b``: what ``if`` cannot say in a function of position."""
    try:
        return ca.if_else(condition, a, b)
    except NotImplementedError:
        got = ", ".join(one_line(repr(given))[:60] for given in (condition, a, b))
        said = f"where takes a condition on x and y and two values, got {got}"
        raise BadInputError(said, "condition") from None


@once
def product(measure: Coefficient, coefficient: Coefficient) -> Coefficient:
    """A coefficient times a measure; one of a plane body is 1."""
    if not callable(measure) or coefficient == 0:
        return coefficient
    return lambda x, y: at(measure, x, y) * at(coefficient, x, y)


def on_points(coefficient: Coefficient, points: NDArray, what: str = "the function") -> Array:
    """Values (...) of a coefficient at ``points`` (2, ...); a ValueError if one is not finite."""
    with located(what):
        if callable(coefficient):
            values = evaluated(as_function(coefficient), points)[0]
        else:
            values = np.full(points.shape[1:], float(at(coefficient, *POSITION)))
    x, y = points.reshape(2, -1)
    for bad in np.flatnonzero(~np.isfinite(values)):
        raise BadInputError(f"{what} is {values.flat[bad]} at ({x[bad]:.6g}, {y[bad]:.6g})")
    return values


def evaluated(function: ca.Function, points: NDArray) -> Array:
    """Values (outputs, ...) of a function of x and y, or more, at points (2 or more, ...)."""
    if points.size == 0:
        return np.zeros((function.size1_out(0), *points.shape[1:]))
    rows = points.reshape(len(points), 1, -1)
    return columnwise(function, rows.shape[2])([*rows])[0].reshape(-1, *points.shape[1:])


@once
def as_function(coefficient: Coefficient) -> ca.Function:
    """The graph ``(x, y) -> value`` of a coefficient."""
    x, y = POSITION
    return ca.Function("coefficient", [x, y], [ca.densify(at(coefficient, x, y))], OPEN)


def as_tuple(value: Any) -> tuple[Any, ...]:
    """One thing alone as a tuple of one."""
    is_single = isinstance(value, (str, ca.SX)) or callable(value) or getattr(value, "shape", None) == ()
    several = isinstance(value, Iterable) and not is_single
    return tuple(value) if several else (value,)


def numeric(name: str, value: Any, or_none: bool = False) -> Any:
    """A coefficient with a number of any type as a float; a BadInputError for what is none."""
    if callable(value) or isinstance(value, ca.SX) or (or_none and value is None):
        return value
    return real(name, value)


def each(name: str, values: Any, or_none: bool = False) -> tuple[Any, ...]:
    """Several coefficients, or one alone."""
    return tuple(numeric(name, value, or_none) for value in as_tuple(values))


def convert(part: Any) -> None:
    """Make fields of a frozen dataclass numeric, as far as their types are numbers or coefficients."""
    for field in fields(part):
        value, kind = getattr(part, field.name), str(field.type)
        if re.search("float|Parameter|Coefficient", kind) and not (value is None and kind.endswith("None")):
            to = each if "tuple" in kind else numeric
            object.__setattr__(part, field.name, to(field.name, value, "None" in kind))


def is_number(coefficient: Coefficient | None) -> TypeGuard[float]:
    """Whether a coefficient is a number."""
    return isinstance(coefficient, Real)


def is_nonzero(coefficient: Coefficient) -> bool:
    """Whether a coefficient is anything but the number zero."""
    return not is_number(coefficient) or bool(coefficient != 0)


@dataclass(frozen=True)
class PiecewiseLinear:
    """Continuous piecewise-linear function of x_1, extended linearly beyond its ends.

    Attributes
    ----------
    x, y : tuples of float
        Breakpoints, ``x`` strictly increasing, and values.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        convert(self)
        got = f"got x={self.x}, y={self.y}"
        if len(self.x) != len(self.y) or len(self.x) < 2:
            raise BadInputError(f"a piecewise-linear function needs 2 or more points, {got}")
        if not is_finite([*self.x, *self.y]):
            raise BadInputError(f"a piecewise-linear function must be finite, {got}")
        if np.any(np.diff(self.x) <= 0):
            raise BadInputError(f"breakpoints must increase, got x={self.x}")

    @property
    def kinks(self) -> tuple[float, ...]:
        """The breakpoints at which the slope changes."""
        change = np.diff(np.diff(self.y) / np.diff(self.x))
        return tuple(x for x, jump in zip(self.x[1:-1], change, strict=True) if jump != 0)

    def __call__(self, x: Expression, y: Expression = None) -> Expression:
        """Value at x_1 = ``x``; ``y`` is ignored, so that it serves as a function of position."""
        slopes = np.diff(self.y) / np.diff(self.x)
        value = self.y[0] + slopes[0] * (x - self.x[0])
        for corner, jump in zip(self.x[1:-1], np.diff(slopes), strict=True):
            value = value + jump * ca.fmax(x - corner, 0)
        return value
