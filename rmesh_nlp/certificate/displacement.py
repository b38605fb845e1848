"""What a displacement adds to the upper bound, and what keeps it from being one."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.assessment.energy import friction_energy
from rmesh_nlp.assessment.parts import ZERO
from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Edges

AT_NODES = "upper: the gap holds at the nodes only"
"""What is said of contact until the energy of an admissible displacement is the bound."""

GIVEN = "the given displacement is not"
"""Begins a fault that no stand-off removes."""

KINDS = {1: "linear", 2: "quadratic"}
"""Displacements by their order."""


def friction_work(problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, u: Array) -> Array:
    """(contact edges,) work of the friction bound on the slip of a displacement ``u`` (components, nodes)."""
    work = np.zeros(conditions.contact.size)
    if problem.frictional:
        for part in conditions.parts:
            along = u[:, skeleton.along(skeleton.order)[:, part.edges]]
            work[part.place] = friction_energy(Edges(skeleton.body, part.edges), part.obstacle, along)[0]
    return work


def displacement_faults(problem: ContactProblem, conditions: Conditions) -> tuple[str, ...]:
    """Reasons why a displacement that obeys its conditions at nodes is not known to be admissible."""
    faults = []
    if conditions.given_error > ZERO:
        faults.append(f"upper: {GIVEN} {KINDS[problem.order]} on every edge, and held at nodes only")
    if problem.obstacles:
        faults.append(AT_NODES)
    return tuple(faults)
