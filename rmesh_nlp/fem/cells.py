"""Triangles and edges of a mesh as symbols, and integrals over them as expressions.

Beside a curve an edge is an arc and not its chord. With chords the polygon through sliding nodes would lose
area and contact as edges grow, and an optimiser would find that. A triangle with an arc between its nodes a
and b, apex c, is blended (:mod:`rmesh_nlp.problem.body`): with r from 0 at the apex to 1 at the arc, and s
from a to b,

    x(r, s) = c + r (chord(s) - c) + r^k (arc(s) - chord(s)),     k the order,

and the displacement is a polynomial in the barycentric coordinates ``(r (1 - s), r s, 1 - r)``. Both ``x_r``
and ``x_s / r`` are bounded, so that the gradient of u solves ``grad u x_r = u_r`` and ``grad u x_s / r = u_s
/ r``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Expression, Kind, cross, kind_of
from rmesh_nlp.fem.bernstein import SIDES, size, slopes
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at
from rmesh_nlp.problem.quadrature import CORNER, MIDPOINT, line_rule, triangle_rule
from rmesh_nlp.problem.switches import polynomial_degree

Density = Callable[[Expression, Expression, Expression, Expression], Expression]
"""``(x, y, u, more) -> value`` at a point: ``more`` is the gradient of u (components, 2) in triangles, and on
edges the unit normal (2,) to the right of the way from the first to the last end."""

Rule = Iterable[tuple[Expression, Expression]]
"""Barycentric coordinates of points, and weights."""

DEGREE = 7
"""Least degree of the Gauss rules along an arc and across the triangle beside it."""


SMOOTH_DEGREE = 4
"""What a measure that is no polynomial adds to the degree of a rule."""


class Point(NamedTuple):
    """A point x (2,) of a cell; the measure is ``part * det``, and a density takes ``scaled / det`` last."""

    x: Expression
    part: Expression
    det: Expression
    scaled: Expression


class Cell(ABC):
    """A triangle or an edge by symbols for its place, and for u (components, nodes) there.

    ``columns`` are the arguments of functions of it: u is the last one. ``measure`` is that of the law: all
    integrals have it. Cells are equal if functions of them are, whatever their symbols.
    """

    def __init__(
        self,
        columns: list[Expression],
        corners: int,
        components: int,
        order: int,
        measure: Coefficient,
        curve: Curve | None = None,
    ) -> None:
        self.kind, self.order, self.measure = type(columns[0]), order, measure
        self._key = type(self), self.kind, corners, components, order, measure, curve
        u = self.kind.sym("u", components * size(order, corners))
        self.columns, self.u = [*columns, u], ca.reshape(u, components, -1)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cell) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @abstractmethod
    def rule(self, degree: int | str) -> Rule:
        """A rule that is exact for polynomials of a degree; its weights sum to 1 on the reference cell.

        In triangles it may be :func:`triangle_rule`'s "midpoint".
        """

    @abstractmethod
    def _at(self, shares: Expression) -> Point:
        """What :meth:`at` gives, without the measure of the law."""

    def at(self, shares: Expression) -> Point:
        """What an integrand takes at barycentric coordinates."""
        point = self._at(shares)
        return point._replace(part=point.part * at(self.measure, *ca.vertsplit(point.x)))

    def displacement(self, shares: Expression) -> Expression:
        """Its value (components,) at barycentric coordinates."""
        return self.u @ shape_functions(self.order, shares)

    def integral(self, density: Density, rule: Rule) -> Expression:
        """The integral of a density."""
        total = self.kind(0)
        for shares, weight in rule:
            point = self.at(shares)
            x, y = ca.vertsplit(point.x)
            value = density(x, y, self.displacement(shares), point.scaled / point.det)
            total += weight * point.part * point.det * value
        return total

    def function(self, name: str, value: Expression) -> ca.Function:
        """``columns -> (value, empty)``."""
        return ca.Function(name, self.columns, [value, self.kind(0, 1)], OPEN)


class Straight(Cell):
    """A triangle with three corners or an edge with two, by the positions X (2, corners) of these."""

    def __init__(
        self, corners: int, components: int, order: int, measure: Coefficient = 1.0, kind: Kind = ca.SX
    ) -> None:
        X = kind.sym("X", 2 * corners)
        super().__init__([X], corners, components, order, measure)
        self.X = ca.reshape(X, 2, corners)

    def rule(self, degree: int | str) -> Rule:
        """See :class:`Cell`."""
        points, weights = measured_rule(self.X.shape[1], degree, self.measure)
        return zip(points.T, weights, strict=True)

    @property
    def energy_rule(self) -> Rule:
        """Exact for a quadratic function of the gradient of u in a triangle."""
        return self.rule(1 if self.order == 1 else MIDPOINT)

    def _at(self, shares: Expression) -> Point:
        """See :class:`Cell`."""
        if self.X.shape[1] == 2:
            x, y = ca.vertsplit(self.X[:, 1] - self.X[:, 0])
            return Point(self.X @ shares, 1.0, ca.norm_2(ca.vertcat(x, y)), ca.vertcat(y, -x))
        slope, second, third = (ca.DM(slopes(self.order, corner)) for corner in np.eye(3))
        if self.order == 2:  # linear in coordinates, which may be expressions
            slope = shares[0] * slope + shares[1] * second + shares[2] * third
        return Point(self.X @ shares, 0.5, *affine(self.X, self.u @ slope))


class Arc(Cell):
    """An edge on a curve, by the parameters (2,) of its ends."""

    def __init__(self, curve: Curve, components: int, order: int, measure: Coefficient) -> None:
        self._arc = ArcPoints(curve)
        super().__init__([self._arc.t], 2, components, order, measure, curve)

    def rule(self, degree: int | str) -> Rule:
        """See :class:`Cell`."""
        points, weights = line_rule(_along_curves(degree))
        return zip(points.T, weights, strict=True)

    def _at(self, shares: Expression) -> Point:
        """See :class:`Cell`."""
        x, y = ca.vertsplit(self._arc.velocity(shares[1]))
        return Point(self._arc.point(shares[1]), 1.0, ca.norm_2(ca.vertcat(x, y)), ca.vertcat(y, -x))


class Blended(Cell):
    """A triangle beside a curve, by the parameters (2,) of the ends of its arc and its apex X (2,)."""

    def __init__(self, curve: Curve, components: int, order: int, measure: Coefficient = 1.0) -> None:
        self._arc = ArcPoints(curve)
        self._apex = self._arc.kind.sym("X", 2)
        super().__init__([self._arc.t, self._apex], 3, components, order, measure, curve)

    def rule(self, degree: int | str) -> Rule:
        """See :class:`Cell`."""
        return self._rule(_along_curves(degree), _along_curves(degree))

    @property
    def energy_rule(self) -> Rule:
        """For a quadratic function of the gradient of u; at order 1 only the measure depends on r."""
        return self._rule(DEGREE, 1 if self.order == 1 else DEGREE)

    def _rule(self, along: int, across: int) -> Rule:
        for (_, s), of_s in zip(line_rule(along)[0].T, line_rule(along)[1], strict=True):
            for (_, r), of_r in zip(line_rule(across)[0].T, line_rule(across)[1], strict=True):
                yield np.array([r * (1 - s), r * s, 1 - r]), of_s * of_r

    def _at(self, shares: Expression) -> Point:
        """See :class:`Cell`; a folded triangle has no measure, so that solvers shorten steps to it."""
        r, s = shares[0] + shares[1], shares[1] / (shares[0] + shares[1])
        arc, along = self._arc.point(s), self._arc.velocity(s)
        a, b = self._arc.point(0.0), self._arc.point(1.0)
        chord, part = (1 - s) * a + s * b, r ** (self.order - 1)
        x = self._apex + r * (chord - self._apex) + r * part * (arc - chord)
        across = chord - self._apex + self.order * part * (arc - chord)  # x_r
        along = part * along + (1 - part) * (b - a)  # x_s / r
        det = cross(across, along)
        by_rs = np.array([[1 - s, -1.0], [s, 1.0], [-1.0, 0.0]])
        rise = self.u @ ca.DM(slopes(self.order, shares) @ by_rs)  # u_r, u_s / r
        turn = ca.vertcat(ca.horzcat(along[1], -along[0]), ca.horzcat(-across[1], across[0]))
        return Point(x, r, ca.if_else(det > 0, det, np.nan), rise @ turn)


class ArcPoints:
    """Points of an arc between the parameters ``t`` (2,) of a curve; symbols are MX if that is a spline."""

    def __init__(self, curve: Curve, t: Expression = None, kind: Kind | None = None) -> None:
        self._curve = curve
        self.kind = kind or kind_of(*curve.functions)
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


def measured_rule(corners: int, degree: int | str, measure: Coefficient) -> tuple[Array, Array]:
    """The rule of an edge or a triangle for polynomials of a degree times a measure; else as that is.

    Barycentric coordinates (corners, points) and weights (points,), summing to 1.
    """
    if isinstance(degree, str):
        return triangle_rule(degree)
    more = polynomial_degree(measure)
    degree = int(degree) + (SMOOTH_DEGREE if more is None else more)
    return line_rule(degree) if corners == 2 else triangle_rule(degree)


def _along_curves(degree: int | str) -> int:
    return 13 if degree == CORNER else DEGREE if degree == MIDPOINT else max(int(degree), DEGREE)


def shape_functions(order: int, shares: Expression) -> Expression:
    """Values (functions,) at barycentric coordinates, which may be expressions; see :mod:`.bernstein`."""
    if order == 1:
        return ca.vertcat(shares)
    each = ca.vertsplit(ca.vertcat(shares))
    return ca.vertcat(*(share**2 for share in each), *(2 * each[a] * each[b] for a, b in SIDES[len(each)]))


def affine(X: Expression, u: Expression) -> tuple[Expression, Expression]:
    """``(det, det * grad u)`` on the triangle X (2, 3): twice its area, and u (components, 3) linear there.

    At a point the gradient of a u of any order is that of the linear one ``u @ bernstein.slopes``. A
    quadratic density of the gradient is so divided by ``det`` once, at the end.
    """
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = cross(edges[:, 0], edges[:, 1])
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    return det, ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate
