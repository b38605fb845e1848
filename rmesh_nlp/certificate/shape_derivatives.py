"""Functions of one element or one edge whose derivatives tell how the lower bound changes with the nodes.

The dual energy of a scalar problem at a flux with coefficients c, see
:mod:`rmesh_nlp.certificate.raviart_thomas`, traces W and contact forces P is a sum over elements and edges,

    sum_T ( -1/2 c^T A(X) c + W . (R c) ) - sum_e applied(X) . W - P . (N W + offset(X)),

c_p(X) of c given by the source. The matrices R and N do not change with the positions X, for the element is
mapped such that the flux through its edges is kept. At the solution the sum is stationary in everything but
X, so that its derivative is the partial one.

The oscillation term ``eta r + r^2 / 2`` of an element, eta the variation of the flux, is not quadratic. For
any number e > 0 it is at most

    r (eta^2 / e + e) / 2 + r^2 / 2,

which is, and with which the flux is therefore found: a bound as well, and a smooth one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca

from rmesh_nlp.certificate.integrals import edge_rule
from rmesh_nlp.certificate.oscillation import POINCARE
from rmesh_nlp.certificate.raviart_thomas import reference
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule
from rmesh_nlp.problem.coefficients import Coefficient, at

DEGREE = 20
"""Degree of the rule for sources, that of the audit."""

TINY = 1e-24
"""Added to the mean square of what a source leaves, so that its root has a derivative."""

EDGE_POINTS = 10
"""Gauss points for functions on edges."""


@dataclass(frozen=True)
class ElementFunctions:
    """Functions of the columns X (6), c (8) and others of one element.

    Attributes
    ----------
    data : casadi.Function
        ``X -> source at the vertices (3), moments of the obstacle (3)``.
    oscillation : casadi.Function
        ``X -> r``.
    slope : casadi.Function
        ``(X, c, nu, omega, P, e) -> derivative by X`` of less the energy and the oscillation term, with nu
        against the coefficients that the source prescribes or, with an obstacle, omega against the forces
        of the source and P against the moments of the obstacle.
    varies : bool
        Whether there is an oscillation term.
    """

    data: ca.Function
    oscillation: ca.Function
    slope: ca.Function
    varies: bool


def element_functions(
    source: Coefficient, conductivity: float, obstacle: Coefficient | None
) -> ElementFunctions:
    """The functions of the elements of one law."""
    X_column, c, e = ca.SX.sym("X", 6), ca.SX.sym("c", 8), ca.SX.sym("e")
    nu, omega, P = ca.SX.sym("nu", 3), ca.SX.sym("omega", 3), ca.SX.sym("P", 3)
    X = ca.reshape(X_column, 2, 3)
    F = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    area = (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]) / 2
    metric = F.T @ F / (4 * area * conductivity)

    def square(products: Array) -> ca.SX:
        matrices = products.reshape(2, 2, 8, 8)
        pairs = [metric[i, j] * (c.T @ ca.DM(matrices[i, j]) @ c) for i in range(2) for j in range(2)]
        return sum(pairs[1:], pairs[0])

    values, remainder = _linear_part(source, X)
    moments = ca.SX.zeros(3) if obstacle is None else _moments(obstacle, X, *triangle_rule(DEGREE))[0]
    varies = callable(source)
    lagrangian, r = -square(reference().products) / 2, ca.SX(0)
    if varies:
        sides = [ca.sumsqr(X[:, i] - X[:, i - 1]) for i in range(3)]
        h_square = ca.fmax(ca.fmax(*sides[:2]), sides[2])
        r = POINCARE * ca.sqrt(h_square * area * (remainder + TINY) / conductivity)
        lagrangian -= r * (square(reference().variations) / e + e) / 2 + r**2 / 2
    if obstacle is None:
        given = ca.vertcat(ca.sum1(values) / 3, values[0] - values[2], values[1] - values[2])
        lagrangian -= 2 * area * ca.dot(nu, given)
    else:
        lagrangian -= area * ca.dot(omega, values) + ca.dot(P, moments)
    return ElementFunctions(
        ca.Function("data", [X_column], [ca.densify(values), ca.densify(moments)]),
        ca.Function("oscillation", [X_column], [ca.densify(r)]),
        ca.Function("slope", [X_column, c, nu, omega, P, e], [ca.densify(ca.gradient(lagrangian, X_column))]),
        varies,
    )


def _moments(f: Coefficient, X: ca.SX, barycentric: Array, weights: Array) -> tuple[ca.SX, list[Any]]:
    """Integrals against the barycentric coordinates over the measure of the simplex, and values."""
    if not callable(f):
        return ca.SX([float(f) / barycentric.shape[0]] * barycentric.shape[0]), []
    values = [at(f, *ca.vertsplit(X @ point)) for point in barycentric.T]
    parts = [w * value * ca.DM(point) for w, value, point in zip(weights, values, barycentric.T, strict=True)]
    return ca.SX(sum(parts[1:], parts[0])), values


def _linear_part(f: Coefficient, X: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Values at the vertices of the best linear approximation, and the mean square of what it leaves."""
    if not callable(f):
        return ca.SX([float(f)] * 3), ca.SX(0)
    barycentric, weights = triangle_rule(DEGREE)
    moments, values = _moments(f, X, barycentric, weights)
    linear = 12 * moments - 3 * ca.sum1(moments)
    rest = [
        w * (value - ca.dot(linear, ca.DM(point))) ** 2
        for w, value, point in zip(weights, values, barycentric.T, strict=True)
    ]
    return linear, sum(rest[1:], rest[0])


def moments_on_edge(f: Coefficient) -> ca.Function:
    """``(X, weights) -> derivative by X`` (4) of weights . moments of f on an edge with ends X."""
    return _on_edge(f, lambda X, moments: moments)


def forces_on_edge(f: Coefficient) -> ca.Function:
    """The same for forces of a traction f: its best linear approximation at the ends, times the length."""
    return _on_edge(
        f,
        lambda X, m: ca.norm_2(X[:, 1] - X[:, 0]) * ca.vertcat(4 * m[0] - 2 * m[1], 4 * m[1] - 2 * m[0]),
    )


def _on_edge(f: Coefficient, quantity: Callable[[ca.SX, ca.SX], ca.SX]) -> ca.Function:
    X_column, weights = ca.SX.sym("X", 4), ca.SX.sym("w", 2)
    X = ca.reshape(X_column, 2, 2)
    total = ca.dot(weights, quantity(X, _moments(f, X, *edge_rule(EDGE_POINTS))[0]))
    return ca.Function("edge", [X_column, weights], [ca.densify(ca.gradient(total, X_column))])
