"""Where a coefficient jumps or kinks: on the zeros of functions that stand in its graph.

Coefficients are graphs of operations. All of them are smooth but comparisons, ``where``, ``abs``, ``sign``,
the smaller and the larger of two, and roundings; each of these jumps or kinks where a function of position is
zero, its switch.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import Coefficient, as_function, at, once, polynomial_degree
from rmesh_nlp.vectorised import columnwise

DIFFERENCE = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)  # of the two arguments
ITSELF = (ca.OP_FABS, ca.OP_SIGN, ca.OP_IF_ELSE_ZERO)  # the first argument
ROUNDED = (ca.OP_FLOOR, ca.OP_CEIL)  # at every whole number
LOGICAL = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)
UNARY = (
    *(ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_SQRT, ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_EXP),
    *(
        ca.OP_LOG,
        ca.OP_NOT,
        ca.OP_ASIN,
        ca.OP_ACOS,
        ca.OP_ATAN,
        ca.OP_SINH,
        ca.OP_COSH,
        ca.OP_TANH,
        ca.OP_ASINH,
    ),
    *(ca.OP_ACOSH, ca.OP_ATANH, ca.OP_ERF, ca.OP_LOG1P, ca.OP_EXPM1, ca.OP_FABS, ca.OP_SIGN, *ROUNDED),
)
BINARY = (
    *(
        ca.OP_ADD,
        ca.OP_SUB,
        ca.OP_MUL,
        ca.OP_DIV,
        ca.OP_POW,
        ca.OP_CONSTPOW,
        ca.OP_AND,
        ca.OP_OR,
        ca.OP_ATAN2,
    ),
    *(ca.OP_HYPOT, ca.OP_IF_ELSE_ZERO, *DIFFERENCE),
)


@dataclass(frozen=True)
class Switches:
    """The switches of a coefficient.

    Attributes
    ----------
    functions : tuple of casadi.Function
        ``(x, y) -> value`` of each.
    degrees : tuple of int or None
        Of each in x and y together; None if it is no polynomial.
    are_all : bool
        Whether there can be no others: False if an operation of the graph is not known to be smooth.
    """

    functions: tuple[ca.Function, ...]
    degrees: tuple[int | None, ...]
    are_all: bool

    def __call__(self, number: int, points: NDArray) -> Array:
        """Values (...) of one at ``points`` (2, ...)."""
        flat = points.reshape(2, -1)
        values = columnwise(self.functions[number], flat.shape[1])([flat[:1], flat[1:]])[0]
        return np.asarray(values.reshape(points.shape[1:]))


@once
def switches(coefficient: Coefficient) -> Switches | None:
    """The switches of a coefficient; None if it is smooth."""
    if not callable(coefficient):
        return None
    position = ca.SX.sym("x"), ca.SX.sym("y")
    if len(ca.symvar(ca.SX(at(coefficient, *position)) + sum(position))) > len(position):
        return Switches((), (), are_all=False)  # it depends on design variables
    graph = as_function(coefficient)
    each, are_all = _walked(graph, position)
    if not each and are_all:
        return None
    functions = tuple(ca.Function("switch", [*position], [ca.densify(one)]) for one in each)
    return Switches(functions, tuple(map(polynomial_degree, functions)), are_all)


def _walked(graph: ca.Function, position: tuple[ca.SX, ca.SX]) -> tuple[list[ca.SX], bool]:
    """The switches in a graph, each once, and whether every operation is known."""
    work, logical, each = dict[int, ca.SX](), set[int](), dict[str, ca.SX]()
    for k in range(graph.n_instructions()):
        operation, given, to = (
            graph.instruction_id(k),
            graph.instruction_input(k),
            graph.instruction_output(k),
        )
        if operation == ca.OP_OUTPUT:
            continue
        if operation == ca.OP_CONST:
            value = ca.SX(graph.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            value = position[given[0]]
        elif operation in UNARY:
            value = ca.SX.unary(operation, work[given[0]])
        elif operation in BINARY:
            value = ca.SX.binary(operation, *(work[place] for place in given))
        else:
            return list(each.values()), False
        switch = None
        if operation in DIFFERENCE:
            switch = work[given[0]] - work[given[1]]
        elif operation in ITSELF and given[0] not in logical:
            switch = work[given[0]]
        elif operation in ROUNDED:
            switch = ca.sin(np.pi * work[given[0]])
        if switch is not None and not switch.is_constant():
            each.setdefault(str(switch), switch)
        work[to[0]] = value
        (logical.add if operation in LOGICAL else logical.discard)(to[0])
    return list(each.values()), True
