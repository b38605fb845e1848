"""Elements and contact edges beside a curve, whose edge is an arc and not its chord.

With chords the polygon through sliding nodes would lose area and contact as edges grow, and an optimiser
would find that. A triangle with an arc between its nodes a and b, apex c, is blended
(:mod:`rmesh_nlp.problem.body`): with r from 0 at the apex to 1 at the arc, and s from a to b,

    x(r, s) = c + r (chord(s) - c) + r^k (arc(s) - chord(s)),     k the order,

and the displacement is a polynomial in the barycentric coordinates ``(r (1 - s), r s, 1 - r)``. Both ``x_r``
and ``x_s / r`` are bounded, so that the gradient of u solves ``grad u x_r = u_r`` and ``grad u x_s / r = u_s
/ r``. Functions here take the parameters ``t_a, t_b`` of the curve first.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Expression, Kind
from rmesh_nlp.fem.bernstein import functions, size, slopes
from rmesh_nlp.fem.element import line_rule, vector
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem.coefficients import OPEN, Coefficient
from rmesh_nlp.problem.laws import Law, energy_density

DEGREE = 7
"""Degree of the Gauss rules along an arc and across the triangle; that of a load may ask for more."""


class Arc:
    """An arc between the parameters ``t`` (2,) of a curve; its symbols are MX if that is a spline."""

    def __init__(self, curve: Curve, t: Expression = None, kind: Kind | None = None) -> None:
        self._curve = curve
        self.kind = kind or kind_of(curve)
        self.t = self.kind.sym("t", 2) if t is None else t
        self._way = self.t[1] - self.t[0]
        if curve.closed:  # the short way round
            period = curve.interval[1] - curve.interval[0]
            self._way -= period * ca.floor(self._way / period + 0.5)

    def point(self, s: Expression) -> Expression:
        """A point (2,) of the arc at ``s`` from 0 to 1."""
        return ca.vertcat(*[function(self.t[0] + s * self._way) for function in self._curve.functions])

    def velocity(self, s: float) -> Expression:
        """Its derivative (2,) by ``s``."""
        along = self.kind.sym("s")
        slope = ca.jacobian(self.point(along), along)
        return ca.substitute([slope], [along], [self.kind(s)])[0]

    def length_per_s(self, s: float) -> Expression:
        """Length of the arc per unit of ``s``."""
        return ca.norm_2(self.velocity(s))

    def blended(
        self, apex: Expression, r: float, s: float, order: int
    ) -> tuple[Expression, Expression, Expression, Expression]:
        """A point x of the triangle to the apex, x_r, x_s / r, and the determinant of these two."""
        arc, along, part = self.point(s), self.velocity(s), r ** (order - 1)
        if order == 1:
            x, across = apex + r * (arc - apex), arc - apex
        else:
            a, b = self.point(0.0), self.point(1.0)
            chord = (1 - s) * a + s * b
            x = apex + r * (chord - apex) + r * part * (arc - chord)
            across = chord - apex + order * part * (arc - chord)
            along = part * along + (1 - part) * (b - a)
        return x, across, along, across[0] * along[1] - across[1] * along[0]


def kind_of(curve: Curve) -> Expression:
    """Kind of CasADi's symbols that the functions of a curve take."""
    return ca.SX if all(function.is_a("SXFunction") for function in curve.functions) else ca.MX


def strain_energy(law: Law, curve: Curve, order: int = 1) -> ca.Function:
    """``((t_a, t_b), X_c, (u_a, u_b, u_c, ...)) -> (energy, empty)`` of a blended triangle."""
    arc = Arc(curve)
    X, u = arc.kind.sym("X", 2), arc.kind.sym("u", law.components, size(order, 3))
    energy = arc.kind(0)
    for s, weight_s in zip(*_shares(DEGREE), strict=True):
        for r, weight_r in _across(order):
            _, across, along, det = arc.blended(X, r, s, order)
            slope = u @ ca.DM(slopes(order, _barycentric(r, s)))
            rise = slope @ ca.DM([[1 - s, -1.0], [s, 1.0], [-1.0, 0.0]])  # u_r, u_s / r
            scaled = rise @ ca.vertcat(
                ca.horzcat(along[1], -along[0]), ca.horzcat(-across[1], across[0])
            )  # det * grad u
            upright = ca.if_else(det > 0, det, np.nan)  # solvers shorten steps to triangles that fold
            energy += weight_s * weight_r * energy_density(law, scaled) / upright
    return ca.Function("arc_strain_energy", [arc.t, X, ca.vec(u)], [energy, arc.kind(0, 1)], OPEN)


def load_energy(law: Law, curve: Curve, degree: int, order: int = 1) -> ca.Function:
    """``((t_a, t_b), X_c, (u_a, u_b, u_c, ...)) -> (-integral of load . u, empty)`` of a blended triangle."""
    arc = Arc(curve)
    X, u = arc.kind.sym("X", 2), arc.kind.sym("u", law.components, size(order, 3))
    work = arc.kind(0)
    for s, weight_s in zip(*_shares(max(degree, DEGREE)), strict=True):
        for r, weight_r in zip(*_shares(max(degree, DEGREE)), strict=True):
            x, _, _, det = arc.blended(X, r, s, order)
            value = u @ ca.DM(functions(order, _barycentric(r, s)))
            work += weight_s * weight_r * r * det * ca.dot(vector(law.load, x), value)
    return ca.Function("arc_load_energy", [arc.t, X, ca.vec(u)], [-work, arc.kind(0, 1)], OPEN)


def traction_energy(value: tuple[Coefficient, ...], curve: Curve, degree: int, order: int = 1) -> ca.Function:
    """``((t_a, t_b), (u_a, u_b, ...)) -> (-integral of traction . u, empty)`` along an arc."""
    arc = Arc(curve)
    u = arc.kind.sym("u", len(value), size(order, 2))
    work = arc.kind(0)
    for s, weight in zip(*_shares(max(degree, DEGREE)), strict=True):
        displacement = u @ ca.DM(functions(order, np.array([1 - s, s])))
        work += weight * arc.length_per_s(s) * ca.dot(vector(value, arc.point(s)), displacement)
    return ca.Function("arc_traction_energy", [arc.t, ca.vec(u)], [-work, arc.kind(0, 1)], OPEN)


def friction_energy(bound: Coefficient, curve: Curve, degree: int, order: int = 1) -> ca.Function:
    """``((t_a, t_b), (s_a, s_b, ...)) -> (integral of g times the slip magnitudes so given, empty)``."""
    arc = Arc(curve)
    slip = arc.kind.sym("slip", size(order, 2))
    energy = arc.kind(0)
    for s, weight in zip(*_shares(degree), strict=True):
        value = ca.dot(ca.DM(functions(order, np.array([1 - s, s]))), slip)
        energy += weight * arc.length_per_s(s) * vector((bound,), arc.point(s)) * value
    return ca.Function("arc_friction_energy", [arc.t, slip], [energy, arc.kind(0, 1)], OPEN)


def _shares(degree: int) -> tuple[Array, Array]:
    """Shares s of the second end, and weights."""
    points, weights = line_rule(degree)
    return points[1], weights


def _across(order: int) -> list[tuple[float, float]]:
    """Points r, and weights times r; nothing depends on r at order 1."""
    if order == 1:
        return [(1.0, 0.5)]
    return [(r, weight * r) for r, weight in zip(*_shares(DEGREE), strict=True)]


def _barycentric(r: float, s: float) -> Array:
    """Coordinates (3,) to a, b and the apex."""
    return np.array([r * (1 - s), r * s, 1 - r])
