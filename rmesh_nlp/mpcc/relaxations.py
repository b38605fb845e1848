"""Relaxations of a complementarity pair ``0 <= a _|_ b >= 0`` with parameter ``t > 0``.

Each function maps columns ``a``, ``b`` and the scalar ``t`` to a :class:`Relaxation`. All are
normalised so that the corner of the relaxed set on the diagonal lies at ``a = b = sqrt(t)``,
where Scholtes' hyperbola ``a b = t`` has it: equal t means a relaxation of comparable size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca

from rmesh_nlp.optimize.nlp import Symbolic


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Constraint rows ``rows <= 0`` and a term of the objective.

    ``signs`` says whether ``a, b >= 0`` stays beside the rows, or whether the rows replace it.
    """

    rows: Symbolic
    penalty: Symbolic | float = 0.0
    signs: bool = True


def scholtes(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """``a b <= t``.

    S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with
    complementarity constraints, SIAM J. Optim. 11 (2001) 918-936.
    """
    return Relaxation(a * b - t)


def lin_fukushima(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """``a b <= s^2`` and ``(a + s)(b + s) >= s^2``, with ``s = sqrt(t)``.

    G.-H. Lin and M. Fukushima, A modified relaxation scheme for mathematical programs with
    complementarity constraints, Ann. Oper. Res. 133 (2005) 63-84. The two rows replace the
    signs of a and b (bounds that the problem itself gives stay): a may be negative by less than s.
    """
    s = ca.sqrt(t)
    return Relaxation(ca.vertcat(a * b - t, -(a * b + s * (a + b))), signs=False)


def steffensen_ulbrich(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """``a + b <= phi(a - b)``, the kink of ``|a - b|`` rounded on ``|a - b| < s``.

    ``phi(z) = |z|`` outside and ``s ((2 / pi) sin(pi z / (2 s) + 3 pi / 2) + 1)`` inside;
    ``s = 2 sqrt(t) / (1 - 2 / pi)``. S. Steffensen and M. Ulbrich, A new relaxation scheme for
    mathematical programs with equilibrium constraints, SIAM J. Optim. 20 (2010) 2504-2539.
    """
    s = 2 * ca.sqrt(t) / (1 - 2 / math.pi)
    z = a - b
    inside = s * (2 / math.pi * ca.sin(math.pi / 2 * z / s + 1.5 * math.pi) + 1)
    return Relaxation(a + b - ca.if_else(ca.fabs(z) < s, inside, ca.fabs(z)))


def kanzow_schwartz(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """``phi(a - s, b - s) <= 0`` with ``s = sqrt(t)``.

    ``phi(u, v) = u v`` where ``u + v >= 0`` and ``-(u^2 + v^2) / 2`` elsewhere. C. Kanzow and
    A. Schwartz, A new regularization method for mathematical programs with complementarity
    constraints with strong convergence properties, SIAM J. Optim. 23 (2013) 770-798.
    """
    s = ca.sqrt(t)
    u, v = a - s, b - s
    return Relaxation(ca.if_else(u + v >= 0, u * v, -(u**2 + v**2) / 2))


def fischer_burmeister(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """``a + b - sqrt(a^2 + b^2 + 2 t) <= 0``: the smoothed Fischer-Burmeister function.

    It vanishes exactly where ``a b = t`` with ``a, b > 0``. A. Fischer, A special Newton-type
    optimization method, Optimization 24 (1992) 269-284; smoothed by C. Kanzow, Some noninterior
    continuation methods for linear complementarity problems, SIAM J. Matrix Anal. Appl. 17 (1996) 851-868.
    """
    return Relaxation(a + b - ca.sqrt(a**2 + b**2 + 2 * t))


def l1_penalty(a: Symbolic, b: Symbolic, t: Symbolic) -> Relaxation:
    """Objective term ``sum(a b) / sqrt(t)``, no constraint: the l1 (elastic) exact penalty.

    For ``a, b >= 0`` the sum is the l1 norm of the products. The weight is the size of the multiplier
    that Scholtes' rows have at a biactive point that is not S-stationary. M. Anitescu, On using the
    elastic mode in nonlinear programming approaches to MPCCs, SIAM J. Optim. 15 (2005) 1203-1236;
    S. Leyffer, G. Lopez-Calva, J. Nocedal, Interior methods for MPCCs, SIAM J. Optim. 17 (2006) 52-77.
    """
    return Relaxation(type(a).zeros(0, 1), ca.dot(a, b) / ca.sqrt(t))


RELAXATIONS: Mapping[str, Callable[[Symbolic, Symbolic, Symbolic], Relaxation]] = {
    "scholtes": scholtes,
    "lin-fukushima": lin_fukushima,
    "steffensen-ulbrich": steffensen_ulbrich,
    "kanzow-schwartz": kanzow_schwartz,
    "fischer-burmeister": fischer_burmeister,
    "l1-penalty": l1_penalty,
}
