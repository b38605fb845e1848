"""Design variables: named numbers within bounds that a problem depends on, besides its node positions.

Laws, loads, friction and obstacles may be expressions of :attr:`DesignVariable.symbol`, and a :class:`Shape`
is the amplitude of a motion of boundary nodes. :func:`rmesh_nlp.ContactProblem.at_design` puts numbers in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Expression, is_finite, is_pair
from rmesh_nlp.expressions import FUNCTIONS
from rmesh_nlp.problem.coefficients import (
    POSITION,
    Coefficient,
    PositionFunction,
    at,
    convert,
    once,
)

RESERVED = ("x", "y", "pi", "inf", "nan", *FUNCTIONS)
"""Names that expressions of position have already."""


@cache
def symbol(name: str) -> ca.SX:
    """The symbol of a design variable: one for each name."""
    return ca.SX.sym(name)


@dataclass(frozen=True)
class DesignVariable:
    """A number that is optimised.

    Parameters
    ----------
    name : str
        As in expressions and records.
    start : float
        Where the solve begins; by it the problem is checked.
    bounds : tuple of float
        Least and largest value, both finite.
    """

    name: str
    start: float
    bounds: tuple[float, float]

    def __post_init__(self) -> None:
        _check(self)

    @property
    def symbol(self) -> ca.SX:
        """What stands for it in coefficients: ``PlaneStrain.from_young(E.symbol, 0.3)``."""
        return symbol(self.name)


@dataclass(frozen=True)
class Level(DesignVariable):
    """A bound that is minimised in the place of what stays below it; no figure of a design."""


@dataclass(frozen=True)
class Shape:
    """A motion of the nodes of a boundary times an amplitude, which is optimised.

    The other nodes follow by a harmonic map: those of straight boundary pieces along them, those of all other
    lines stay. Nodes of the boundary itself are not relocated along it unless the motion of the problem says
    so.

    Parameters
    ----------
    name, boundary : str
        Of the amplitude, and of the boundary that moves.
    motion : tuple of float or function of position
        Displacement (2,) of a boundary node at amplitude 1, in units of length.
    bounds : tuple of float
        Least and largest amplitude, both finite; the first one is 0, the mesh as given.
    """

    name: str
    boundary: str
    motion: tuple[Coefficient, Coefficient]
    bounds: tuple[float, float]
    start: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        _check(self)
        require(len(self.motion) == 2, "motion", "have 2 components", self.motion)

    @property
    def symbol(self) -> ca.SX:
        """See :attr:`DesignVariable.symbol`."""
        return symbol(self.name)


@dataclass(frozen=True)
class Constraint:
    """A quantity that a design must keep within bounds.

    Parameters
    ----------
    value : str or Objective
        The quantity: any text of an objective, such as "area", "resultant(bottom)" or "design(a + 2*b)".
    bounds : tuple of float
        Least and largest value; either may be infinite, and both the same. That of the largest pressure may
        be an expression of design variables.
    """

    value: Any
    bounds: tuple[float, Any]

    def __post_init__(self) -> None:
        convert(self)
        what, pair = f"the bounds of {str(self.value)!r} must", self.bounds
        if len(pair) != 2:
            raise BadInputError(f"{what} be two numbers, got {self.bounds!r}", "bounds")
        if isinstance(pair[1], ca.SX):
            return
        lower, upper = pair
        if not (lower <= upper and lower < np.inf and upper > -np.inf and np.isfinite([lower, upper]).any()):
            raise BadInputError(f"{what} increase, one of them finite, got {[lower, upper]}", "bounds")


def _check(variable: DesignVariable | Shape) -> None:
    convert(variable)
    name, start, bounds = variable.name, variable.start, variable.bounds
    if not (isinstance(name, str) and name.isidentifier()) or name in RESERVED or name.startswith("_"):
        raise BadInputError(f"a design variable needs a name of its own such as 'h0', got {name!r}", "name")
    if not (is_pair(bounds) and bounds[0] < bounds[1]):
        raise BadInputError(f"the bounds of {name!r} must be finite and increase, got {[*bounds]}", "bounds")
    if not (is_finite(start) and bounds[0] <= start <= bounds[1]):
        raise BadInputError(
            f"{name!r} starts at {start}, which is not within its bounds {list(bounds)}", "start"
        )


@dataclass(frozen=True)
class AtDesign:
    """A function of position with numbers in the place of design variables."""

    coefficient: PositionFunction
    values: tuple[tuple[str, float], ...]

    @cached_property
    def _function(self) -> ca.Function:
        x, y = POSITION
        value = substituted(ca.SX(at(self.coefficient, x, y)), dict(self.values))
        return ca.Function("coefficient", [x, y], [value])

    def __call__(self, x: Expression, y: Expression) -> Expression:
        """Value at a point: CasADi symbols or numbers."""
        return self._function(x, y)

    @property
    def text(self) -> str:
        """For people."""
        text = getattr(self.coefficient, "text", "f(x, y)")
        return f"{text} at {', '.join(f'{name} = {value:.6g}' for name, value in self.values)}"


def substituted(expression: ca.SX, values: Mapping[str, float]) -> ca.SX:
    """An expression with numbers in the place of design variables."""
    used = [sym for sym in ca.symvar(expression) if sym.name() in values]
    if not used:
        return expression
    return ca.substitute(expression, ca.vertcat(*used), ca.DM([values[sym.name()] for sym in used]))


def names_in(coefficient: object) -> tuple[str, ...]:
    """Names of the design variables that a coefficient, a law, a load or an obstacle depends on."""
    if isinstance(coefficient, ca.SX):
        return tuple(sorted({sym.name() for sym in ca.symvar(coefficient)}))
    if is_dataclass(coefficient) and not callable(coefficient):
        coefficient = tuple(getattr(coefficient, field.name) for field in fields(coefficient))
    if isinstance(coefficient, tuple):
        return tuple(sorted({name for part in coefficient for name in names_in(part)}))
    return _names_in_function(coefficient) if callable(coefficient) else ()


@once
def _names_in_function(function: Coefficient) -> tuple[str, ...]:
    x, y = POSITION
    try:
        value = ca.SX(at(function, x, y))
    except (NotImplementedError, RuntimeError, TypeError, ValueError):
        return ()  # of MX alone, such as a spline, or refused elsewhere with a reason
    point = {x.element_hash(), y.element_hash()}
    return tuple(sorted(sym.name() for sym in ca.symvar(value) if sym.element_hash() not in point))


def at_design(part: Any, values: Mapping[str, float]) -> Any:
    """A coefficient, a law, a load or an obstacle with numbers in the place of design variables."""
    if isinstance(part, ca.SX):
        return float(substituted(part, values))
    if isinstance(part, tuple):
        items = tuple(at_design(item, values) for item in part)
        return items if any(a is not b for a, b in zip(items, part, strict=True)) else part
    if callable(part):
        used = tuple((name, values[name]) for name in names_in(part) if name in values)
        return AtDesign(part, used) if used else part
    if not is_dataclass(part):
        return part
    old = {field.name: getattr(part, field.name) for field in fields(part)}
    new = {name: at_design(value, values) for name, value in old.items()}
    is_unchanged = all(new[name] is value for name, value in old.items())
    return part if is_unchanged or isinstance(part, type) else replace(part, **new)
