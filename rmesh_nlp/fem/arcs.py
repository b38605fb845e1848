"""Elements and contact edges beside a curve, whose edge is an arc and not its chord.

With chords the polygon through sliding nodes would lose area and contact as edges grow, and an optimiser
would find that. A triangle with an arc between its nodes a and b, apex c, is blended
(:mod:`rmesh_nlp.problem.body`): with r from 0 at the apex to 1 at the arc, and s from a to b,

    x(r, s) = c + r (arc(s) - c),     u(r, s) = u_c + r ((1 - s) u_a + s u_b - u_c).

The gradient of u does not depend on r: it solves ``grad u (arc(s) - c) = u_ab(s) - u_c`` and
``grad u arc'(s) = u_b - u_a``. Functions here take the parameters ``t_a, t_b`` of the curve first.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import line_rule, vector
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.laws import Law, energy_density

DEGREE = 7
"""Degree of the Gauss rules along an arc and across the triangle; that of a load may ask for more."""


class Arc:
    """An arc between the parameters ``t`` (2,) of a curve; its symbols are MX if that is a spline."""

    def __init__(self, curve: Curve, t: Any = None, kind: Any = None) -> None:
        self._curve = curve
        self.kind = kind or kind_of(curve)
        self.t = self.kind.sym("t", 2) if t is None else t
        self._way = self.t[1] - self.t[0]
        if curve.closed:  # the short way round
            period = curve.interval[1] - curve.interval[0]
            self._way -= period * ca.floor(self._way / period + 0.5)

    def point(self, s: Any) -> Any:
        """A point (2,) of the arc at ``s`` from 0 to 1."""
        return ca.vertcat(*[function(self.t[0] + s * self._way) for function in self._curve.functions])

    def velocity(self, s: float) -> Any:
        """Its derivative (2,) by ``s``."""
        along = self.kind.sym("s")
        slope = ca.jacobian(self.point(along), along)
        return ca.substitute([slope], [along], [self.kind(s)])[0]

    def length_per_s(self, s: float) -> Any:
        """Length of the arc per unit of ``s``."""
        return ca.norm_2(self.velocity(s))

    def seen_from(self, apex: Any, s: float) -> tuple[Any, Any, Any]:
        """The way to a point of the arc, the velocity there, and their determinant."""
        way, velocity = self.point(s) - apex, self.velocity(s)
        return way, velocity, way[0] * velocity[1] - way[1] * velocity[0]


def kind_of(curve: Curve) -> Any:
    """Kind of CasADi's symbols that the functions of a curve take."""
    return ca.SX if all(function.is_a("SXFunction") for function in curve.functions) else ca.MX


def strain_energy(law: Law, curve: Curve) -> ca.Function:
    """``((t_a, t_b), X_c, (u_a, u_b, u_c)) -> (energy, empty)`` of a blended triangle."""
    arc = Arc(curve)
    X, u = arc.kind.sym("X", 2), arc.kind.sym("u", law.components, 3)
    energy = arc.kind(0)
    for s, weight in zip(*_shares(DEGREE), strict=True):
        way, velocity, det = arc.seen_from(X, s)
        rise = ca.horzcat((1 - s) * u[:, 0] + s * u[:, 1] - u[:, 2], u[:, 1] - u[:, 0])
        scaled = rise @ ca.vertcat(
            ca.horzcat(velocity[1], -velocity[0]), ca.horzcat(-way[1], way[0])
        )  # det * grad u
        energy += weight * energy_density(law, scaled) / (2 * det)
    return ca.Function("arc_strain_energy", [arc.t, X, ca.vec(u)], [energy, arc.kind(0, 1)])


def load_energy(law: Law, curve: Curve, degree: int) -> ca.Function:
    """``((t_a, t_b), X_c, (u_a, u_b, u_c)) -> (-integral of load . u, empty)`` of a blended triangle."""
    arc = Arc(curve)
    X, u = arc.kind.sym("X", 2), arc.kind.sym("u", law.components, 3)
    work = arc.kind(0)
    for s, weight_s in zip(*_shares(max(degree, DEGREE)), strict=True):
        way, _, det = arc.seen_from(X, s)
        for r, weight_r in zip(*_shares(max(degree, DEGREE)), strict=True):
            value = u[:, 2] + r * ((1 - s) * u[:, 0] + s * u[:, 1] - u[:, 2])
            work += weight_s * weight_r * r * det * ca.dot(vector(law.load, X + r * way), value)
    return ca.Function("arc_load_energy", [arc.t, X, ca.vec(u)], [-work, arc.kind(0, 1)])


def traction_energy(value: tuple[Coefficient, ...], curve: Curve, degree: int) -> ca.Function:
    """``((t_a, t_b), (u_a, u_b)) -> (-integral of traction . u, empty)`` along an arc."""
    arc = Arc(curve)
    u = arc.kind.sym("u", len(value), 2)
    work = arc.kind(0)
    for s, weight in zip(*_shares(max(degree, DEGREE)), strict=True):
        here = (1 - s) * u[:, 0] + s * u[:, 1]
        work += weight * arc.length_per_s(s) * ca.dot(vector(value, arc.point(s)), here)
    return ca.Function("arc_traction_energy", [arc.t, ca.vec(u)], [-work, arc.kind(0, 1)])


def friction_energy(bound: Coefficient, curve: Curve, degree: int) -> ca.Function:
    """``((t_a, t_b), (s_a, s_b)) -> (integral of g times the interpolated slip magnitudes, empty)``."""
    arc = Arc(curve)
    slip = arc.kind.sym("slip", 2)
    energy = arc.kind(0)
    for s, weight in zip(*_shares(degree), strict=True):
        value = (1 - s) * slip[0] + s * slip[1]
        energy += weight * arc.length_per_s(s) * vector((bound,), arc.point(s)) * value
    return ca.Function("arc_friction_energy", [arc.t, slip], [energy, arc.kind(0, 1)])


def _shares(degree: int) -> tuple[Array, Array]:
    """Shares s of the second end, and weights."""
    points, weights = line_rule(degree)
    return points[1], weights
