"""Where a formulation ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rmesh_nlp.contact.system import Equilibrium
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
        Moves of ``outer``.
    status : Status
        How the solver says that it ended.
    own : Equilibrium, optional
        The formulation's own displacement and forces.
    decides : bool
        Whether ``own`` is the solution, and not the contact solution at ``q``.
    claimed : float, optional
        What the formulation says that the objective is.
    label : str, optional
        Stationarity of an MPCC; by default "KKT" where the measured residual allows.
    details : mapping
        Further entries of the record.
    """

    outer: Outer
    q: Array
    status: Status
    own: Equilibrium | None = None
    decides: bool = False
    claimed: float | None = None
    label: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)


def continuous_energy(found: Outcome) -> float:
    """The energy of the continuous problem at the end of a run; NaN of an invalid or unsolved mesh."""
    outer, q = found.outer, found.q
    if not outer.is_valid(q):
        return float("nan")
    there = outer.assessor.solve(outer.nodes(q), outer.energy(q).equilibrium.active)
    return there.energy if there.status is Status.CONVERGED else float("nan")
