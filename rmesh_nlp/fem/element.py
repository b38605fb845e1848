"""The function of one element, and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import casadi as ca

from rmesh_nlp.evaluation import Expression
from rmesh_nlp.fem.at_points import Chain, PointValues
from rmesh_nlp.problem.coefficients import OPEN, Coefficient, at

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


def vector(components: tuple[Coefficient, ...], x: Expression, y: Expression) -> Expression:
    """Values of coefficients at a point, one below the other."""
    return ca.vertcat(*[at(component, x, y) for component in components])


class Local(NamedTuple):
    """A derivative of an element function: nonzeros of its results, whose patterns these are.

    Its arguments are columns, then the derivatives of values at points up to an ``order``.
    """

    function: ca.Function
    patterns: tuple[ca.Sparsity, ...]
    order: int


class Differentiated:
    """An element function ``(*columns[, values at points]) -> (f, g)`` and its derivatives by some columns.

    Values at points and their derivatives are arguments. Where f is constantly zero it has no nonzero, and
    no derivative has one.
    """

    def __init__(self, function: ca.Function, at_points: PointValues | None, variable: list[int]) -> None:
        symbols = local_symbols(function)
        self._kind = type(symbols[0])
        self._x = ca.vertcat(self._kind(0, 1), *[symbols[i] for i in variable])
        self._f, self._g = function(*symbols)
        self._columns, self._values, self._chain = symbols, symbols[-1], None
        self._moving: tuple[Chain, slice, Expression] | None = None
        if at_points is None:
            return
        self._columns, self._chain = symbols[:-1], at_points.chain(self._kind)
        if 0 in variable:
            X = slice(0, symbols[0].shape[0])  # places of X in x
            slope = self._kind(self._values.shape[0], self._x.shape[0])
            slope[:, X] = self._chain.slope
            self._moving = self._chain, X, slope

    @cached_property
    def first(self) -> Local:
        """Value f, its gradient, rows g and their Jacobian."""
        f, g, x = self._f, self._g, self._x
        gradient, jacobian = ca.gradient(f, x), ca.jacobian(g, x)
        if self._moving is not None:
            _, _, slope = self._moving
            gradient += slope.T @ ca.gradient(f, self._values)
            jacobian += ca.jacobian(g, self._values) @ slope
        return self._made("first", [f, gradient, g, jacobian], 1)

    @cached_property
    def second(self) -> Local:
        """Upper triangle of the Hessian of ``lam_f f + lam_g . g``; takes lam_f and lam_g as well."""
        lam_f, lam_g = self._kind.sym("lam_f"), self._kind.sym("lam_g", self._g.shape[0])
        lagrangian = lam_f * self._f + ca.dot(lam_g, self._g)
        hessian = ca.hessian(lagrangian, self._x)[0]
        if self._moving is not None:
            chain, X, slope = self._moving
            by_value = ca.gradient(lagrangian, self._values)
            mixed = ca.jacobian(by_value, self._x).T @ slope
            hessian += mixed + mixed.T + slope.T @ ca.hessian(lagrangian, self._values)[0] @ slope
            hessian[X, X] += chain.curvature(by_value)
        return self._made("second", [ca.triu(hessian)], 2, lam_f, lam_g)

    def _made(self, name: str, results: list[Expression], order: int, *multipliers: Expression) -> Local:
        order, inputs = 0 if self._moving is None else order, list(self._columns)
        if self._chain is not None:
            results = ca.substitute(results, [self._values], [self._chain.values])
            inputs += self._chain.symbols[: order + 1]
        results = [self._kind(*r.shape) if r.is_zero() else r for r in results]
        function = ca.Function(name, [*inputs, *multipliers], ca.cse([r.nz[:] for r in results]))
        return Local(function, tuple(result.sparsity() for result in results), order)


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
