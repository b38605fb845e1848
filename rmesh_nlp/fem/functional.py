"""Values that are sums over elements, or smooth functions of several such sums."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Expression
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.element import NO_ROWS, local_symbols
from rmesh_nlp.fem.fields import ElementGroup, Field, constant_field

Groups = list[ElementGroup]


@dataclass(frozen=True)
class Functional:
    """``f + combine(S_1, ..., S_m)``, where f and each S_k is a sum over element groups.

    A sum is a number on its own, so that second derivatives stay sparse: in the KKT model each is one more
    unknown with an equation of its own.

    Attributes
    ----------
    groups : list of ElementGroup
        Those of f.
    sums : tuple of lists of ElementGroup
        Those of each S_k, which stand in the objective of their functions.
    combine : function
        Of a column (m, 1) of CasADi symbols; not used without sums.
    """

    groups: Groups
    sums: tuple[Groups, ...] = ()
    combine: Callable[[Expression], Expression] = lambda _: 0.0

    def scaled(self, weight: float) -> Functional:
        """``weight`` times it."""
        groups = [scaled_group(group, weight) for group in self.groups]
        return Functional(groups, self.sums, lambda s: weight * self.combine(s))

    def __add__(self, other: Functional) -> Functional:
        n = len(self.sums)
        return Functional(
            [*self.groups, *other.groups],
            (*self.sums, *other.sums),
            lambda s: self.combine(s[:n]) + other.combine(s[n:]),
        )

    def then(self, function: Callable[[Expression], Expression]) -> Functional:
        """A smooth function of its value."""
        return Functional([], (self.groups, *self.sums), lambda s: function(s[0] + self.combine(s[1:])))

    def combined(self, sums: Field) -> ElementGroup:
        """``combine`` of sums that are unknowns, a field (m, 1)."""
        s = ca.SX.sym("S", len(self.sums))
        function = ca.Function("combine", [s], [self.combine(s), NO_ROWS])
        return ElementGroup(function, (sums,), np.zeros((0, 1), dtype=np.int64))

    def evaluate(self) -> Callable[[Array], float]:
        """A function of the unknowns ``x``: the value."""
        first, sums = _total(self.groups), self.sum_values
        return lambda x: first(x) + (float(self.combine(ca.DM(sums(x)))) if self.sums else 0.0)

    @cached_property
    def sum_values(self) -> Callable[[Array], Array]:
        """A function of the unknowns ``x``: the sums (m,)."""
        totals = [_total(groups) for groups in self.sums]
        return lambda x: np.array([total(x) for total in totals])

    def sizes(self, x: Array) -> Array:
        """(m,) sums of the absolute values of elements: units in which the sums are of order one."""
        values = (element_values(groups)(x) for groups in self.sums)
        return np.array([sum(float(np.abs(part).sum()) for part in parts) or 1.0 for parts in values])


def _total(groups: Sequence[ElementGroup]) -> Callable[[Array], float]:
    values = element_values(groups)
    return lambda x: float(sum(map(np.sum, values(x))))


def as_row(group: ElementGroup, row: int) -> ElementGroup:
    """The group's objective as a constraint row."""
    as_rows = group.through(lambda f, _: [0, ca.densify(f)])
    return replace(as_rows, rows=np.full((1, group.size), row))


def scaled_group(group: ElementGroup, weight: float) -> ElementGroup:
    """The group with its objective multiplied by ``weight``."""
    if weight == 1.0:
        return group
    symbols = local_symbols(group.function)
    columns, values = symbols[: len(group.arguments)], symbols[len(group.arguments) :]
    f, g = group.function(*symbols)
    # the weight is data of the elements: derivatives of the function serve every weight
    factor = type(symbols[0]).sym("weight")
    function = ca.Function(group.function.name(), [*columns, factor, *values], [factor * f, g])
    arguments = (*group.arguments, constant_field(np.full((1, group.size), weight)))
    return replace(group, function=function, arguments=arguments)
