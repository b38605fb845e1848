"""Surfaces of foundations: their gaps are functions of a module, so that problems can be pickled."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from rmesh_nlp.errors import require
from rmesh_nlp.evaluation import Expression, is_pair
from rmesh_nlp.problem.coefficients import OPEN, POSITION, Coefficient, Parameter, PositionFunction, at, each

Vector = tuple[float, float]
Centre = tuple[Parameter, Parameter]


def unit(normal: Vector) -> Vector:
    """The vector of length 1 in a direction; a BadInputError if it is none."""
    n = each("normal", normal)
    require(is_pair(n) and np.any(n), "normal", "be a non-zero vector", normal)
    length = float(np.hypot(*n))
    return n[0] / length, n[1] / length


def off_line(n: Vector, point: Centre, x: Expression, y: Expression) -> Expression:
    """Distance from a line through a point with a unit normal."""
    return n[0] * (x - point[0]) + n[1] * (y - point[1])


def above(height: Coefficient, x: Expression, y: Expression) -> Expression:
    """Distance from a graph along y."""
    return y - at(height, x, y)


def off_circle(centre: Centre, radius: Parameter, sign: float, x: Expression, y: Expression) -> Expression:
    """Distance from a circle, negative on the other side of it; outside is positive for a sign of 1."""
    return sign * (ca.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2) - radius)


def minus(psi: Coefficient, x: Expression, y: Expression) -> Expression:
    """The opposite of a coefficient."""
    return -at(psi, x, y)


@lru_cache(maxsize=32)
def gradient(level: PositionFunction) -> ca.Function:
    """``(x, y) -> (d level / dx, d level / dy)``, a column."""
    x, y = POSITION
    slope = ca.gradient(ca.SX(at(level, x, y)), ca.vertcat(x, y))
    return ca.Function("slope", [x, y], [ca.densify(slope)], OPEN)
