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
from rmesh_nlp.problem.coefficients import Coefficient, as_function, at, once
from rmesh_nlp.problem.quadrature import polynomial_degree
from rmesh_nlp.vectorised import columnwise

DIFFERENCE = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)  # of the two arguments
ITSELF = (ca.OP_FABS, ca.OP_SIGN, ca.OP_IF_ELSE_ZERO)  # the first argument
ROUNDED = (ca.OP_FLOOR, ca.OP_CEIL)  # at every whole number
LOGICAL = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)
UNKNOWN = (ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN, ca.OP_CALL)  # they may jump, and it is not said where


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
        Whether there can be no others: False if an operation of the graph may jump where it does not say.
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
    each, are_all = _switches_of(graph)
    if not each and are_all:
        return None
    functions = tuple(ca.Function("switch", graph.sx_in(), [ca.densify(one)]) for one in each)
    return Switches(functions, tuple(map(polynomial_degree, functions)), are_all)


def _switches_of(graph: ca.Function) -> tuple[list[ca.SX], bool]:
    """The switches in a graph as expressions of its inputs, each once, and whether these are all."""
    each, are_all, expressions = dict[str, ca.SX](), True, graph.instructions_sx()
    for k in range(graph.n_instructions()):
        operation, expression = graph.instruction_id(k), expressions[k]
        are_all &= operation not in UNKNOWN
        if operation in DIFFERENCE:
            switch = expression.dep(0) - expression.dep(1)
        elif operation in ITSELF and expression.dep(0).op() not in LOGICAL:
            switch = expression.dep(0)
        elif operation in ROUNDED:
            switch = ca.sin(np.pi * expression.dep(0))
        else:
            continue
        if not switch.is_constant():
            each.setdefault(str(switch), switch)
    return list(each.values()), are_all
