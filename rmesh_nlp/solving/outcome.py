"""Where a formulation ended."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part

P = TypeVar("P", bound=Part)


@dataclass(frozen=True)
class Outcome:
    """Where a formulation ended.

    Attributes
    ----------
    outer : Outer
        What was minimised last: the outer problem that was given, or one on another mesh, with another rule
        or weight.
    q : (n,) array
        Outer variables of ``outer``.
    status : Status
        How the solver says that it ended.
    own : Equilibrium, optional
        The formulation's own displacement and forces. The solution is the contact solution at ``q``; a solver
        that met its own test is believed only if these hold as well.
    label : str, optional
        Stationarity of an MPCC; by default "KKT" where the measured residual allows.
    details : tuple of Part
        Typed entries of the record.
    remarks : tuple of str
        For people: what else there is to say of a choice of settings.
    """

    outer: Outer
    q: Array
    status: Status
    own: Equilibrium | None = None
    label: str | None = None
    details: tuple[Part, ...] = ()
    remarks: tuple[str, ...] = ()

    def having(self, *parts: Part, **changes: Any) -> Outcome:
        """The same with further entries, each in the place of one of its type."""
        kept = {type(part): part for part in (*self.details, *parts)}
        return replace(self, details=tuple(kept.values()), **changes)

    def after(self, before: Outcome) -> Outcome:
        """The same with the entries of what ran before, where it has none of their type."""
        remarks = tuple(dict.fromkeys((*before.remarks, *self.remarks)))
        return replace(self, details=before.having(*self.details).details, remarks=remarks)

    def part(self, kind: type[P]) -> P | None:
        """The entries of a type; None if there are none."""
        return next((part for part in self.details if isinstance(part, kind)), None)


def continuous_energy(outcome: Outcome) -> float:
    """The energy of the continuous problem at the end of a run; NaN of an invalid or unsolved mesh."""
    outer, q = outcome.outer, outcome.q
    if not outer.is_valid(q):
        return float("nan")
    outer, q = outer.at_design(q)
    continuous = outer.assessor.solve(outer.nodes(q), outer.energy(q).equilibrium.active)
    return continuous.energy if continuous.status is Status.CONVERGED else float("nan")
