"""The outer objective of a problem as a function of the moves alone, by what it consists of."""

from __future__ import annotations

from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.reduced import ReducedEnergy, ReducedObjective
from rmesh_nlp.models.reduced_certificate import NAME, ReducedCertificate

Reduced = ReducedEnergy | ReducedObjective | ReducedCertificate
"""An outer objective as a function of the moves alone."""


def has_certificate(objective: Objective) -> bool:
    """Whether the bound of the error is among the terms of an objective."""
    return any(term.name == NAME for _, term in objective.terms)


def outer_function(energy: ReducedEnergy, objective: Objective) -> ReducedObjective | ReducedCertificate:
    """Any outer objective but the energy by itself."""
    kind = ReducedCertificate if has_certificate(objective) else ReducedObjective
    return kind(energy, objective)
