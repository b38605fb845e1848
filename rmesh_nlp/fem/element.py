"""The function of one element, and its derivatives.

An element function may have an argument more than its columns: sums ``sum_p W_ip f(x_p)`` of a load f at
points ``x_p = sum_b l_b(p) X_b`` of the element, whose vertices ``X_b`` are its first column. f is
differentiated by x and y alone, and evaluated for all points of all elements at a time. The chain rule,
``sum_p W_ip l_b f'`` and ``sum_p W_ip l_b l_c f''``, brings its derivatives to the vertices, so that the
function of an element does not grow with the rule. In an element that a jump of f crosses the sums are those
of the pieces on both sides, triangles as well, to which the same applies.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Expression, Index, kind_of
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at
from rmesh_nlp.vectorised import Columns, columnwise

TOGETHER = 16
"""Cut elements that are evaluated at a time."""

NO_ROWS = ca.SX(0, 1)
"""The constraints of an element that adds to the objective alone."""


class PointSums:
    """Sums with ``weights`` (sums, points) of ``function``, ``(x, y) -> column``, at points of elements.

    ``shares`` (vertices, points) are the barycentric coordinates of the points. What was evaluated last is
    kept, for all equal sums: the contact system of a mesh and derivatives of its energy need the same.

    ``cut`` is there if a jump of f may cross an element: ``(X,) -> (sums, values)``, the sums of the pieces
    of the element between its zeros, and the values of switches (vertices, switches). It is taken where a
    column of these has two signs.
    """

    def __init__(
        self, function: ca.Function, shares: Array, weights: Array, cut: ca.Function | None = None
    ) -> None:
        self.function, self.shares, self.weights, self.cut = function, shares, weights, cut

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PointSums) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[str, bytes, bytes, str]:
        cut = "" if self.cut is None else self.cut.serialize()
        return self.function.serialize(), self.shares.tobytes(), self.weights.tobytes(), cut

    def __call__(self, X: Expression) -> Expression:
        """The argument of an element function, from its first one: all sums for each component of f."""
        if self.cut is not None:
            return self.cut(X)[0]
        points = ca.horzsplit(ca.reshape(X, 2, -1) @ ca.DM(self.shares))
        # by the function itself, which may have free symbols
        values = ca.horzcat(*(self.function(*ca.vertsplit(point)) for point in points))
        return ca.vec(ca.DM(self.weights) @ values.T)

    def evaluated(self, X: Array, count: int) -> list[Array]:
        """The first so many of sums, their derivatives and second ones, at X (2 vertices, elements).

        Each is (numbers, elements), in the order that :meth:`in_matrix` takes.
        """
        kept = _kept(self)
        if not (kept and count <= len(kept[1]) and np.array_equal(kept[0], X)):
            kept[:] = X, self._at(X, count)
            if self.cut is not None:
                self._put_cut(X, kept[1])
        return kept[1][:count]

    def _at(self, X: Array, count: int) -> list[Array]:
        """The same by the rule of the whole element."""
        points, n = self.shares.shape[1], X.shape[1]
        x, y = ((self.shares.T @ X[k::2]).reshape(1, -1) for k in range(2))
        values = _derivatives(self._key[0], count, points * n)([x, y])
        return [self._summed(each.reshape(-1, points, n), k) for k, each in enumerate(values)]

    def _summed(self, values: Array, order: int) -> Array:
        """Sums of derivatives of an order (x or y, ..., component; points, elements), times shares."""
        weights = self.weights
        for _ in range(order):
            weights = weights[..., None, :] * self.shares
        return (weights.reshape(-1, weights.shape[-1]) @ values).reshape(-1, values.shape[-1])

    def _put_cut(self, X: Array, results: list[Array]) -> None:
        """Put sums of pieces, and their derivatives, in the place of those of elements that are cut."""
        switches, sums = _of_cut(self._key[3], len(results), X.shape[1])
        signs = np.sign(switches([X])[0]).reshape(-1, len(X) // 2, X.shape[1])
        cut = np.flatnonzero(np.any(np.ptp(signs, axis=1) == 2, axis=0))
        for first in range(0, cut.size, TOGETHER):
            batch = cut[first : first + TOGETHER]
            values = sums([X[:, np.resize(batch, TOGETHER)]])
            for order, (result, value) in enumerate(zip(results, values, strict=True)):
                result[self._numbers(len(result), order)[:, None], batch] = value[:, : batch.size]

    def in_matrix(self, column: Expression, order: int) -> Expression:
        """The matrix (sums, 2 vertices, ...) of derivatives by X of the numbers of an element."""
        numbers = self._numbers(column.shape[0], order)
        return ca.reshape(column[numbers.tolist()], -1, (2 * len(self.shares)) ** order)

    def _numbers(self, size: int, order: int) -> Index:
        """Which of so many numbers stand in the matrix of :meth:`in_matrix`, column by column."""
        shape = [2] * order + [-1, len(self.weights)] + [len(self.shares)] * order
        columns = [axis for k in range(order) for axis in (order + 2 + k, k)]
        return np.arange(size).reshape(shape).transpose(*columns, order, order + 1).ravel()


@lru_cache(maxsize=8)  # loads of the regions of a problem
def _kept(sums: PointSums) -> list[Any]:
    """Where values of equal sums are kept: X, and what :meth:`PointSums.evaluated` returns."""
    return []


@lru_cache
def _derivatives(text: str, count: int, n: int) -> Columns:
    """``(x, y) ->`` value, derivatives by x and y, and by xx, yx, xy and yy, up to ``count``, at n points."""
    value = ca.Function.deserialize(text)
    kind = kind_of(value)
    x, y = kind.sym("x"), kind.sym("y")
    results = [value(x, y)]
    for _ in range(1, count):
        results.append(ca.vertcat(*(ca.jacobian(results[-1], symbol) for symbol in (x, y))))
    return columnwise(ca.Function("derivatives", [x, y], [ca.densify(r) for r in results]), n)


@lru_cache
def _of_cut(text: str, count: int, n: int) -> tuple[Columns, Columns]:
    """Switches at the vertices of n elements; and sums of TOGETHER that are cut, with their derivatives."""
    cut = ca.Function.deserialize(text)
    X = ca.SX.sym("X", cut.size1_in(0))
    sums, switches = map(ca.densify, cut(X))
    results = [sums]
    for _ in range(1, count):
        results.append(ca.densify(ca.jacobian(results[-1], X)))
    whole = ca.Function("cut", [X], results)
    return columnwise(ca.Function("switches", [X], [switches]), n), columnwise(whole, TOGETHER)


def with_design(function: ca.Function, at_points: PointSums | None) -> tuple[ca.Function, tuple[str, ...]]:
    """An element function whose first argument are the design variables that it depends on, and their names.

    Sums are put in; without such variables it is returned as it is.
    """
    parts = (function,) if at_points is None else (function, at_points.function)
    free = {symbol.name(): symbol for part in parts if part.has_free() for symbol in part.free_sx()}
    if not free:
        return function, ()
    whole, names = plain(function, at_points), tuple(sorted(free))
    columns, symbols = local_symbols(whole), ca.vertcat(*(free[name] for name in names))
    return ca.Function(function.name(), [symbols, *columns], whole(*columns)), names


def local_symbols(function: ca.Function) -> list[Expression]:
    """Symbols for the arguments of a local function, of the kind that it is made of."""
    kind = kind_of(function)
    return [kind.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]


def plain(function: ca.Function, at_points: PointSums | None) -> ca.Function:
    """An element function of its columns alone, the sums put in."""
    if at_points is None:
        return function
    columns = local_symbols(function)[:-1]
    return ca.Function(function.name(), columns, function(*columns, at_points(columns[0])), OPEN)


def vector(components: tuple[Coefficient, ...], x: Expression, y: Expression) -> Expression:
    """Values of coefficients at a point, one below the other."""
    return ca.vertcat(*[at(component, x, y) for component in components])


class Differentiated:
    """An element function ``(*columns[, sums at points]) -> (f, g)`` and its derivatives by some columns.

    They are Functions of the columns, of multipliers, and of what :meth:`PointSums.evaluated` returns. Where
    f is constantly zero it has no nonzero, and no derivative has one.
    """

    def __init__(self, function: ca.Function, at_points: PointSums | None, variable: tuple[int, ...]) -> None:
        self._columns = local_symbols(function)
        self._kind = kind = type(self._columns[0])
        self._x = ca.vertcat(kind(0, 1), *[self._columns[i] for i in variable])
        self._f, self._g = function(*self._columns)
        self._sums, self._slope, self._inputs = kind(0, 1), kind(0, self._x.shape[0]), []
        self._curvature = lambda _: kind(*2 * self._x.shape[:1])
        if at_points is not None:
            self._sums, X = self._columns.pop(), self._columns[0]
            n, X_by_x = X.shape[0], ca.DM(ca.jacobian(X, self._x))
            slope, second = (kind.sym(f"d{k}", self._sums.shape[0] * n**k) for k in (1, 2))
            self._inputs, self._slope = [self._sums, slope, second], at_points.in_matrix(slope, 1) @ X_by_x
            by_X = at_points.in_matrix(second, 2).T
            self._curvature = lambda weights: X_by_x.T @ ca.reshape(by_X @ weights, n, n) @ X_by_x

    @cached_property
    def first(self) -> ca.Function:
        """Value f, its gradient, rows g and their Jacobian."""
        f, g, x, sums = self._f, self._g, self._x, self._sums
        gradient = ca.gradient(f, x) + self._slope.T @ ca.gradient(f, sums)
        jacobian = ca.jacobian(g, x) + ca.jacobian(g, sums) @ self._slope
        return self._made("first", [f, gradient, g, jacobian], self._inputs[:2])

    @cached_property
    def second(self) -> ca.Function:
        """Upper triangle of the Hessian of ``lam_f f + lam_g . g``; takes lam_f and lam_g as well."""
        lam_f, lam_g = self._kind.sym("lam_f"), self._kind.sym("lam_g", self._g.shape[0])
        lagrangian, slope = lam_f * self._f + ca.dot(lam_g, self._g), self._slope
        by_sums = ca.gradient(lagrangian, self._sums)
        mixed = ca.jacobian(by_sums, self._x).T @ slope
        hessian = ca.hessian(lagrangian, self._x)[0] + mixed + mixed.T + self._curvature(by_sums)
        hessian += slope.T @ ca.jacobian(by_sums, self._sums) @ slope
        return self._made("second", [ca.triu(hessian)], [lam_f, lam_g, *self._inputs])

    def _made(self, name: str, results: list[Expression], others: list[Expression]) -> ca.Function:
        results = [self._kind(*r.shape) if r.is_zero() else r for r in results]
        return ca.Function(name, [*self._columns, *others], results)


def differentiated(
    function: ca.Function, at_points: PointSums | None, variable: tuple[int, ...]
) -> Differentiated:
    """:class:`Differentiated`, kept: the meshes of one problem have the same element functions.

    Functions are told apart by what they compute, so that it does not matter who made them, and when.
    """
    try:
        text = function.serialize()
    except RuntimeError:  # a Function of someone's own that cannot be written as text
        return Differentiated(function, at_points, variable)
    return _differentiated(text, at_points, variable)


@lru_cache
def _differentiated(text: str, at_points: PointSums | None, variable: tuple[int, ...]) -> Differentiated:
    return Differentiated(ca.Function.deserialize(text), at_points, variable)
