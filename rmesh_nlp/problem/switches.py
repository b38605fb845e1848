"""Where a coefficient jumps or kinks: on the zeros of functions that stand in its graph.

Coefficients are graphs of operations. Comparisons, ``where``, ``abs``, ``sign``, smaller and larger ones of
two and roundings jump or kink where a function of position is zero, their switch. Whether the rest is smooth
is for :mod:`rmesh_nlp.problem.enclosures` to prove.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, as_function, evaluated, once

COMPARED = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
DIFFERENCE = (*COMPARED, ca.OP_FMIN, ca.OP_FMAX)  # of the two arguments
FIRST = (ca.OP_FABS, ca.OP_SIGN, ca.OP_IF_ELSE_ZERO)  # the first argument
EACH = (ca.OP_NOT, ca.OP_AND, ca.OP_OR)  # every argument
ROUNDED = (ca.OP_FLOOR, ca.OP_CEIL)  # at every whole number
LOGICAL = (*COMPARED, *EACH)


HIGH = 8
"""Degree for loads that are no polynomials. Of random problems with loads such as 4 sin(3 x) + x y none of
those solved with degree 6 had a gain that the audit did not confirm to 10 %; 8 is for faster
oscillations."""


@dataclass(frozen=True)
class Switches:
    """The switches of a coefficient.

    Attributes
    ----------
    functions : tuple of casadi.Function
        ``(x, y) -> value`` of each, from the innermost to the outermost.
    degrees : tuple of int or None
        Of each in x and y together between the zeros of those before; None if it is no polynomial there.
    """

    functions: tuple[ca.Function, ...]
    degrees: tuple[int | None, ...]

    def __call__(self, number: int, points: NDArray) -> Array:
        """Values (...) of one at ``points`` (2, ...), 1e300 where they overflow."""
        return np.clip(evaluated(self.functions[number], points)[0], -1e300, 1e300)


@once
def switches(coefficient: Coefficient) -> Switches | None:
    """The switches of a coefficient; None if it is smooth."""
    if not callable(coefficient):
        return None
    functions = _switches_of(as_function(coefficient))
    return Switches(functions, tuple(map(_degree_between_switches, functions))) if functions else None


def _degree_between_switches(function: ca.Function) -> int | None:
    """Degree of a switch between the zeros of its own switches; None if these are not known."""
    inner = switches(function)
    return degree_of_pieces(function) if inner is None or None not in inner.degrees else None


def polynomial_degree(coefficient: Coefficient) -> int | None:
    """Degree in x and y together; None if it is no polynomial up to ``HIGH - 1``."""
    degree = degree_of_pieces(coefficient)
    return degree if degree is None or switches(coefficient) is None else None


@once
def degree_of_pieces(coefficient: Coefficient) -> int | None:
    """The same between places where it jumps or kinks, by the operations of its graph."""
    if not callable(coefficient):
        return 0
    try:
        graph = as_function(coefficient)
    except (NotImplementedError, RuntimeError, TypeError, ValueError):
        return None  # a function of MX alone, or one that the assembly refuses with a reason
    degrees: dict[int, float] = {}
    for k in range(graph.n_instructions()):
        operation, sources = graph.instruction_id(k), graph.instruction_input(k)
        if operation == ca.OP_CALL:
            return None
        if operation in (ca.OP_CONST, ca.OP_INPUT, ca.OP_PARAMETER):
            degree: float = operation == ca.OP_INPUT
        else:
            degree = _degree(operation, *(degrees[source] for source in sources))
        degrees[graph.instruction_output(k)[0]] = degree
    return int(degree) if degree < HIGH else None


def _degree(operation: int, a: float, b: float = 0) -> float:
    """Degree of the result of an operation by those of its arguments, between where it jumps or kinks."""
    if a == b == 0 or operation in (*LOGICAL, *ROUNDED, ca.OP_SIGN):
        return 0
    match operation:
        case ca.OP_ADD | ca.OP_SUB | ca.OP_FMIN | ca.OP_FMAX | ca.OP_NEG | ca.OP_TWICE | ca.OP_FABS:
            return max(a, b)
        case ca.OP_MUL:
            return a + b
        case ca.OP_SQ:
            return 2 * a
        case ca.OP_IF_ELSE_ZERO:
            return b
        case ca.OP_OUTPUT | ca.OP_DIV if b == 0:
            return a
    return np.inf  # whole powers are products


def affine_switches(coefficients: Iterable[Coefficient]) -> list[ca.Function]:
    """The affine ones of all switches of coefficients, each once."""
    each = (one for known in filter(None, map(switches, coefficients)) for one in known.functions)
    return list(_distinct(one for one in each if polynomial_degree(one) == 1))


def _distinct(functions: Iterable[ca.Function]) -> tuple[ca.Function, ...]:
    """Each once: printed expressions have six digits, by which jumps at 1.3 and 1.3000001 are the same."""
    return tuple({function.serialize(): function for function in functions}.values())


def _switches_of(graph: ca.Function) -> tuple[ca.Function, ...]:
    """The switches in a graph as functions of its inputs, each once."""
    each, expressions = [], graph.instructions_sx()
    for k in range(graph.n_instructions()):
        operation, expression = graph.instruction_id(k), expressions[k]
        found = [expression.dep(i) for i in range(expression.n_dep())]
        if operation in DIFFERENCE:
            found = [found[0] - found[1]]
        elif operation in ROUNDED:
            found = [ca.sin(np.pi * found[0])]
        elif operation in FIRST:
            del found[1:]
        elif operation not in EACH:
            continue
        for switch in found:
            if switch.op() not in LOGICAL and not switch.is_constant():
                each.append(ca.Function("switch", graph.sx_in(), [ca.densify(switch)], OPEN))
    return _distinct(each)
