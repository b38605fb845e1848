"""Where a formulation ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rmesh_nlp.contact.system import OwnState
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.outer import Outer


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
    own : OwnState, optional
        The formulation's own displacement and forces. The solution is the contact solution at ``q``; a solver
        that met its own test is believed only if these hold as well.
    label : str, optional
        Stationarity of an MPCC; by default "KKT" where the measured residual allows.
    details : mapping of str to object
        Entries of the record by their names, declared in :mod:`rmesh_nlp.solving.entries`.
    remarks : tuple of str
        For people: what else there is to say of a choice of settings.
    """

    outer: Outer
    q: Array
    status: Status
    own: OwnState | None = None
    label: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def having(self, details: Mapping[str, Any], **changes: Any) -> Outcome:
        """The same with further entries."""
        return replace(self, details={**self.details, **details}, **changes)


def continuous_energy(outcome: Outcome) -> float:
    """The energy of the continuous problem at the end of a run; NaN of an invalid or unsolved mesh."""
    outer, q = outcome.outer, outcome.q
    if not outer.is_valid(q):
        return float("nan")
    outer, q = outer.at_design(q)
    continuous = outer.continuous(q)
    return continuous.energy if continuous.status is Status.CONVERGED else float("nan")
