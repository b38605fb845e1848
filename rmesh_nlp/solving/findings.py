"""What the referee finds out about a mesh and its contact solution, beside the audit itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import Audit, equilibrium_residual, law_residual
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.setup_warnings import penetration_warnings, setup_warnings
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.outer_function import Reduced
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.reduced_certificate import ReducedCertificate
from rmesh_nlp.solving.solution import Solution

ACCURATE = 20
"""Degree of the rule by which other objectives than the energy are assessed."""


def zones(problem: ContactProblem, state: Equilibrium) -> dict[str, int]:
    """Record entries of a problem with friction: how many of its nodes stick, and how many slide."""
    rows = problem.friction_rows
    if not rows.size:
        return {}
    sliding = int(np.count_nonzero(state.active.sliding[rows]))
    return {"sticking_nodes": int(rows.size) - sliding, "sliding_nodes": sliding}


def residuals(system: ContactSystem, own: Equilibrium, exact: Equilibrium) -> dict[str, float]:
    """Record entries: residuals of the strategy's own state, and of the referee's contact solve."""
    return {
        f"{name}_{kind}_residual": measure(system, state.u, state.normal_force, state.tangential_force)
        for name, state in (("own", own), ("referee", exact))
        for kind, measure in (("equilibrium", equilibrium_residual), ("complementarity", law_residual))
    }


def warnings_of(
    model: ContactModel, initial: Equilibrium, load: Array | None, nodes: Array, state: Equilibrium
) -> list[str]:
    """Signs of a wrong set-up, and of foundations that pass into the relocated mesh.

    Parameters
    ----------
    model : ContactModel
    initial, state : Equilibrium
        On the mesh as given and at the relocated ``nodes`` (2, nodes).
    load : (n_u,) array, optional
        Nodal loads on the mesh as given by an accurate rule.
    """
    found = setup_warnings(model.problem, model, initial, load)
    messages = [warning.message for warning in found if warning.kind != "penetration"]
    after = penetration_warnings(model.problem, nodes, model.displacement.values(state.u))
    return messages + [warning.message for warning in after]


def decrease_of(
    energy: ReducedEnergy,
    function: Reduced,
    objective: str | Objective,
    q: Array,
    before: tuple[float, Equilibrium],
    after: tuple[float, Equilibrium],
) -> tuple[float, float]:
    """Decrease of the minimised objective, measured by the assessment, and the objective's size.

    Parameters
    ----------
    energy : ReducedEnergy
    function : Reduced
        The objective as a function of the moves; the energy itself, or another one.
    objective : str or Objective
    q : (n_q,) array
        The moves.
    before, after : (float, Equilibrium)
        The continuous energy on the mesh as given and at the moves, and the displacement.
    """
    zero = np.zeros(q.size)
    if function is energy:
        one = before[0] + energy.of_positions(zero)
        two = after[0] + energy.of_positions(q)
    elif isinstance(function, ReducedCertificate):  # by that rule already
        one, two = function(zero).value, function(q).value
    else:
        outer = parse_objective(objective)
        one, two = (
            objective_value(energy, outer, moves, state)
            for moves, state in ((zero, before[1]), (q, after[1]))
        )
    return one - two, max(abs(one), abs(two))


def objective_value(energy: ReducedEnergy, objective: Objective, q: Array, state: Equilibrium) -> float:
    """An objective at moves (n_q,) and a contact solution, by the assessment's rule."""
    rel = energy.relocation
    problem = rel.problem.with_rule(ACCURATE)
    groups = objective.groups(problem, rel.freedoms.positions, rel.displacement, rel.slip)
    return float(sum(np.sum(part) for part in element_values(groups)(energy.point(q, state))))


def nodal_stress(model: ContactModel, force: Array, weights: Array) -> Array:
    """(nodes,) contact forces over the weights omega_i of their nodes, in N/m^2; zero off the contact set."""
    stress = np.zeros(model.problem.mesh.p.shape[1])
    if force.size:
        np.add.at(stress, model.contact_nodes, force / weights)  # a node may meet two foundations
    return stress


def first_fault(*ends: Status) -> Status:
    """CONVERGED, or the first status of a contact solve that is another."""
    return next((status for status in ends if status is not Status.CONVERGED), Status.CONVERGED)


def without_solution(common: dict[str, Any], problem: ContactProblem, ratio: float, said: Status) -> Solution:
    """A row for a mesh on which the contact problem cannot be solved."""
    nan = float("nan")
    n_nodes = problem.mesh.p.shape[1]
    return Solution(
        **common,
        displacement=np.full((problem.components, n_nodes), nan),
        pressure=np.full(n_nodes, nan),
        tangential_stress=np.full(n_nodes, nan),
        energy=nan,
        audit=Audit(nan, nan, nan, ratio),
        status=Status.INVALID_MESH,
        valid=False,
        improved=False,
        success=False,
        stationarity="",
        stationarity_residual=nan,
        solver_status=said,
    )
