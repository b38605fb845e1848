"""The largest pressure as an objective: a design variable above all pressures, which is minimised.

``min max_i p_i`` has no derivative where two pressures are largest. ``min t`` subject to ``p_i <= t`` is the
same problem, and smooth where contact does not change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.contact_pressure import vertex_pressures
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.pressure import LARGEST, contact_on, level_name
from rmesh_nlp.problem import Constraint, ContactProblem
from rmesh_nlp.problem.design import Level

HEADROOM = 10.0
"""Largest level, in units of the largest pressure at the start."""


def with_levels(problem: ContactProblem, objective: Objective) -> ContactProblem:
    """The problem with a level, and a constraint, for each largest pressure in an objective."""
    boundaries = [term.level_of for _, term in objective.terms if term.level_of is not None]
    if not boundaries:
        return problem
    solver = ContactSolver(problem.at_design())
    space, forces = solver.discretisation.space, solver.given.normal_force
    levels, constraints = [], []
    for boundary in dict.fromkeys(boundaries):
        part = contact_on(space, boundary)
        peak = float(np.max(vertex_pressures(space, solver.problem.mesh.p, part, forces)))
        if not peak > 0:
            said = f"nothing presses on {boundary!r} at the start: begin with a design that is in contact"
            raise BadInputError(f"{LARGEST}({boundary}): {said}")
        level = Level(level_name(boundary), peak, (0.0, HEADROOM * peak))
        levels.append(level)
        constraints.append(Constraint(f"{LARGEST}({boundary})", (-np.inf, level.symbol)))
    return replace(
        problem,
        design=(*problem.design, *levels),
        constraints=(*problem.constraints, *constraints),
    )
