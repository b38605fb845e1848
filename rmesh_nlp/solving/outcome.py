"""Where a formulation ended."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rmesh_nlp.contact.system import OwnState
from rmesh_nlp.errors import BadInputError, expect, located
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import ByName
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import plain


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
        Entries of the record by their names: those that :mod:`rmesh_nlp.solving.entries` declares without a
        value of a Solution, or others; numbers, texts, lists and mappings of them.
    remarks : tuple of str
        For people: what else there is to say of a choice of settings.
    lacks : str
        What was asked for and not reached, as a sentence; then nothing is a success.
    """

    outer: Outer
    q: Array
    status: Status
    own: OwnState | None = None
    label: str | None = None
    details: ByName = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    lacks: str = ""

    def __post_init__(self) -> None:
        expect("the status of an outcome", self.status, Status)
        if np.shape(self.q) != (self.outer.n,):
            raise BadInputError(f"q of an outcome must be of shape ({self.outer.n},), got {np.shape(self.q)}")
        if of_driver := [name for name in self.details if name in ENTRIES and ENTRIES[name].of is not None]:
            raise BadInputError(f"details: the driver itself writes {', '.join(of_driver)}")
        with located("details", (TypeError,)):
            json.dumps(plain(self.details))

    def having(self, details: ByName, **changes: Any) -> Outcome:
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
