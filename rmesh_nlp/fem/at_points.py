"""Values of a load, or of an exact solution, at points of elements, and how they change with the positions.

At a point ``x_p = sum_b l_b(p) X_b`` of an element with vertices X_b the value of a function f has the
derivatives ``l_b f'`` and ``l_b l_c f''``. An element function takes the values as an argument, and the chain
rule brings their derivatives to the vertices: f is differentiated by x and y alone, and its derivatives on a
mesh are evaluated once for all element functions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Expression, Kind
from rmesh_nlp.problem.coefficients import OPEN, PositionFunction
from rmesh_nlp.vectorised import CHUNK, Columns, columnwise


@dataclass(frozen=True, eq=False)
class PointValues:
    """Values of ``function``, ``(x, y) -> column``, at points ``X @ shares`` of elements, or sums of them.

    Attributes
    ----------
    shares : (vertices, points) array
        Barycentric coordinates of the points.
    weights : (sums, points) array, optional
        An element function takes sums of values with these weights; by default the values themselves.
        X is its first argument, the values are the last one, point by point.
    kept : list
        What was evaluated last: a solver asks for several derivatives on one mesh.
    """

    function: ca.Function
    shares: Array
    weights: Array | None = None
    kept: list[tuple[Array, list[Array]]] = field(default_factory=list, repr=False)

    @classmethod
    def of(
        cls,
        value: PositionFunction,
        shares: Array,
        weights: Array | None = None,
    ) -> PointValues:
        """Those of ``value(x, y)``, a scalar or a column."""
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        function = ca.Function("value", [x, y], [ca.densify(ca.SX(value(x, y)))], OPEN)
        return cls(function, shares, weights)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PointValues) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[object, ...]:
        weights = None if self.weights is None else self.weights.tobytes()
        return self.function.serialize(), self.shares.tobytes(), weights

    @property
    def length(self) -> int:
        """Of a value."""
        return int(self.function.size1_out(0))

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of vertices."""
        return list(combinations_with_replacement(range(len(self.shares)), 2))

    @cached_property
    def _matrices(self) -> tuple[Array, Array, Array]:
        """From derivatives at points to their sums: as they are, times shares, times pairs of shares."""
        sums = np.eye(self.shares.shape[1]) if self.weights is None else self.weights
        of_pairs = np.stack([self.shares[b] * self.shares[c] for b, c in self.pairs])
        factors = np.ones((1, sums.shape[1])), self.shares, of_pairs
        first, second, third = ((sums[:, None] * factor).reshape(-1, sums.shape[1]) for factor in factors)
        return first, second, third

    def values(self, columns: list[Expression]) -> Expression:
        """The argument of an element function, from its other ones."""
        points = ca.horzsplit(ca.reshape(columns[0], 2, -1) @ ca.DM(self.shares))
        # by the function itself, which may have free symbols
        values = ca.horzcat(*(self.function(*ca.vertsplit(point)) for point in points))
        return ca.vec(values if self.weights is None else values @ ca.DM(self.weights.T))

    def evaluated(self, X: Array, order: int) -> list[Array]:
        """Derivatives of order 0, 1, ... at X (2 * vertices, elements), each as (numbers, elements).

        They are those at the points or, where there are weights, the sums that the chain rule takes.
        """
        if not (self.kept and order < len(self.kept[0][1]) and np.array_equal(self.kept[0][0], X)):
            # who asks for values will ask for slopes
            self.kept[:] = [(X, self._evaluated(X, max(order, 1)))]
        return self.kept[0][1][: order + 1]

    def _evaluated(self, X: Array, order: int) -> list[Array]:
        text, count, n = self.function.serialize(), self.shares.shape[1], X.shape[1]
        rows = [count] * 3 if self.weights is None else [len(matrix) for matrix in self._matrices]
        results = [np.empty(((k + 1) * self.length, rows[k], n)) for k in range(order + 1)]
        size = min(max(CHUNK // count, 1), n)  # elements at a time, so that all stays in the cache
        columns = _columns(text, order, size * count)
        for first in range(0, n, size):
            part = slice(min(first, n - size), min(first + size, n))
            points = [(self.shares.T @ X[k::2, part]).reshape(1, -1) for k in range(2)]
            for matrix, values, result in zip(self._matrices, columns(points), results, strict=False):
                values = values.reshape(len(values), count, size)
                result[..., part] = values if self.weights is None else matrix @ values
        return [result.reshape(-1, n) for result in results]

    def chain(self, kind: Kind) -> Chain:
        """How the values change with X, from symbols for what :meth:`evaluated` returns for order 2."""
        rows = [self.shares.shape[1]] * 3 if self.weights is None else map(len, self._matrices)
        lengths = [(k + 1) * self.length for k in range(3)]
        symbols = [kind.sym(f"d{k}", n * size) for k, (n, size) in enumerate(zip(rows, lengths, strict=True))]
        parts = [ca.reshape(symbol, -1, size) for symbol, size in zip(symbols, lengths, strict=True)]
        if self.weights is None:
            parts = [ca.sparsify(ca.DM(m)) @ part for m, part in zip(self._matrices, parts, strict=True)]
        return Chain(symbols, parts, self.length, self.pairs)


class Chain:
    """Values at points, or sums of them, as expressions with derivatives by X.

    Parameters
    ----------
    symbols : list
        What ``parts`` are made of.
    parts : list
        ``sum W f``, ``sum W l_b f'`` and ``sum W l_b l_c f''``: a row for each sum and each b, or pair of b
        and c, which runs fastest, and a column for each component of each derivative.
    length : int
        Components of f.
    pairs : list of (int, int)
    """

    def __init__(
        self, symbols: list[Expression], parts: list[Expression], length: int, pairs: list[tuple[int, int]]
    ) -> None:
        values, first, self._second = parts
        self.symbols, self.values, self._length, self._pairs = symbols, ca.vec(values.T), length, pairs
        n, vertices = values.shape[0], 1 + pairs[-1][1]
        by_vertex = [ca.vertsplit(ca.reshape(part, vertices, n)) for part in ca.horzsplit(first)]
        columns = [
            ca.vec(ca.vertcat(*(by_vertex[k * length + i][b] for i in range(length))))
            for b in range(vertices)
            for k in range(2)
        ]
        self.slope = ca.horzcat(*columns)

    def curvature(self, weights: Expression) -> Expression:
        """Second derivative of ``weights . values``, the weights held."""
        weights, n = ca.reshape(weights, self._length, -1), 2 + 2 * self._pairs[-1][1]
        total, columns = type(weights)(n, n), ca.horzsplit(self._second)
        for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1))):
            of_pairs = sum(
                ca.reshape(columns[k * self._length + row], len(self._pairs), -1) @ weights[row, :].T
                for row in range(self._length)
            )
            for (b, c), value in zip(self._pairs, ca.vertsplit(of_pairs), strict=True):
                for first, second in ((2 * b + i, 2 * c + j), (2 * b + j, 2 * c + i)):
                    total[first, second] = total[second, first] = value
        return total


@lru_cache(maxsize=64)
def _columns(text: str, order: int, n: int) -> Columns:
    return columnwise(_derivatives(text, order), n)


@lru_cache(maxsize=64)
def _derivatives(text: str, order: int) -> ca.Function:
    """``(x, y) ->`` value, slopes by x and y, derivatives by xx, xy and yy, up to an order."""
    value = ca.Function.deserialize(text)
    kind = ca.SX if value.is_a("SXFunction") else ca.MX
    x, y = kind.sym("x"), kind.sym("y")
    f = value(x, y)
    by_x, by_y = ca.jacobian(f, x), ca.jacobian(f, y)
    parts = [[f], [by_x, by_y], [ca.jacobian(by_x, x), ca.jacobian(by_x, y), ca.jacobian(by_y, y)]]
    results = [ca.densify(ca.vertcat(*part)) for part in parts[: order + 1]]
    return ca.Function("derivatives", [x, y], ca.cse(results))
