"""Whether an end is stationary in the outer variables: residual, label over the branches, multipliers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rmesh_nlp.models.reduced_model import ReducedObjective, ReducedPoint
from rmesh_nlp.models.residual import OuterMultipliers, released
from rmesh_nlp.mpcc.result import in_words
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import ByName, Values
from rmesh_nlp.solving.outer import Outer

MET = (Status.CONVERGED, Status.ACCEPTABLE, Status.NOT_STATIONARY)
"""Ends of a solver that met a test of its own."""

PROVED = ("S", "B")
"""Labels of an MPCC that prove first-order optimality where strict complementarity fails, and with it the
gradient of an objective other than the energy."""


@dataclass(frozen=True)
class FirstOrder:
    """First-order conditions of the outer problem, as measured.

    Attributes
    ----------
    residual : float
        Relative to that on the mesh as given (:mod:`rmesh_nlp.models.residual`); NaN where nothing is to be
        stationary in.
    stationarity : str
        "KKT" or an MPCC label (W, C, M, S, B) where it was computed, else "".
    is_stationary : bool
        To the tolerance of the solve, over the branches of the contact where there are several.
    multipliers : OuterMultipliers or None
        Of move limits, areas and angles; where they are large, position or connectivity is the limit.
    label : mapping of str to object
        Entries of the record about stationarity where contact is about to change, for other objectives than
        the energy, whatever formulation ended there.
    """

    residual: float = float("nan")
    stationarity: str = ""
    is_stationary: bool = False
    multipliers: OuterMultipliers | None = field(default=None, repr=False)
    label: ByName = field(default_factory=dict)


def first_order(
    outer: Outer, point: ReducedPoint, proposed: str | None, said: Status, relocates: bool
) -> FirstOrder:
    """Measure the first-order conditions at a point of the outer objective.

    Parameters
    ----------
    proposed : str or None
        The label of the formulation, for the energy.
    said : Status
        How the solver says that it ended.
    relocates : bool
        Whether nodes move at all; if not, there is nothing to be stationary in.
    """
    rates = released(outer.energy, point.q, point.gradient, outer.constraints)
    residual, pulls = rates.residual(outer.residual.unit), rates.multipliers
    holds = residual <= outer.tolerance
    if relocates and isinstance(outer.function, ReducedObjective):
        stationarity, label = _over_branches(outer, point, holds, said in MET)
        return FirstOrder(residual, stationarity, bool(label["b_stationary"]), pulls, label)
    proved = proposed in PROVED and bool(np.any(point.weak))
    if proposed is None:
        proposed = "KKT" if holds else ""
    at_rest = not (holds or proved or relocates) and said in MET
    return FirstOrder(math.nan if at_rest else residual, proposed, holds or proved or at_rest, pulls)


def _over_branches(outer: Outer, point: ReducedPoint, holds: bool, claimed: bool) -> tuple[str, Values]:
    """Stationarity label over the branches of the contact, with entries; the energy is smooth across them.

    Where no pair is biactive a small first-order residual is the proof. A large one is none against it if the
    solver ``claimed`` to have met its test: its multipliers are fitted without a look at the signs of those
    of limits, and linear programs tell.
    """
    if not np.any(point.weak) and (holds or not claimed):
        label = "S" if holds else ""
        words = in_words(label, holds, 0)
        return label, {"label": words, "b_stationary": holds, "biactive": 0, "biactive_nodes": []}
    branch = outer.branches(point)
    words = in_words(branch.label, branch.b_stationary, branch.pairs.size)
    nodes = np.unique(outer.contact.contact_nodes[outer.kkt.pair_rows(branch.pairs)]).tolist()
    return branch.label, {
        "label": words,
        "b_stationary": branch.b_stationary,
        "biactive": branch.pairs.size,
        "biactive_nodes": nodes,
        "descent_rate": branch.rate,
    }
