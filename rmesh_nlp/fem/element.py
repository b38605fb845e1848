"""The function of one element, and its derivatives.

A load or an exact solution enters through its values at a few points. Its derivatives by the coordinates of a
point are carried to the nodes by the chain rule: a third of the operations of going node by node.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import size
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at

FEW = 20
"""Elements of one kind, such as those with the same nodes on a curve, of which there are few."""

NO_ROWS = ca.SX(0, 1)
"""The constraints of an element that adds to the objective alone."""

KEPT = 256
"""Element functions whose derivatives are kept."""


class PointValues(NamedTuple):
    """Values of ``function``, ``(x, y) -> column``, at ``points``, ``(*columns) -> (2, points)``."""

    points: ca.Function
    function: ca.Function

    def of(self, columns: list[Any]) -> Any:
        """Values at all points of an element, one below the other."""
        points = ca.horzsplit(self.points(*columns))
        values = [self.function(*ca.vertsplit(point)) for point in points]
        return ca.vertcat(type(columns[0])(0, 1), *values)


def point_values(columns: list[Any], points: Any, value: Callable[[Any, Any], Any]) -> PointValues:
    """Values ``value(x, y)``, a scalar or a column, at ``points`` (2, points), expressions of the columns."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    values = ca.Function("value", [x, y], [ca.densify(ca.SX(value(x, y)))], OPEN)
    return PointValues(ca.Function("points", columns, [points]), values)


def with_design(function: ca.Function, at_points: PointValues | None) -> tuple[ca.Function, tuple[str, ...]]:
    """An element function whose first argument are the design variables that it depends on, and their names.

    Values at points are put in; without such variables it is returned as it is.
    """
    parts = (function,) if at_points is None else (function, at_points.function)
    free = {one.name(): one for part in parts if part.has_free() for one in part.free_sx()}
    if not free:
        return function, ()
    whole, names = plain(function, at_points), tuple(sorted(free))
    columns, symbols = local_symbols(whole), ca.vertcat(*(free[name] for name in names))
    return ca.Function(function.name(), [symbols, *columns], whole(*columns)), names


def local_symbols(function: ca.Function) -> list[Any]:
    """Symbols for the arguments of a local function, of the kind that it is made of."""
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]


def plain(function: ca.Function, at_points: PointValues | None) -> ca.Function:
    """An element function of its columns alone, the values at points put in."""
    if at_points is None:
        return function
    columns = local_symbols(function)[:-1]
    return ca.Function(function.name(), columns, ca.cse(function(*columns, at_points.of(columns))), OPEN)


def corners(n: int, components: int, kind: Any = ca.SX, order: int = 1) -> tuple[Any, Any]:
    """Symbols for the positions (2, n) of vertices and the displacements (components, nodes) of a cell."""
    X, u = kind.sym("X", 2 * n), kind.sym("u", components * size(order, n))
    return ca.reshape(X, 2, n), ca.reshape(u, components, size(order, n))


def affine(X: Any, u: Any) -> tuple[Any, Any]:
    """``(det, det * grad u)`` on the triangle X (2, 3): twice its area, and u (components, 3) linear there.

    At a point the gradient of a u of any order is that of the linear one ``u @ bernstein.slopes``. A
    quadratic density of the gradient is so divided by ``det`` once, at the end.
    """
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    return det, ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate


def vector(components: tuple[Coefficient, ...], point: Any) -> Any:
    """Values of coefficients at a point (2,), one below the other."""
    return ca.vertcat(*[at(component, *ca.vertsplit(point)) for component in components])


def line_rule(degree: int) -> tuple[Array, Array]:
    """Gauss rule on an edge: barycentric coordinates (2, points) and weights (points,), summing to 1."""
    points, weights = get_quadrature_line(degree)
    return np.vstack([1 - points.ravel(), points.ravel()]), weights


RESULTS = {
    "values": ("f", "g"),
    "gradient": ("f", "gradient"),
    "jacobian": ("g", "jacobian"),
    "hessian": ("hessian",),
}
"""Results of the Functions of :class:`Differentiated`."""


class Differentiated:
    """An element function ``(*columns[, values at points]) -> (f, g)`` and its derivatives by some columns.

    f and the gradient have no nonzero if f is constantly zero. The Hessian is the upper triangle of that of
    ``lam_f f + lam_g . g``.

    Attributes
    ----------
    patterns : dict of casadi.Sparsity
        Of each result.
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
            values = symbols[-1]
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
        if f.is_zero():
            f = kind(1, 1)  # without nonzeros: nothing to evaluate
        results = {"f": f, "g": g, "gradient": gradient, "jacobian": jacobian, "hessian": ca.triu(hessian)}
        self.patterns = {name: result.sparsity() for name, result in results.items()}
        self._nonzeros = {name: r if name == "f" else r.nz[:] for name, r in results.items()}
        self._functions: dict[tuple[str, bool], ca.Function] = {}

    def function(self, which: str, *, for_few: bool = False) -> ca.Function:
        """``(*columns) ->`` the nonzeros of ``RESULTS[which]``; a Hessian takes lam_f and lam_g as well.

        ``for_few`` elements common subexpressions are not looked for, which would take longer than they cost.
        """
        if (which, for_few) not in self._functions:
            columns = [*self._columns, *(self._multipliers if which == "hessian" else ())]
            results = [self._nonzeros[name] for name in RESULTS[which]]
            function = ca.Function(which, columns, results if for_few else ca.cse(results))
            self._functions[which, for_few] = function
        return self._functions[which, for_few]


def differentiated(
    function: ca.Function, at_points: PointValues | None, variable: list[int]
) -> Differentiated:
    """:class:`Differentiated`, kept: the meshes of one problem have the same element functions.

    Functions are told apart by what they compute, so that it does not matter who made them, and when.
    """
    parts = (function,) if at_points is None else (function, *at_points)
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
        self._position = position = kind.sym("x", 2)
        value = at_points.function(*ca.vertsplit(position))
        self._slope = ca.jacobian(value, position)
        self._weights, self._pull = kind.sym("weights", value.shape[0]), kind.sym("pull", 2)
        self._curvature = ca.hessian(ca.dot(self._weights, value), position)[0]
        self._points = ca.horzsplit(at_points.points(*columns))
        self._rates = [ca.jacobian(point, local) for point in self._points]
        self._bend = [ca.hessian(ca.dot(self._pull, point), local)[0] for point in self._points]
        self.values = ca.vertcat(*[self._at(value, point) for point in self._points])
        slopes = zip(self._points, self._rates, strict=True)
        self.slope = ca.vertcat(*[self._at(self._slope, point) @ rate for point, rate in slopes])

    def curvature(self, weights: Any) -> Any:
        """Second derivative of ``weights . values``, the weights held."""
        total, parts = 0, ca.vertsplit(weights, self._weights.shape[0])
        for point, rate, bend, weight in zip(self._points, self._rates, self._bend, parts, strict=True):
            here = self._at(ca.substitute(self._curvature, self._weights, weight), point)
            total = total + rate.T @ here @ rate
            if bend.nnz():  # a point that does not move affinely: a node of the element is on a curve
                slope = self._at(self._slope, point)
                total = total + ca.substitute(bend, self._pull, ca.densify(slope.T @ weight))
        return total

    def _at(self, expression: Any, point: Any) -> Any:
        return ca.substitute(expression, self._position, point)
