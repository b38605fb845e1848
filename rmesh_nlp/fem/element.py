"""The function of one element, and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.evaluation import Array, Expression, Kind
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.bernstein import size
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at

FEW = 20
"""Elements of one kind, such as those with the same nodes on a curve, of which there are few."""

NO_ROWS = ca.SX(0, 1)
"""The constraints of an element that adds to the objective alone."""

KEPT = 256
"""Element functions whose derivatives are kept."""


def with_design(function: ca.Function, at_points: PointValues | None) -> tuple[ca.Function, tuple[str, ...]]:
    """An element function whose first argument are the design variables that it depends on, and their names.

    Values at points are put in; without such variables it is returned as it is.
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
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]


def plain(function: ca.Function, at_points: PointValues | None) -> ca.Function:
    """An element function of its columns alone, the values at points put in."""
    if at_points is None:
        return function
    columns = local_symbols(function)[:-1]
    return ca.Function(function.name(), columns, ca.cse(function(*columns, at_points.values(columns))), OPEN)


def corners(n: int, components: int, kind: Kind = ca.SX, order: int = 1) -> tuple[Expression, Expression]:
    """Symbols for the positions (2, n) of vertices and the displacements (components, nodes) of a cell."""
    X, u = kind.sym("X", 2 * n), kind.sym("u", components * size(order, n))
    return ca.reshape(X, 2, n), ca.reshape(u, components, size(order, n))


def affine(X: Expression, u: Expression) -> tuple[Expression, Expression]:
    """``(det, det * grad u)`` on the triangle X (2, 3): twice its area, and u (components, 3) linear there.

    At a point the gradient of a u of any order is that of the linear one ``u @ bernstein.slopes``. A
    quadratic density of the gradient is so divided by ``det`` once, at the end.
    """
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    return det, ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate


def vector(components: tuple[Coefficient, ...], point: Expression) -> Expression:
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

ORDERS = {"values": 0, "gradient": 1, "jacobian": 1, "hessian": 2}
"""Order of the derivatives that they take of values at points."""


class Differentiated:
    """An element function ``(*columns[, values at points]) -> (f, g)`` and its derivatives by some columns.

    f and the gradient have no nonzero if f is constantly zero. The Hessian is the upper triangle of that of
    ``lam_f f + lam_g . g``. Values at points and their derivatives are arguments.

    Attributes
    ----------
    patterns : dict of casadi.Sparsity
        Of each result.
    at_points : PointValues or None
    """

    def __init__(self, function: ca.Function, at_points: PointValues | None, variable: list[int]) -> None:
        symbols = local_symbols(function)
        kind = type(symbols[0])
        self.at_points, self._columns, self._at_points = at_points, symbols, []
        local = ca.vertcat(kind(0, 1), *[symbols[i] for i in variable])
        f, g = function(*symbols)
        self._multipliers = kind.sym("lam_f"), kind.sym("lam_g", g.shape[0])
        lagrangian = self._multipliers[0] * f + ca.dot(self._multipliers[1], g)
        gradient, jacobian = ca.gradient(f, local), ca.jacobian(g, local)
        hessian = ca.hessian(lagrangian, local)[0]
        self._moves = at_points is not None and at_points.place in variable
        if at_points is not None:
            self._columns, values = symbols[:-1], symbols[-1]
            self._at_points = at_points.symbols(kind)
            chain = at_points.chain(self._at_points)
            if self._moves:
                # places of X among the local unknowns
                first = sum(symbols[i].shape[0] for i in variable[: variable.index(at_points.place)])
                X = slice(first, first + symbols[at_points.place].shape[0])
                slope = kind(values.shape[0], local.shape[0])
                slope[:, X] = chain.slope
                by_value = ca.gradient(lagrangian, values)
                mixed = ca.jacobian(by_value, local).T @ slope
                gradient += slope.T @ ca.gradient(f, values)
                jacobian += ca.jacobian(g, values) @ slope
                hessian += mixed + mixed.T + slope.T @ ca.hessian(lagrangian, values)[0] @ slope
                hessian[X, X] += chain.curvature(by_value)
            expressions = ca.substitute([f, g, gradient, jacobian, hessian], [values], [chain.values])
            f, g, gradient, jacobian, hessian = expressions
        if f.is_zero():
            f = kind(1, 1)  # without nonzeros: nothing to evaluate
        results = {"f": f, "g": g, "gradient": gradient, "jacobian": jacobian, "hessian": ca.triu(hessian)}
        self.patterns = {name: result.sparsity() for name, result in results.items()}
        self._nonzeros = {name: r if name == "f" else r.nz[:] for name, r in results.items()}
        self._functions: dict[tuple[object, ...], ca.Function] = {}

    def order(self, which: str) -> int:
        """The order of the derivatives of values at points that ``which`` takes."""
        return ORDERS[which] if self._moves else 0

    def function(
        self,
        which: str,
        kept: tuple[tuple[int, ...], ...] | None = None,
        *,
        whole: bool = True,
        for_few: bool = False,
    ) -> ca.Function:
        """``(*columns[, *derivatives at points]) ->`` nonzeros of ``RESULTS[which]``, all or those ``kept``.

        A ``whole`` one puts in the derivatives at points. A Hessian takes lam_f and lam_g as well. Common
        subexpressions are not looked for if it is ``for_few`` elements: that would take longer than it saves.
        """
        key = which, kept, whole, for_few
        if key not in self._functions:
            results = [self._nonzeros[name] for name in RESULTS[which]]
            if kept is not None:
                results = [result[list(rows)] for result, rows in zip(results, kept, strict=True)]
            given = self._at_points[: self.order(which) + 1]
            if whole and self.at_points is not None:
                at = self.at_points.expressions(self._columns, self.order(which))
                results, given = ca.substitute(results, given, at), []
            columns = [*self._columns, *given, *(self._multipliers if which == "hessian" else ())]
            self._functions[key] = ca.Function(which, columns, results if for_few else ca.cse(results))
        return self._functions[key]


def differentiated(
    function: ca.Function, at_points: PointValues | None, variable: list[int]
) -> Differentiated:
    """:class:`Differentiated`, kept: the meshes of one problem have the same element functions.

    Functions are told apart by what they compute, so that it does not matter who made them, and when.
    """
    at = None if at_points is None else replace(at_points, kept=[])  # without what it has evaluated
    try:
        return _differentiated(function.serialize(), at, tuple(variable))
    except RuntimeError:  # a Function of someone's own that cannot be written as text
        return Differentiated(function, at, variable)


@lru_cache(maxsize=KEPT)
def _differentiated(text: str, at_points: PointValues | None, variable: tuple[int, ...]) -> Differentiated:
    return Differentiated(ca.Function.deserialize(text), at_points, list(variable))
