"""What is left on finer meshes of the gain in an objective other than the energy.

No theorem says that a lower value is a truer one: a relocation may lower the mean deflection of a body by
the error of the displacement alone. That error is smaller on uniform refinements of the two meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy, has_certificate
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.findings import objective_value
from rmesh_nlp.solving.judgement import Judgement

SMALL = 0.5
"""Surviving share below which a record warns."""


def surviving_gain(found: Judgement, warnings: Sequence[str]) -> dict[str, Any]:
    """Record entries: ``gain_surviving``, and the warnings with one more where it is small.

    None for the energy, for errors against an exact solution and bounds of errors, which are true
    by themselves, for terms in the positions alone, and where nothing was gained.
    """
    objective = _of_displacement(found.outcome.outer.objective)
    if not found.success or objective is None or not np.any(found.outcome.q):
        return {}
    share = _share(found, objective)
    if share is None:
        return {}
    if share >= SMALL:
        return {"gain_surviving": share}
    message = (
        f"only {max(share, 0):.0%} of the gain in {objective.text} is left on refined meshes: "
        "the rest is an error of the discretisation"
    )
    return {"gain_surviving": share, "warnings": [*warnings, message]}


def _of_displacement(objective: Objective) -> Objective | None:
    """The terms that depend on the displacement; None where their gain needs no check."""
    if objective.collapses or objective.needs_exact or has_certificate(objective):
        return None
    terms = tuple((weight, term) for weight, term in objective.terms if not term.of_positions)
    return Objective(terms) if terms else None


def _share(found: Judgement, objective: Objective) -> float | None:
    problem, mesh = found.outcome.outer.problem, found.fields["mesh"]
    given = replace(mesh, doflocs=found.fields.get("initial_nodes", problem.mesh.p))
    values = []
    for finer in (False, True):
        pair = []
        for one in (given, mesh):
            value = _value(problem, one, objective, finer)
            if value is None:
                return None
            pair.append(value)
        values.append(pair[0] - pair[1])
    here, finest = values
    return finest / here if here > 0 else None


def _value(problem: ContactProblem, mesh: MeshTri, objective: Objective, finer: bool) -> float | None:
    """The objective on a mesh or its refinement; None where the contact problem has no solution there."""
    there = replace(problem, mesh=mesh, reference=None)
    try:
        stated = discretise(refined(there) if finer else there)
        energy = ReducedEnergy(relocation(stated), ContactSolver(stated))
    except ProblemError:  # refined edges on a curve may fold a thin element
        return None
    state = energy.model.solve(np.asarray(stated.problem.mesh.p))
    if state.status is not Status.CONVERGED:
        return None
    return objective_value(energy, objective, np.zeros(energy.relocation.n_q), state)
