"""The function of one element, and its derivatives.

A load or an exact solution enters an element only through its values at a few points. Its
derivatives are taken with respect to the two coordinates of a point, once, and carried to the
nodes by the chain rule: a third of the operations of differentiating it node by node.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.evaluation import Array

NO_ROWS = ca.SX(0, 1)
"""The constraints of an element that adds to the objective alone."""

KEPT = 256
"""Element functions whose derivatives are kept."""


@dataclass(frozen=True)
class PointValues:
    """Values of a function of position at points that move with the element.

    Attributes
    ----------
    points : casadi.Function
        ``(*columns) -> (2, points)``.
    function : casadi.Function
        ``(x, y) -> column`` of values at one point.
    """

    points: ca.Function
    function: ca.Function

    def of(self, columns: list[Any]) -> Any:
        """Values at all points of an element, one below the other."""
        points = ca.horzsplit(self.points(*columns))
        values = [self.function(*ca.vertsplit(point)) for point in points]
        return ca.vertcat(type(columns[0])(0, 1), *values)


def local_symbols(function: ca.Function) -> list[Any]:
    """Symbols for the arguments of a local function, of the kind that it is made of."""
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]


def plain(function: ca.Function, at_points: PointValues | None) -> ca.Function:
    """An element function of its columns alone, the values at points put in."""
    if at_points is None:
        return function
    columns = local_symbols(function)[:-1]
    return ca.Function(function.name(), columns, ca.cse(function(*columns, at_points.of(columns))))


def corners(n: int, components: int, kind: Any = ca.SX) -> tuple[Any, Any]:
    """Symbols for the positions (2, n) and the displacements (components, n) of n nodes."""
    X, u = kind.sym("X", 2 * n), kind.sym("u", components * n)
    return ca.reshape(X, 2, n), ca.reshape(u, components, n)


def affine(X: Any, u: Any) -> tuple[Any, Any]:
    """``(det, det * grad u)`` on the triangle X (2, 3): twice its area, and u (components, 3) linear there.

    A quadratic density of the gradient is so divided by ``det`` once, at the end.
    """
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    return det, ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate


def line_rule(degree: int) -> tuple[Array, Array]:
    """Gauss rule on an edge: barycentric coordinates (2, points) and weights (points,), summing to 1."""
    points, weights = get_quadrature_line(degree)
    return np.vstack([1 - points.ravel(), points.ravel()]), weights


class Differentiated:
    """Functions of an element function ``(*columns[, values at points]) -> (f, g)``, by its derivatives.

    Parameters
    ----------
    function : casadi.Function
    at_points : PointValues, optional
        What the last argument of ``function`` is.
    variable : list of int
        The columns to differentiate by.

    Attributes
    ----------
    values, gradient, jacobian : casadi.Function
        ``(*columns) -> (f, g)``, f and the nonzeros of its gradient, g and those of its Jacobian. f has no
        nonzero if it is constantly zero.
    hessian : casadi.Function
        ``(*columns, lam_f, lam_g) ->`` nonzeros of the upper triangle of the Hessian of
        ``lam_f f + lam_g . g``.
    gradient_pattern, jacobian_pattern, hessian_pattern : casadi.Sparsity
    n_f : int
        Nonzeros of f: 0 or 1.
    """

    def __init__(self, function: ca.Function, at_points: PointValues | None, variable: list[int]) -> None:
        symbols = local_symbols(function)
        kind = type(symbols[0])
        self._columns = symbols if at_points is None else symbols[:-1]
        local = ca.vertcat(kind(0, 1), *[symbols[i] for i in variable])
        f, g = function(*symbols)
        self._multipliers = kind.sym("lam_f"), kind.sym("lam_g", g.shape[0])
        lagrangian = self._multipliers[0] * f + ca.dot(self._multipliers[1], g)
        gradient, jacobian = ca.gradient(f, local), ca.jacobian(g, local)
        hessian = ca.hessian(lagrangian, local)[0]
        if at_points is not None:
            values, there = symbols[-1], None
            if not ca.jacobian(at_points.points(*self._columns), local).nnz():
                there = at_points.of(self._columns)  # the points stay where they are
            else:
                chain = _Chain(at_points, self._columns, local)
                there = chain.values
                gradient += chain.slope.T @ ca.gradient(f, values)
                jacobian += ca.jacobian(g, values) @ chain.slope
                by_value = ca.gradient(lagrangian, values)
                mixed = ca.jacobian(by_value, local).T @ chain.slope
                hessian += mixed + mixed.T + chain.slope.T @ ca.hessian(lagrangian, values)[0] @ chain.slope
                hessian += chain.curvature(by_value)
            f, g, gradient, jacobian, hessian = ca.substitute(
                [f, g, gradient, jacobian, hessian], [values], [there]
            )
        hessian = ca.triu(hessian)
        if f.is_zero():
            f = kind(1, 1)  # without nonzeros: nothing to evaluate
        self.n_f = f.nnz()
        self.gradient_pattern, self.jacobian_pattern = gradient.sparsity(), jacobian.sparsity()
        self.hessian_pattern = hessian.sparsity()
        self._expressions = [f, g], [f, gradient.nz[:]], [g, jacobian.nz[:]], [hessian.nz[:]]

    @cached_property
    def values(self) -> ca.Function:
        """``(*columns) -> (f, g)``."""
        return self._function("values", 0)

    @cached_property
    def gradient(self) -> ca.Function:
        """``(*columns) -> (f, gradient)``."""
        return self._function("gradient", 1)

    @cached_property
    def jacobian(self) -> ca.Function:
        """``(*columns) -> (g, jacobian)``."""
        return self._function("jacobian", 2)

    @cached_property
    def hessian(self) -> ca.Function:
        """``(*columns, lam_f, lam_g) -> hessian``."""
        return self._function("hessian", 3, *self._multipliers)

    def _function(self, name: str, which: int, *more: Any) -> ca.Function:
        return ca.Function(name, [*self._columns, *more], ca.cse(self._expressions[which]))


def differentiated(
    function: ca.Function, at_points: PointValues | None, variable: list[int]
) -> Differentiated:
    """:class:`Differentiated`, kept: the meshes of one problem have the same element functions.

    Functions are told apart by what they compute, so that it does not matter who made them, and when.
    """
    parts = (function,) if at_points is None else (function, at_points.points, at_points.function)
    try:
        texts = tuple(part.serialize() for part in parts)
    except RuntimeError:  # a Function of someone's own that cannot be written as text
        return Differentiated(function, at_points, variable)
    return _differentiated(texts, tuple(variable))


@lru_cache(maxsize=KEPT)
def _differentiated(texts: tuple[str, ...], variable: tuple[int, ...]) -> Differentiated:
    function, *points = (ca.Function.deserialize(text) for text in texts)
    return Differentiated(function, PointValues(*points) if points else None, list(variable))


class _Chain:
    """Values at all points of an element, and how they change with its local unknowns."""

    def __init__(self, at_points: PointValues, columns: list[Any], local: Any) -> None:
        kind = type(local)
        x, y = kind.sym("x"), kind.sym("y")
        self._position = ca.vertcat(x, y)
        value = at_points.function(x, y)
        self._slope = ca.jacobian(value, self._position)
        self._weights, self._pull = kind.sym("weights", value.shape[0]), kind.sym("pull", 2)
        self._curvature = ca.hessian(ca.dot(self._weights, value), self._position)[0]
        self._points = ca.horzsplit(at_points.points(*columns))
        self._moves = [ca.jacobian(point, local) for point in self._points]
        self._bend = [ca.hessian(ca.dot(self._pull, point), local)[0] for point in self._points]
        self.values = ca.vertcat(*[self._at(value, point) for point in self._points])
        self.slope = ca.vertcat(
            *[self._at(self._slope, p) @ m for p, m in zip(self._points, self._moves, strict=True)]
        )

    def curvature(self, weights: Any) -> Any:
        """Second derivative of ``weights . values``, the weights held."""
        total = 0
        for point, move, bend, weight in zip(
            self._points, self._moves, self._bend, ca.vertsplit(weights, self._weights.shape[0]), strict=True
        ):
            here = ca.substitute(
                self._curvature, ca.vertcat(self._position, self._weights), ca.vertcat(point, weight)
            )
            total = total + move.T @ here @ move
            if bend.nnz():  # a point that does not move affinely: a node of the element is on a curve
                slope = self._at(self._slope, point)
                total = total + ca.substitute(bend, self._pull, ca.densify(slope.T @ weight))
        return total

    def _at(self, expression: Any, point: Any) -> Any:
        return ca.substitute(expression, self._position, point)
