"""An outer objective: a weighted sum of terms, each a sum of element functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.fields import ElementGroup, Fields
from rmesh_nlp.fem.functional import Functional

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
        The boundary whose largest pressure it is, see :mod:`rmesh_nlp.solving.plan`.
    minimised_only : bool
        Whether nobody wants it to be large: its weight must be positive.
    size : float
        In units of which its rounding is, also where its elements vanish; 0 where its value tells.
    """

    name: str
    groups: Groups
    needs_exact: bool = False
    of_positions: bool = False
    barrier: bool = False
    minimised_only: bool = False
    level_of: str | None = None
    size: float = 0.0

    @property
    def alone(self) -> Objective:
        """The objective of this term."""
        return Objective(((1.0, self),))

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
    def size(self) -> float:
        """In units of which its rounding is, also where its value is zero."""
        return sum(abs(weight) * term.size for weight, term in self.terms)

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
            raise BadInputError(f"the weight {factor} of {self.text!r} must be finite and not zero")
        for _, term in self.terms:
            if term.minimised_only and factor < 0:
                raise BadInputError(f"the weight {factor} of {term.name!r} must be positive")
        return Objective(tuple((float(factor) * weight, term) for weight, term in self.terms))

    __rmul__ = __mul__

    def __neg__(self) -> Objective:
        return -1 * self
