"""Nodal fields as functions of the unknowns, and groups of elements that share a local function."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array, Expression, Index, Kind, slope_of
from rmesh_nlp.fem.cells import Arc, Cell, Density, Straight
from rmesh_nlp.fem.element import PointSums, local_symbols, plain, with_design
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.curves import on_values
from rmesh_nlp.problem import ContactProblem

NONE = -1
"""Number of no unknown, of no row of constraints, of no curve."""


@dataclass(frozen=True)
class Bends:
    """Values of a field that are functions of an affine one, as coordinates of a curve are of its parameter.

    ``which`` has the field's shape: the number of the function, ``t -> value`` and twice differentiable, or
    ``NONE`` for the affine value itself.
    """

    which: Index
    functions: tuple[ca.Function, ...]

    @cached_property
    def _slopes(self) -> tuple[ca.Function, ...]:
        return tuple(map(slope_of, self.functions))

    def applied(self, t: Array, *, slopes: bool = False) -> Array:
        """Values of the field where its affine part has the values ``t``, or their derivatives by that."""
        result = np.ones(t.shape) if slopes else np.array(t)
        for number, function in enumerate(self._slopes if slopes else self.functions):
            mask = self.which == number
            result[mask] = on_values((function,), t[mask])[0]
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


@dataclass(frozen=True)
class Field:
    """A nodal field (components, nodes) as an affine function of one vector, ``scale * w[index] + offset``.

    The field is fixed at ``offset`` where the index is ``NONE``; there ``scale`` is made zero.

    Attributes
    ----------
    source : int
        Which one the vector ``w`` is of ``x, p, lam_f, lam_g``: unknowns, parameters, multipliers.
    bends : Bends, optional
        Where the value is not this affine function but a function of it.
    modes : Modes, optional
        Of positions: motions of shapes, which are added.
    along : Field, optional
        Of positions: (curves, nodes), the parameters of the nodes that are on a curve of the motion.
    design : Design, optional
        Of positions: the design variables beside them.
    """

    index: Index
    scale: Array
    offset: Array
    source: int = 0
    bends: Bends | None = None
    modes: Modes | None = None
    along: Field | None = None
    design: Design | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", np.where(self.index == NONE, 0.0, self.scale))

    @cached_property
    def varies(self) -> bool:
        """Whether any value depends on ``w``."""
        return bool(np.any(self.index != NONE))

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

    def component(self, number: int, size: int = 1) -> Field:
        """One component, or some from a number on, as a field of its own."""
        return self._picked(lambda a: a[number : number + size])

    def elements(self, chosen: Index) -> Field:
        """Some columns of a field of local values."""
        return self._picked(lambda a: a[:, chosen])

    def _picked(self, pick: Callable[[NDArray], NDArray]) -> Field:
        bends = self.bends and Bends(pick(self.bends.which), self.bends.functions)
        modes = self.modes and Modes(self.modes.amplitudes, np.stack([*map(pick, self.modes.motions)]))
        return Field(pick(self.index), pick(self.scale), pick(self.offset), self.source, bends, modes)

    def numbered_from(self, first: int) -> Field:
        """The same field, its unknowns numbered from ``first`` instead of from zero."""
        return replace(self, index=np.where(self.index == NONE, NONE, self.index + first))

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
        return replace(constant_field(self.values(w)), along=along, design=self.design)

    def slopes(self, w: Array) -> Array:
        """Derivative (components, nodes) of each value by its own unknown, zero where it has none."""
        if self.bends is None:
            return self.scale
        return self.scale * self.bends.applied(self._affine(w), slopes=True)

    def _affine(self, w: Array) -> Array:
        if not self.varies:
            return self.offset.copy()
        result = w[self.index]
        result *= self.scale
        result += self.offset
        return result


def unknown_field(shape: tuple[int, int], first: int = 0, source: int = 0) -> Field:
    """A field all of whose values are entries of ``w``, numbered node by node from ``first``."""
    components, nodes = shape
    return plain_field(first + np.arange(components * nodes).reshape(nodes, components).T, source)


def plain_field(index: Index, source: int = 0) -> Field:
    """A field whose values are entries of ``w``, and zero where the index is ``NONE``."""
    return Field(index, np.ones(index.shape), np.zeros(index.shape), source)


def constant_field(values: Array) -> Field:
    """A field that is fixed at ``values`` of shape (components, nodes or elements)."""
    offset = np.atleast_2d(np.asarray(values, dtype=float))
    return Field(np.broadcast_to(NONE, offset.shape), np.zeros(offset.shape), offset)


@dataclass(frozen=True)
class ElementGroup:
    """Elements that share one local function ``(*local columns[, sums at points]) -> (f, g)``.

    f is a scalar, g a column (possibly empty). The function is an SX Function, or an MX one where SX has no
    expression (splines). Its last argument is there with ``at_points``.

    Attributes
    ----------
    arguments : tuple of Field
        For each other argument its local values, (length, elements).
    rows : (len(g), elements) int array
        Constraint row that each local ``g`` is added to; ``NONE`` drops it.
    at_points : PointSums, optional
        Sums at points of the element whose vertices are the first argument.
    """

    function: ca.Function
    arguments: tuple[Field, ...]
    rows: Index
    at_points: PointSums | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return self.arguments[0].shape[1]

    @property
    def plain(self) -> ca.Function:
        """The function of the columns alone."""
        return plain(self.function, self.at_points)

    def shifted(self, first_row: int) -> ElementGroup:
        """The same group, its rows numbered from ``first_row`` instead of from zero."""
        return replace(self, rows=np.where(self.rows == NONE, NONE, self.rows + first_row))

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


class Forces(NamedTuple):
    """Contact forces at nodes as fields (obstacles, nodes), in N/m; zero where there are none.

    The tangential force on the body along the foundation's tangent is ``plus - minus``; with friction both
    are at least zero, and their sum is the bound ``g omega + F normal``.
    """

    normal: Field
    minus: Field
    plus: Field

    def in_units(self, unit: float) -> Forces:
        """The same of unknowns that are measured in ``unit``."""
        return Forces(*(field.in_units(unit) for field in self))


class Fields(NamedTuple):
    """What an element term is a function of.

    Displacement (components, nodes) and ``slip`` (obstacles, nodes), magnitudes, are at the nodes of
    ``space``.
    """

    space: DisplacementSpace
    positions: Field
    displacement: Field
    slip: Field
    forces: Forces | None = None

    @property
    def problem(self) -> ContactProblem:
        """What is discretised."""
        return self.space.problem

    def group(
        self,
        function: ca.Function,
        local: Sequence[Field],
        rows: Index | None = None,
        at_points: PointSums | None = None,
    ) -> ElementGroup:
        """Elements of local values; without ``rows`` they add to the objective alone.

        A function that depends on design variables gets those that it depends on as its first argument.
        """
        size = local[0].shape[1]
        rows = np.zeros((0, size), dtype=np.int64) if rows is None else rows
        whole, names = with_design(function, at_points)
        if not names:
            return ElementGroup(function, tuple(local), rows, at_points)
        design = self.positions.design
        if design is None:
            raise ValueError(f"{function.name()} depends on the design variables {', '.join(names)}")
        return ElementGroup(whole, (design.of(names, size), *local), rows)

    def edges(self, boundary: str, components: int) -> Iterator[tuple[Cell, Field, Index]]:
        """The edges of a boundary, straight ones and arcs: their symbols, their place, and their nodes."""
        for number, edges in self.problem.edges_by_curve(boundary):
            nodes = self.space.nodes_of(edges)
            if number < 0:
                edge = Straight(2, components, self.space.order, self.problem.measure)
                yield edge, self.positions.at(edges), nodes
            else:
                curve = self.problem.curves[number]
                arc = Arc(curve, components, self.space.order, self.problem.measure)
                yield arc, self.parameters(number, edges), nodes

    def parameters(self, curve: int, nodes: Index) -> Field:
        """Local values (nodes per element, elements): the parameters of nodes on a curve."""
        assert self.positions.along is not None
        return self.positions.along.component(curve).at(nodes)

    def integral(
        self,
        name: str,
        cells: Index,
        degree: int,
        density: Density,
        *,
        kind: Kind = ca.SX,
        factor: float = 1.0,
    ) -> ElementGroup:
        """``factor`` times the integral over triangles (3, n), or over outward edges (2, n)."""
        problem, order = self.problem, self.space.order
        cell = Straight(len(cells), problem.components, order, problem.measure, kind)
        value = factor * cell.integral(density, cell.rule(degree))
        local = self.positions.at(cells), self.displacement.at(self.space.nodes_of(cells))
        return self.group(cell.function(name, value), local)
