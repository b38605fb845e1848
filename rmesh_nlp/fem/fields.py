"""Nodal fields as functions of the unknowns, and groups of elements that share a local function."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import PointValues
from rmesh_nlp.meshes.curves import on_values

Index = NDArray[np.int64]
CONSTANT = -1
"""Index of a local value that does not depend on any unknown or parameter."""


@dataclass(frozen=True)
class Bends:
    """Values of a field that are functions of an affine one, as coordinates of a curve are of its parameter.

    Attributes
    ----------
    which : int array of the field's shape
        Number of the function; ``STRAIGHT`` for the affine value itself.
    functions : tuple of casadi.Function
        ``t -> value``, scalar and twice differentiable.
    """

    which: Index
    functions: tuple[ca.Function, ...]

    @cached_property
    def _slopes(self) -> tuple[ca.Function, ...]:
        return tuple(_slope(function) for function in self.functions)

    def applied(self, t: Array) -> Array:
        """Values of the field where its affine part has the values ``t``."""
        return self._put(self.functions, t, t)

    def slopes(self, t: Array) -> Array:
        """Derivatives of the values by the affine part, 1 where the field is affine."""
        return self._put(self._slopes, t, np.ones(t.shape))

    def _put(self, functions: tuple[ca.Function, ...], t: Array, straight: Array) -> Array:
        result = np.array(straight)
        for number, function in enumerate(functions):
            here = self.which == number
            result[here] = on_values(function, t[here])
        return result


def _slope(function: ca.Function) -> ca.Function:
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    t = kind.sym("t")
    return ca.Function("slope", [t], [ca.jacobian(function(t), t)])


STRAIGHT = -1
"""Number of no function in :class:`Bends`."""


@dataclass(frozen=True)
class Field:
    """A nodal field as an affine function of one vector, ``scale * w[index] + offset``.

    The vector ``w`` is the unknowns ``x`` of a program or, if ``parameter``, its ``p``.

    Attributes
    ----------
    index : (components, nodes) int array
        ``CONSTANT`` where the field is fixed at ``offset``.
    scale, offset : (components, nodes) arrays
    parameter : bool
    bends : Bends, optional
        Where the value is not this affine function but a function of it.
    along : Field, optional
        Of positions: (curves, nodes), the parameters of the nodes that are on a curve of the motion.
    """

    index: Index
    scale: Array
    offset: Array
    parameter: bool = False
    bends: Bends | None = None
    along: Field | None = None

    def at(self, nodes: Index) -> Field:
        """Local values on elements.

        ``nodes`` is (nodes per element, elements); the result has one column per element and
        runs through the components of the first node, then of the second, ...
        """
        shape = (self.index.shape[0] * nodes.shape[0], nodes.shape[1])

        def pick(a: NDArray) -> NDArray:
            return np.moveaxis(a[:, nodes], 0, 1).reshape(shape)

        bends = self.bends and Bends(pick(self.bends.which), self.bends.functions)
        return Field(pick(self.index), pick(self.scale), pick(self.offset), self.parameter, bends)

    def component(self, number: int) -> Field:
        """One component as a field of its own."""
        part = slice(number, number + 1)
        bends = self.bends and Bends(self.bends.which[part], self.bends.functions)
        return Field(self.index[part], self.scale[part], self.offset[part], self.parameter, bends)

    def elements(self, chosen: Index) -> Field:
        """Some columns of a field of local values."""
        bends = self.bends and Bends(self.bends.which[:, chosen], self.bends.functions)
        part = (self.index[:, chosen], self.scale[:, chosen], self.offset[:, chosen])
        return Field(*part, self.parameter, bends)

    def numbered_from(self, first: int) -> Field:
        """The same field, its unknowns numbered from ``first`` instead of from zero."""
        index = np.where(self.index == CONSTANT, CONSTANT, self.index + first)
        return replace(self, index=index)

    def in_units(self, unit: float) -> Field:
        """The same field of unknowns that are measured in ``unit``."""
        return replace(self, scale=self.scale * unit)

    def values(self, w: Array) -> Array:
        """The field itself, (components, nodes), for a numeric vector ``w``."""
        result = self._affine(w)
        return result if self.bends is None else self.bends.applied(result)

    def slopes(self, w: Array) -> Array:
        """Derivative (components, nodes) of each value by its own unknown, zero where it has none."""
        slope = np.where(self.index != CONSTANT, self.scale, 0.0)
        return slope if self.bends is None else slope * self.bends.slopes(self._affine(w))

    def _affine(self, w: Array) -> Array:
        moving = self.index != CONSTANT
        result = self.offset.copy()
        result[moving] += self.scale[moving] * np.asarray(w)[self.index[moving]]
        return result


def unknown_field(shape: tuple[int, int], first: int = 0, *, parameter: bool = False) -> Field:
    """A field all of whose values are unknowns, numbered node by node from ``first``."""
    components, nodes = shape
    index = first + np.arange(components * nodes).reshape(nodes, components).T
    return Field(index, np.ones(shape), np.zeros(shape), parameter)


def constant_field(values: Array) -> Field:
    """A field that is fixed at ``values`` of shape (components, nodes or elements)."""
    offset = np.atleast_2d(np.asarray(values, dtype=float))
    return Field(np.full(offset.shape, CONSTANT), np.ones(offset.shape), offset)


@dataclass(frozen=True)
class ElementGroup:
    """Elements that share one local function.

    Attributes
    ----------
    function : casadi.Function
        ``(*local columns) -> (f, g)``; f a scalar, g a column (possibly empty). An SX Function,
        or an MX one where SX has no expression (splines). With ``at_points`` it has one more
        argument, the column of values at all points.
    arguments : tuple of Field
        For each argument its local values, (length, elements).
    rows : (len(g), elements) int array
        Constraint row that each local ``g`` is added to; ``CONSTANT`` drops it.
    at_points : PointValues, optional
    """

    function: ca.Function
    arguments: tuple[Field, ...]
    rows: Index
    at_points: PointValues | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(self.arguments[0].index.shape[1])


def without_elements(group: ElementGroup) -> ElementGroup:
    """The same group of no elements at all."""
    return some_elements(group, np.zeros(0, np.int64))


def some_elements(group: ElementGroup, chosen: Index) -> ElementGroup:
    """The same group of some of its elements."""
    arguments = tuple(field.elements(chosen) for field in group.arguments)
    return ElementGroup(group.function, arguments, group.rows[:, chosen], group.at_points)


@dataclass(frozen=True)
class ElementTerm:
    """A local function and the nodes that it takes values at: an element group of fields to be named.

    Attributes
    ----------
    function : casadi.Function
        See :class:`ElementGroup`.
    nodes : tuple of (nodes per element, elements) int arrays or None
        For each field of :meth:`on` the nodes at which the function takes it; None if it does not.
    rows : (len(g), elements) int array, optional
        Constraint rows, numbered from zero; none by default.
    component : int, optional
        The last field has one component per obstacle: take this one.
    at_points : PointValues, optional
    arc : (int, (nodes per element, elements) int array), optional
        The first argument of the function is the parameters of these nodes on this curve of the motion.
    constants : (length, elements) array, optional
        The last argument.
    """

    function: ca.Function
    nodes: tuple[Index | None, ...]
    rows: Index | None = None
    component: int | None = None
    at_points: PointValues | None = None
    arc: tuple[int, Index] | None = None
    constants: Array | None = None

    def on(self, *fields: Field, first_row: int = 0) -> ElementGroup:
        """The element group on these fields, its rows numbered from ``first_row``."""
        if self.component is not None:
            fields = (*fields[:-1], fields[-1].component(self.component))
        chosen = zip(fields, self.nodes, strict=True)
        local = tuple(field.at(nodes) for field, nodes in chosen if nodes is not None)
        if self.arc is not None and fields[0].along is not None:
            curve, nodes = self.arc
            local = (fields[0].along.component(curve).at(nodes), *local)
        if self.constants is not None:
            local = (*local, constant_field(self.constants))
        none = np.zeros((0, local[0].index.shape[1]), dtype=np.int64)
        rows = none if self.rows is None else first_row + self.rows
        return ElementGroup(self.function, local, rows, self.at_points)
