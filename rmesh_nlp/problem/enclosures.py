"""Whether Gauss's rule sees all of a coefficient on a cell: proved, from its graph.

Two rules that agree see nothing of what happens between their points. So every operation of the graph says
how far its value may be from the one at the centre of a box, if its arguments are that far from theirs: for
all complex points of a box that is larger than the cell. Where a coefficient is analytic and bounded there,
Gauss's rules converge at a rate that is known [1]_. A cell is on one side of all switches.

References
----------
.. [1] L. N. Trefethen, Is Gauss quadrature better than Clenshaw-Curtis?, SIAM Review 50 (2008) 67-87.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import PROVED, Array, Expression, Mask, magnitude
from rmesh_nlp.problem.coefficients import Coefficient, as_function, evaluated
from rmesh_nlp.problem.switches import LOGICAL, ROUNDED

REACH = 8
"""Half-axis of the ellipse about a cell in which a coefficient is to be bounded, in halves of the cell. Six
points are proved to do for sin(k x) on cells of 1.5 / k, and on cells that are four times as far from a pole
as they are wide."""


def resolved(
    coefficient: Coefficient, corners: Array, points: int, size: float = 0.0, share: float | Array = 1.0
) -> tuple[Mask, float]:
    """(...) whether so many points per direction do for a coefficient on cells with ``corners`` (2, ..., k).

    Up to ``PROVED`` of the coefficient's size, the second value, which is at least ``size``. If it is at most
    m from its value at the centre on the ellipse, and each of the two shape functions and the coordinate of
    a triangle that it is multiplied by at most ``(1 + REACH) / 2``, the mean over the cell is wrong by less
    than ``2 (1 + REACH)^3 m rho^(-2 points)``, rho the sum of the half-axes. A cell also does if it is such
    a small ``share`` of another one that what the coefficient varies by is worth nothing.
    """
    centre = np.mean(corners, axis=-1)
    half = np.max(np.abs(corners - centre[..., None]), axis=-1)
    # (REACH + 1): in one direction on the ellipse, in the other one in the cell
    graph = as_function(coefficient).serialize()  # equal functions share what is made of it
    value, far = evaluated(_enclosing(graph, False), np.concatenate([centre, (REACH + 1) * half]))
    size = max(size, magnitude(value[np.isfinite(value)]))
    rho = REACH + np.sqrt(REACH**2 - 1)
    is_seen = 2 * (1 + REACH) ** 3 * rho ** (-2 * points) * far <= PROVED * size
    if not np.all(is_seen):
        near = evaluated(_enclosing(graph, True), np.concatenate([centre, half]))[1]
        is_seen |= share * near <= PROVED * size
    return is_seen, size


@lru_cache
def _enclosing(text: str, is_real: bool) -> ca.Function:
    """``(x, y, halves of the box) -> (value, how far it may be off)``; complex values are, without bound."""
    graph, halves = ca.Function.deserialize(text), ca.vertsplit(ca.SX.sym("halves", 2))
    position, known = graph.sx_in(), dict[int, tuple[Expression, Expression]]()
    for k, value in enumerate(ca.vertsplit(graph.instructions_sx())):
        operation, sources = graph.instruction_id(k), graph.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            result = known[sources[0]]
            continue
        if operation == ca.OP_INPUT:
            value, off = position[sources[0]], halves[sources[0]]
        elif operation == ca.OP_CONST:
            off = ca.SX(0)
        else:
            terms = [part for source in sources for part in known[source]]
            off = _off(operation, value, *terms)
            off = ca.fmin(off, _at_most(operation, *terms)) if is_real else off
        known[graph.instruction_output(k)[0]] = value, off
    return ca.Function("enclosing", [*position, *halves], [ca.vertcat(*result)])


def _off(
    operation: int, v: Expression, a: Expression, r: Expression, b: Expression = 0.5, s: Expression = 0.0
) -> Expression:
    """How far a value v is off if its arguments a and b are by r and s; infinite or nan if that is not known.

    From Taylor series, whose coefficients have one sign, or derivatives, which are at most one over the
    distance to a singularity. A root is a power of 1 / 2.
    """
    growth = ca.exp(r) - 1
    match operation:
        case ca.OP_ADD | ca.OP_SUB:
            return r + s
        case ca.OP_NEG | ca.OP_FABS:
            return r
        case ca.OP_TWICE:
            return 2 * r
        case ca.OP_MUL:
            return abs(a) * s + (abs(b) + s) * r
        case ca.OP_SQ:
            return (2 * abs(a) + r) * r
        case ca.OP_DIV:
            return (r + abs(v) * s) / ca.fmax(abs(b) - s, 0)
        case ca.OP_INV:
            return _off(ca.OP_DIV, v, 1, 0, a, r)
        case ca.OP_TAN:
            return _off(ca.OP_DIV, v, v, growth, ca.cos(a), growth)
        case ca.OP_SQRT | ca.OP_POW | ca.OP_CONSTPOW:
            log = ca.log(a) - ca.log(a - r)
            return abs(v) * (ca.exp(abs(b) * log + (abs(ca.log(a)) + log) * s) - 1)
        case ca.OP_LOG:
            return v - ca.log(a - r)
        case ca.OP_EXP:
            return ca.exp(a + r) - v
        case ca.OP_SIN | ca.OP_COS:
            return growth
        case ca.OP_SINH | ca.OP_COSH:
            return ca.cosh(a) * growth
        case ca.OP_TANH:  # about zero, and where it hardly varies
            near = ca.sinh(r) / (ca.cosh(a) * ca.cos(ca.fmin(r, np.pi / 2)))
            return ca.fmin(near, 4 / (ca.exp(2 * ca.fmax(abs(a) - r, 0)) - 1))
        case ca.OP_ATAN:
            return _off(ca.OP_ATAN2, v, a, r, 1, 0)
        case ca.OP_ATAN2:
            is_cut = ca.logic_and(abs(a) <= r, b < 0)
            return ca.if_else(is_cut, np.inf, -ca.log(1 - (r + s) / ca.sqrt(a**2 + b**2)))
        case ca.OP_FMIN | ca.OP_FMAX:
            return ca.if_else(v == a, r, s)
        case ca.OP_IF_ELSE_ZERO:
            return ca.if_else(a, s, 0)
    return 0.0 if operation in (*LOGICAL, *ROUNDED, ca.OP_SIGN) else np.inf


def _at_most(
    operation: int, a: Expression, r: Expression, b: Expression = 0.5, s: Expression = 0.0
) -> Expression:
    """How far real values can be apart at all."""
    if operation in (ca.OP_SQRT, ca.OP_CONSTPOW):
        return ca.if_else(b > 0, (a + r) ** b, np.inf)
    return 2 * np.pi if operation in (ca.OP_ATAN, ca.OP_ATAN2, ca.OP_TANH) else np.inf
