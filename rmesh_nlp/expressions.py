"""Functions of position written as text, such as ``sin(2*pi*x)*y``.

The text is parsed by Python's own parser and then walked: only numbers, ``x``, ``y``, ``pi``,
arithmetic, comparisons and the functions listed here are let through. Nothing is ever evaluated
as Python, so a problem file from a stranger can do no harm.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, nearest
from rmesh_nlp.evaluation import ROUNDING

LONGEST = 1000
"""Characters that an expression may have."""

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "atan2": ca.atan2,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "exp": ca.exp,
    "log": ca.log,
    "sqrt": ca.sqrt,
    "abs": ca.fabs,
    "min": ca.fmin,
    "max": ca.fmax,
    "hypot": lambda a, b: ca.sqrt(a * a + b * b),
    "where": ca.if_else,
}
"""Every function that may be used, by name."""

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: ca.logic_not,
    ast.And: ca.logic_and,
    ast.Or: ca.logic_or,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: lambda a, b: ca.fabs(a - b) <= ROUNDING,
    ast.NotEq: lambda a, b: ca.fabs(a - b) > ROUNDING,
}


class Expression:
    """A function of position (x, y), read from text; a ValueError says what is not allowed in it.

    ``names`` are further symbols that may stand in it, by their names. ``value`` is the expression itself if
    it does not depend on the position, else None.
    """

    def __init__(self, text: str, names: Mapping[str, ca.SX] = {}) -> None:
        self.text = text
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        value = value_of(text, {"x": x, "y": y, **names})
        self._function = ca.Function("expression", [x, y], [value], {"allow_free": True})
        self.value = None if ca.depends_on(value, ca.vertcat(x, y)) else ca.SX(value)

    def __call__(self, x: Any, y: Any) -> Any:
        """Value at a point: CasADi symbols or numbers."""
        return self._function(x, y)

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Expression) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)


def value_of(text: str, names: Mapping[str, Any]) -> Any:
    """The value of an expression whose names stand for symbols; a ValueError says what is not allowed."""
    if len(text) > LONGEST:
        raise BadInputError(f"an expression of {len(text)} characters is too long ({LONGEST} are allowed)")
    try:
        return _walk(_parsed(text), {**names, "pi": ca.SX(np.pi)})
    except (SyntaxError, RecursionError, MemoryError) as error:
        symbols = f" of {' and '.join(', '.join(names).rsplit(', ', 1))}" if names else ""
        raise BadInputError(f"{text[:60]!r} is not an expression{symbols}") from error


def _parsed(text: str) -> ast.expr:
    try:
        return ast.parse(text.strip(), mode="eval").body
    except ValueError as error:  # how Python before 3.12 refuses a null character
        raise SyntaxError(str(error)) from error


def _walk(node: ast.AST, names: dict[str, Any]) -> Any:
    """Value of a syntax tree as a CasADi expression; a part that is finite nowhere is refused."""
    value = _value(node, names)
    constant = isinstance(value, (ca.SX, ca.DM)) and value.is_constant()
    if constant and not np.isfinite(float(value)):
        raise BadInputError(f"{ast.unparse(node)[:60]!r} is not a finite number")
    return value


def _value(node: ast.AST, names: dict[str, Any]) -> Any:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitXor):
        raise BadInputError(f"{ast.unparse(node)[:60]!r}: powers are written with **, not ^")
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        # a bool is an int to Python; whole numbers as floats, so that 9**9**9 cannot fill the memory
        if not isinstance(node.value, bool) and abs(node.value) <= 1e300:
            return ca.SX(float(node.value))
    elif isinstance(node, ast.Name):
        if node.id in names:
            return names[node.id]
        raise BadInputError(f"unknown name {node.id!r}{nearest(node.id, (*names, *FUNCTIONS))}")
    elif isinstance(node, (ast.BinOp, ast.UnaryOp)) and type(node.op) in _OPERATORS:
        operands = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.operand,)
        return _OPERATORS[type(node.op)](*(_walk(operand, names) for operand in operands))
    elif isinstance(node, ast.BoolOp):
        return reduce(_OPERATORS[type(node.op)], [_walk(value, names) for value in node.values])
    elif isinstance(node, ast.Compare) and all(type(op) in _OPERATORS for op in node.ops):
        sides = [_walk(side, names) for side in (node.left, *node.comparators)]
        tests = zip(node.ops, sides, sides[1:], strict=False)
        return reduce(ca.logic_and, [_OPERATORS[type(op)](a, b) for op, a, b in tests])
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _call(node, node.func.id, names)
    raise BadInputError(f"{ast.unparse(node)[:60]!r} is not allowed in an expression")


def _call(node: ast.Call, name: str, names: dict[str, Any]) -> Any:
    if name not in FUNCTIONS:
        raise BadInputError(f"unknown function {name!r}{nearest(name, FUNCTIONS)}")
    arguments = [_walk(argument, names) for argument in node.args]
    try:
        return FUNCTIONS[name](*arguments)
    except (NotImplementedError, TypeError):
        raise BadInputError(f"{name} does not take {len(arguments)} arguments") from None
