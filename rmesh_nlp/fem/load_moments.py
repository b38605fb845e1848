"""The work of loads on triangles in closed form, by their moments.

With f at the points of a rule, shape functions phi and area A of a triangle, the work is A sum_a u_a . m_a. A
moment m_a, the sum of weight, f and phi_a over the points, changes with the corner x_b by the sum of weight,
phi_a lambda_b and the slope of f: neither depends on the displacement.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.fem.closed_forms import CHUNK, PAIR, PAIRS, Layout, Triangles
from rmesh_nlp.fem.space import Index
from rmesh_nlp.vectorised import Columns, columnwise

LEADING: tuple[tuple[int, ...], ...] = ((), (2,), (3,))
"""Numbers of values, slopes and second derivatives of each component at a point."""


class Load:
    """Minus the work of a load (components,) by a rule of points (3, k) and weights (k,), times a weight.

    Displacements are of an order.
    Its moments at the last positions are kept: a contact solve and the gradient there need the same.
    """

    arguments = 2

    def __init__(
        self, value: ca.Function, rule: tuple[Array, Array], order: int = 1, weight: float = 1.0
    ) -> None:
        self._value, self._rule, self._order, self._weight = value, rule, order, weight
        shares, weights = rule
        self._shares, self._functions = shares, functions(order, shares)
        self.nodes = len(self._functions)
        self._one = self._functions * weights
        self._corners = np.array([shares[a] * shares[b] * weights for a, b in PAIRS])
        if order == 1:
            self._two, self._pair = self._corners, PAIR
        else:
            self._two = (self._one[:, None] * shares).reshape(-1, weights.size)
            self._pair = np.arange(3 * self.nodes).reshape(self.nodes, 3)
        self._columns: dict[tuple[int, int], Columns] = {}
        self._kept: tuple[Array, Array, Array] | None = None

    def prepare(self, X: Array) -> None:
        """See :class:`ClosedForm`."""
        if self._kept is not None and np.array_equal(self._kept[0], X):
            return
        n, components = X.shape[1], self._value.size1_out(0)
        of_f = np.empty((components, self.nodes, n))
        of_slope = np.empty((components, 2, len(self._two), n))
        for begin in range(0, n, CHUNK):
            part = slice(begin, begin + CHUNK)
            f, slope = self._at_points(X[:, part].reshape(3, 2, -1), 1)
            np.matmul(self._one, f, out=of_f[..., part])
            np.matmul(self._two, slope, out=of_slope[..., part])
        self._kept = X.copy(), of_f, of_slope

    def value(self, at: Triangles) -> Array:
        """See :class:`ClosedForm`."""
        assert at.u is not None
        return -0.5 * self._weight * at.det * np.einsum("ain,ian->n", at.u, self._moments(at)[0])

    def first(self, at: Triangles, by_x: Array | None, by_u: Array | None) -> None:
        """See :class:`ClosedForm`."""
        assert at.u is not None
        of_f, of_slope = self._moments(at)
        scale = -0.5 * self._weight * at.det
        if by_u is not None:
            by_u += scale * of_f.swapaxes(0, 1)
        if by_x is not None:
            at.by_det -= 0.5 * self._weight * np.einsum("ain,ian->n", at.u, of_f)
            by_x += scale * self._contracted(at.u, of_slope)

    def second(self, at: Triangles, layout: Layout, out: Array) -> None:
        """See :class:`ClosedForm`."""
        assert at.u is not None
        if not layout.positions:
            return
        f, slope, bend = self._at_points(at.x, 2)
        of_f, of_slope = self._one @ f, self._two @ slope
        at.by_det -= 0.5 * self._weight * np.einsum("ain,ian->n", at.u, of_f)
        at.beside -= 0.5 * self._weight * self._contracted(at.u, of_slope)
        scale = -0.5 * self._weight * at.det
        there = np.matmul(self._functions.T, at.u.swapaxes(0, 1))  # the displacement at the points
        curved = scale * (self._corners @ np.sum(there[:, None] * bend, axis=0))  # (xx xy yy, pairs, n)
        for pair, (a, b) in enumerate(PAIRS):
            for i in range(2):
                for j in range(2 if a < b else i + 1):
                    low, high = sorted((2 * a + j, 2 * b + i))
                    out[layout.starts[high] + low] += curved[i + j, pair]
        if layout.displacements:
            components = len(of_f)
            for a in range(self.nodes):
                for i in range(components):
                    start = layout.starts[6 + components * a + i]
                    column = scale * of_slope[i][:, self._pair[a]].swapaxes(0, 1)
                    column -= 0.5 * self._weight * of_f[i, a] * at.b
                    out[start : start + 6] += column.reshape(6, -1)

    def some(self, chosen: Index) -> Load:
        """See :class:`ClosedForm`."""
        return Load(self._value, self._rule, self._order, self._weight)

    def scaled(self, weight: float) -> Load:
        """See :class:`ClosedForm`."""
        return Load(self._value, self._rule, self._order, weight * self._weight)

    def _moments(self, at: Triangles) -> tuple[Array, Array]:
        assert self._kept is not None
        _, of_f, of_slope = self._kept
        return of_f[..., at.part], of_slope[..., at.part]

    def _contracted(self, u: Array, of_slope: Array) -> Array:
        """``sum_a,i u_ai G_i,l,ab`` as (3 corners b, 2 directions l, n)."""
        result = np.zeros((3, 2, u.shape[2]))
        for a in range(self.nodes):
            for i in range(u.shape[1]):
                result += (u[a, i] * of_slope[i][:, self._pair[a]]).swapaxes(0, 1)
        return result

    def _at_points(self, corners: Array, order: int) -> list[Array]:
        """Values (components, points, n) of the load, of its slopes by x and y, of xx, xy and yy."""
        points = np.matmul(self._shares.T, corners.swapaxes(0, 1))
        size = points[0].size
        if (order, size) not in self._columns:
            self._columns[order, size] = columnwise(_derivatives(self._value, order), size)
        found = self._columns[order, size]([part.reshape(1, -1) for part in points])
        components, shape = self._value.size1_out(0), points.shape[1:]
        return [part.reshape(components, *extra, *shape) for part, extra in zip(found, LEADING, strict=False)]


def _derivatives(value: ca.Function, order: int) -> ca.Function:
    """``(x, y) ->`` values of a function, its slopes, and with order 2 its second derivatives."""
    return _differentiated(value.serialize(), order)


@lru_cache(maxsize=64)
def _differentiated(text: str, order: int) -> ca.Function:
    value = ca.Function.deserialize(text)
    kind = ca.SX if value.is_a("SXFunction") else ca.MX
    x, y = kind.sym("x"), kind.sym("y")
    f = value(x, y)
    by_x, by_y = ca.jacobian(f, x), ca.jacobian(f, y)
    parts = [[f], [by_x, by_y], [ca.jacobian(by_x, x), ca.jacobian(by_x, y), ca.jacobian(by_y, y)]]
    # component by component, so that the derivatives of one lie side by side
    results = [ca.densify(ca.vec(ca.horzcat(*part).T)) for part in parts[: order + 1]]
    return ca.Function("load", [x, y], ca.cse(results))
