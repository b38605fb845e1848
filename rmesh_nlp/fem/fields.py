"""Nodal fields as functions of the unknowns, and groups of elements that share a local function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array, Expression
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.element import local_symbols, with_design
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.space import Index as Index
from rmesh_nlp.meshes.curves import on_values

CONSTANT = -1
"""Index of a local value that does not depend on any unknown or parameter."""

STRAIGHT = -1
"""Number of no function in :class:`Bends`."""


@dataclass(frozen=True)
class Bends:
    """Values of a field that are functions of an affine one, as coordinates of a curve are of its parameter.

    ``which`` has the field's shape: the number of the function, ``t -> value`` and twice differentiable, or
    ``STRAIGHT`` for the affine value itself.
    """

    which: Index
    functions: tuple[ca.Function, ...]

    @cached_property
    def _slopes(self) -> tuple[ca.Function, ...]:
        symbols = [local_symbols(function)[0] for function in self.functions]
        pairs = zip(self.functions, symbols, strict=True)
        return tuple(ca.Function("slope", [t], [ca.jacobian(function(t), t)]) for function, t in pairs)

    def applied(self, t: Array, *, slopes: bool = False) -> Array:
        """Values of the field where its affine part has the values ``t``, or their derivatives by that."""
        result = np.ones(t.shape) if slopes else np.array(t)
        for number, function in enumerate(self._slopes if slopes else self.functions):
            mask = self.which == number
            result[mask] = on_values(function, t[mask])
        return result


@dataclass(frozen=True)
class Design:
    """Design variables (1, n) as a field, by their names."""

    names: tuple[str, ...]
    values: Field

    def of(self, names: tuple[str, ...], size: int) -> Field:
        """Those with these names on so many elements, the same on all."""
        return self.values.at(np.tile(np.array([[self.names.index(name)] for name in names]), size))


@dataclass(frozen=True)
class Modes:
    """Motions (modes, components, nodes) that are added to a field, each times an amplitude (1, modes)."""

    amplitudes: Field
    motions: Array

    def values(self, w: Array) -> Array:
        """What is added."""
        return np.tensordot(self.amplitudes.values(w)[0], self.motions, 1)

    def picked(self, pick: Callable[[NDArray], NDArray]) -> Modes:
        """Those of some values of the field."""
        return Modes(self.amplitudes, np.stack([pick(motion) for motion in self.motions]))


@dataclass(frozen=True)
class Field:
    """A nodal field (components, nodes) as an affine function of one vector, ``scale * w[index] + offset``.

    The vector ``w`` is the unknowns ``x`` of a model or, if ``parameter``, its ``p``. The field is fixed at
    ``offset`` where the index is ``CONSTANT``.

    Attributes
    ----------
    bends : Bends, optional
        Where the value is not this affine function but a function of it.
    modes : Modes, optional
        Of positions: motions of shapes, which are added.
    along : Field, optional
        Of positions: (curves, nodes), the parameters of the nodes that are on a curve of the motion.
    design : Design, optional
        Of positions: the design variables beside them.
    space : DisplacementSpace, optional
        Of displacements: the space whose nodes these are; by default the nodes are the vertices.
    """

    index: Index
    scale: Array
    offset: Array
    parameter: bool = False
    bends: Bends | None = None
    modes: Modes | None = None
    along: Field | None = None
    design: Design | None = None
    space: DisplacementSpace | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Components and nodes, or length and elements of local values."""
        return self.index.shape[0], self.index.shape[1]

    def at(self, nodes: Index) -> Field:
        """Local values on elements with ``nodes`` (nodes per element, elements), a column for each.

        A column has the components of the first node, then of the second, ...
        """
        shape = self.shape[0] * len(nodes), nodes.shape[1]
        return self._picked(lambda a: a[:, nodes].swapaxes(0, 1).reshape(shape))

    def component(self, number: int) -> Field:
        """One component as a field of its own."""
        return self._picked(lambda a: a[number : number + 1])

    def elements(self, chosen: Index) -> Field:
        """Some columns of a field of local values."""
        return self._picked(lambda a: a[:, chosen])

    def _picked(self, pick: Callable[[NDArray], NDArray]) -> Field:
        bends = self.bends and Bends(pick(self.bends.which), self.bends.functions)
        modes = self.modes and self.modes.picked(pick)
        return Field(pick(self.index), pick(self.scale), pick(self.offset), self.parameter, bends, modes)

    def straight(self) -> Field:
        """The affine field behind it."""
        return replace(self, bends=None, modes=None)

    def numbered_from(self, first: int) -> Field:
        """The same field, its unknowns numbered from ``first`` instead of from zero."""
        return replace(self, index=np.where(self.index == CONSTANT, CONSTANT, self.index + first))

    def in_units(self, unit: float) -> Field:
        """The same field of unknowns that are measured in ``unit``."""
        return replace(self, scale=self.scale * unit)

    def values(self, w: Array) -> Array:
        """The field itself, (components, nodes), for a numeric vector ``w``."""
        result = self._affine(w)
        if self.bends is not None:
            result = self.bends.applied(result)
        return result if self.modes is None else result + self.modes.values(w)

    def at_rest(self, w: Array) -> Field:
        """The same field fixed at its values for ``w``; a design beside it goes on to vary."""
        along = self.along and constant_field(self.along.values(w))
        return replace(constant_field(self.values(w)), along=along, design=self.design, space=self.space)

    def slopes(self, w: Array) -> Array:
        """Derivative (components, nodes) of each value by its own unknown, zero where it has none."""
        slope = np.where(self.index != CONSTANT, self.scale, 0.0)
        return slope if self.bends is None else slope * self.bends.applied(self._affine(w), slopes=True)

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
    return Field(np.broadcast_to(CONSTANT, offset.shape), np.broadcast_to(1.0, offset.shape), offset)


@dataclass(frozen=True)
class ElementGroup:
    """Elements that share one local function ``(*local columns[, values at points]) -> (f, g)``.

    f is a scalar, g a column (possibly empty). The function is an SX Function, or an MX one where SX has no
    expression (splines). Its last argument is there with ``at_points``: the values at all points.

    Attributes
    ----------
    arguments : tuple of Field
        For each other argument its local values, (length, elements).
    rows : (len(g), elements) int array
        Constraint row that each local ``g`` is added to; ``CONSTANT`` drops it.
    """

    function: ca.Function
    arguments: tuple[Field, ...]
    rows: Index
    at_points: PointValues | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return self.arguments[0].shape[1]

    def shifted(self, first_row: int) -> ElementGroup:
        """The same group, its rows numbered from ``first_row`` instead of from zero."""
        return replace(self, rows=np.where(self.rows == CONSTANT, CONSTANT, self.rows + first_row))

    def through(self, change: Callable[[Expression, Expression], list[Expression]]) -> ElementGroup:
        """The same elements with the results ``change(f, g)``."""
        symbols = local_symbols(self.function)
        results = change(*self.function(*symbols))
        return replace(self, function=ca.Function(self.function.name(), symbols, results))

    def in_units(self, unit: float) -> ElementGroup:
        """The same group, its rows divided by ``unit``."""
        return self.through(lambda f, g: [f, g / unit])

    def some(self, chosen: Index) -> ElementGroup:
        """The same group of some of its elements."""
        arguments = tuple(field.elements(chosen) for field in self.arguments)
        return replace(self, arguments=arguments, rows=self.rows[:, chosen])


def element_group(
    function: ca.Function,
    positions: Field,
    local: tuple[Field, ...],
    rows: Index | None = None,
    at_points: PointValues | None = None,
) -> ElementGroup:
    """Elements of local values; without ``rows`` they add to the objective alone.

    A function that depends on design variables gets those of ``positions`` as its first argument.
    """
    size = local[0].shape[1]
    rows = np.zeros((0, size), dtype=np.int64) if rows is None else rows
    whole, names = with_design(function, at_points)
    if not names:
        return ElementGroup(function, local, rows, at_points)
    if positions.design is None:
        raise ValueError(f"{function.name()} depends on the design variables {', '.join(names)}")
    return ElementGroup(whole, (positions.design.of(names, size), *local), rows)


@dataclass(frozen=True)
class ElementTerm:
    """A local function and the nodes that it takes values at: an element group of fields to be named.

    The arguments of the function are parameters of a curve, the fields of :meth:`on`, constants; each only
    where the term has it.

    Attributes
    ----------
    nodes : tuple of (nodes per element, elements) int arrays or None
        For each field of :meth:`on` the nodes at which the function takes it; None if it does not.
    rows : (len(g), elements) int array, optional
        Constraint rows, numbered from zero; none by default.
    component : int, optional
        The last field has one component per obstacle: take this one.
    arc : (int, (nodes per element, elements) int array), optional
        The function takes the parameters of these vertices on this curve of the motion.
    constants : (length, elements) array, optional
    """

    function: ca.Function
    nodes: tuple[Index | None, ...]
    rows: Index | None = None
    component: int | None = None
    at_points: PointValues | None = None
    arc: tuple[int, Index] | None = None
    constants: Array | None = None

    def on(self, *fields: Field, first_row: int = 0) -> ElementGroup:
        """The element group on these fields, positions first, its rows numbered from ``first_row``."""
        positions = fields[0]
        if self.component is not None:
            fields = (*fields[:-1], fields[-1].component(self.component))
        chosen = zip(fields, self.nodes, strict=True)
        local: tuple[Field, ...] = tuple(field.at(nodes) for field, nodes in chosen if nodes is not None)
        if self.arc is not None and fields[0].along is not None:
            curve, nodes = self.arc
            local = (fields[0].along.component(curve).at(nodes), *local)
        size = local[0].shape[1]
        if self.constants is not None:
            local = (*local, constant_field(self.constants))
        rows = np.zeros((0, size), dtype=np.int64) if self.rows is None else first_row + self.rows
        return element_group(self.function, positions, local, rows, self.at_points)
