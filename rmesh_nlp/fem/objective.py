"""An outer objective: a weighted sum of terms, each a sum of element functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Kind
from rmesh_nlp.fem.cells import Density, Straight
from rmesh_nlp.fem.fields import ElementGroup, Field, element_group
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.problem import ContactProblem


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
    """What a term is a function of; ``slip`` (obstacles, nodes) has magnitudes."""

    problem: ContactProblem
    positions: Field
    displacement: Field
    slip: Field
    forces: Forces | None = None

    @property
    def space(self) -> DisplacementSpace:
        """That of the displacement."""
        return self.displacement.space or DisplacementSpace(self.problem)

    def group(self, function: ca.Function, vertices: Index, nodes: Index) -> ElementGroup:
        """The sum over cells of a function of X_e and u_e.

        ``vertices`` are (k, n); ``nodes`` (m, n) are the space's, u_e the coefficients there.
        """
        local = self.positions.at(vertices), self.displacement.at(nodes)
        return element_group(function, self.positions, local)

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
        cell = Straight(len(cells), self.problem.components, self.space.order, kind)
        value = factor * cell.integral(density, cell.rule(degree))
        return self.group(cell.function(name, value), cells, self.space.nodes_of(cells))


Groups = Callable[[Fields], list[ElementGroup] | Functional]
"""Element groups whose sum is the value of a term, or a function of several such sums; a ValueError where the
term does not suit the problem."""


@dataclass(frozen=True)
class Term:
    """One term of an outer objective.

    Attributes
    ----------
    name : str
        For records and messages.
    groups : function
        See ``Groups``.
    needs_exact : bool
        Whether it compares with the exact or reference solution of the problem.
    of_positions : bool
        Whether it is a sum over elements that depends on the positions alone.
    barrier : bool
        Whether it is infinite at the boundary of the valid meshes, and NaN beyond.
    level_of : str, optional
        The boundary whose largest pressure it is, see :mod:`rmesh_nlp.solving.epigraph`.
    minimised_only : bool
        Whether nobody wants it to be large: its weight must be positive.
    """

    name: str
    groups: Groups
    needs_exact: bool = False
    of_positions: bool = False
    barrier: bool = False
    minimised_only: bool = False
    level_of: str | None = None

    def on(self, fields: Fields) -> Functional:
        """Its value on these fields."""
        value = self.groups(fields)
        return value if isinstance(value, Functional) else Functional(value)


@dataclass(frozen=True)
class Objective:
    """A weighted sum of terms, which a formulation minimises.

    Objectives are added and multiplied by numbers. ``str`` gives the text for records.

    Attributes
    ----------
    terms : tuple of (weight, Term)
    """

    terms: tuple[tuple[float, Term], ...]

    @property
    def text(self) -> str:
        """The sum as text, such as ``error-l2 + 0.01*quality``."""
        return " + ".join(t.name if weight == 1 else f"{weight:g}*{t.name}" for weight, t in self.terms)

    def __str__(self) -> str:
        return self.text

    @property
    def is_energy(self) -> bool:
        """Whether it is a positive multiple of the energy alone."""
        return [term.name for _, term in self.terms] == ["energy"]

    @property
    def collapses(self) -> bool:
        """Whether it is the energy, once, and terms in the positions alone: both levels are one NLP."""
        energies = [weight for weight, term in self.terms if term.name == "energy"]
        return energies == [1.0] and all(t.of_positions for _, t in self.terms if t.name != "energy")

    @property
    def has_barrier(self) -> bool:
        """Whether a term is infinite at the boundary of the valid meshes."""
        return any(term.barrier for _, term in self.terms)

    @property
    def needs_exact(self) -> bool:
        """Whether a term compares with an exact or reference solution."""
        return any(term.needs_exact for _, term in self.terms)

    @property
    def in_positions(self) -> Objective:
        """Its terms in the positions alone."""
        return Objective(tuple((weight, term) for weight, term in self.terms if term.of_positions))

    def on(self, fields: Fields) -> Functional:
        """Its value on these fields."""
        return sum((term.on(fields).scaled(weight) for weight, term in self.terms), start=Functional([]))

    def __add__(self, other: Objective) -> Objective:
        return Objective((*self.terms, *other.terms)) if isinstance(other, Objective) else NotImplemented

    def __mul__(self, factor: float) -> Objective:
        if not isinstance(factor, (int, float, np.number)):
            return NotImplemented
        if not (np.isfinite(factor) and factor != 0):
            raise ValueError(f"the weight {factor} of {self.text!r} must be finite and not zero")
        for _, term in self.terms:
            if term.minimised_only and factor < 0:
                raise ValueError(f"the weight {factor} of {term.name!r} must be positive")
        return Objective(tuple((float(factor) * weight, term) for weight, term in self.terms))

    __rmul__ = __mul__

    def __neg__(self) -> Objective:
        return -1 * self
