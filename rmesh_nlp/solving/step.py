"""One line of a history: what is known of an iterate, whatever the strategy."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array


@dataclass(frozen=True)
class Step:
    """One line of a history.

    Attributes
    ----------
    iteration : int
    energy : float
        Objective energy at the iterate; meaningful as J only where ``primal_residual`` is small.
    t : float
        Relaxation parameter of the complementarity: finite and positive while a relaxation acts, ``inf``
        where the complementarity is not imposed, 0 where it holds exactly (contact solves, the
        exact finish of ``mpcc``).
    primal_residual : float
        Constraint violation as the solver scales it; 0 where a contact solve is exact.
    dual_residual : float
        First-order residual of the outer problem, :mod:`rmesh_nlp.models.residual`; of an all-at-once
        solver at its own displacement and forces. NaN where it is not known: in the steps of ``mpcc`` with
        another objective than the energy, but for the last.
    contact_solves : int
        Contact solves so far; 0 for the all-at-once strategies.
    seconds : float
        Wall time since the start.
    q : array or None
        The moves, only in the steps that ``on_step`` receives: a history would be too large.
    objective : float
        The outer objective that is minimised; NaN where it is not known.
    product : float
        Largest product of the members of a complementarity pair, in the units of ``mpcc``; NaN where
        there are no pairs.
    biactive : float
        Number of pairs at the corner (both members at most ``2 sqrt(t)``, in the same units); NaN
        where there are no pairs.
    stationarity : float
        First-order residual of the outer problem at the moves, by the measure of records; NaN where it
        was not measured.
    energy_given : float
        Energy on the mesh of this step before any node moved, where the meshes of a descent differ.
    seconds_left : float
        What the strategy guesses that the rest of the descent takes; NaN where it has no guess. It is
        for progress, like ``energy_given``, and no part of a history.
    """

    iteration: int
    energy: float
    t: float
    primal_residual: float
    dual_residual: float
    contact_solves: int
    seconds: float
    q: Array | None = field(default=None, repr=False, compare=False)
    objective: float = float("nan")
    product: float = float("nan")
    biactive: float = float("nan")
    stationarity: float = float("nan")
    energy_given: float = field(default=float("nan"), repr=False, compare=False)
    seconds_left: float = field(default=float("nan"), repr=False, compare=False)

    def row(self) -> dict[str, Any]:
        """The step as a plain dictionary for CSV or pandas: None where unknown, ``t`` may be ``inf``."""
        row = {key: plain(value) for key, value in asdict(replace(self, q=None)).items() if key != "q"}
        return {**row, "t": self.t} if np.isinf(self.t) else row


def plain(value: Any) -> Any:
    """A value for JSON: numbers of numpy as Python's, and None for what is not finite."""
    if isinstance(value, (np.generic,)):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
