"""What is found out about a mesh and its contact solution, beside the audit itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import Audit, equilibrium_residual, law_residual
from rmesh_nlp.contact.setup_warnings import penetration_warnings, setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.flips import mean_around
from rmesh_nlp.models.reduced_model import ReducedCertificate, ReducedEnergy
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.solving.outer import Outer

ACCURATE = 20
"""Degree of the rule by which other objectives than the energy are assessed."""


def zones(problem: ContactProblem, state: Equilibrium) -> dict[str, int]:
    """Record entries of a problem with friction: how many of its nodes stick, and how many slide."""
    rows = problem.friction_rows
    if not rows.size:
        return {}
    sliding = int(np.count_nonzero(state.active.sliding[rows]))
    return {"sticking_nodes": int(rows.size) - sliding, "sliding_nodes": sliding}


def own_residuals(system: ContactSystem, own: Equilibrium, exact: Equilibrium) -> dict[str, float]:
    """Record entries: residuals of the formulation's own state, and of the exact contact solve."""
    return {
        f"{name}_{kind}_residual": measure(system, state.u, state.normal_force, state.tangential_force)
        for name, state in (("own", own), ("assessed", exact))
        for kind, measure in (("equilibrium", equilibrium_residual), ("complementarity", law_residual))
    }


def warnings_of(
    model: ContactSolver, initial: Equilibrium, load: Array | None, nodes: Array, state: Equilibrium
) -> list[str]:
    """Signs of a wrong set-up, and of foundations that pass into the relocated mesh.

    Parameters
    ----------
    model : ContactSolver
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
    begin: Outer, outer: Outer, q: Array, states: Sequence[tuple[float, Equilibrium]]
) -> tuple[float, float]:
    """Decrease of the minimised objective, measured by the assessment, and the objective's size.

    Parameters
    ----------
    begin : Outer
        Whose mesh as given it is compared with.
    outer : Outer
        What was minimised.
    q : (n,) array
        The moves.
    states : two of (float, Equilibrium)
        The continuous energy and the displacement, on the mesh as given and at the moves.
    """
    ends, function = ((begin, np.zeros(begin.n)), (outer, q)), outer.function
    if begin is not outer and not isinstance(function, ReducedEnergy):
        # edges were flipped: objectives other than the energy are compared by their own rule
        one, two = begin.minimising(outer.objective).function(ends[0][1]).value, function(q).value
    elif isinstance(function, ReducedEnergy):
        one, two = (
            energy + (whose.energy.of_positions(moves) if begin is outer else 0.0)
            for (energy, _), (whose, moves) in zip(states, ends, strict=True)
        )
    elif isinstance(function, ReducedCertificate):  # by that rule already
        one, two = function(np.zeros(q.size)).value, function(q).value
    else:
        one, two = (
            objective_value(whose.energy, outer.objective, moves, state)
            for (_, state), (whose, moves) in zip(states, ends, strict=True)
        )
    return one - two, max(abs(one), abs(two))


def objective_value(energy: ReducedEnergy, objective: Objective, q: Array, state: Equilibrium) -> float:
    """An objective at moves (n_q,) and a contact solution, by the assessment's rule."""
    rel = energy.relocation
    problem = rel.problem.with_rule(ACCURATE)
    groups = objective.groups(problem, rel.mesh_map.positions, rel.displacement, rel.slip)
    return float(sum(np.sum(part) for part in element_values(groups)(energy.point(q, state))))


def nodal_stress(model: ContactSolver, force: Array, weights: Array) -> Array:
    """(nodes,) contact forces over the weights omega_i of their nodes, in N/m^2; zero off the contact set."""
    stress = np.zeros(model.problem.mesh.p.shape[1])
    if force.size:
        np.add.at(stress, model.contact_nodes, force / weights)  # a node may meet two foundations
    return stress


def first_fault(*ends: Status) -> Status:
    """CONVERGED, or the first status of a contact solve that is another."""
    return next((status for status in ends if status is not Status.CONVERGED), Status.CONVERGED)


def unsolved(problem: ContactProblem, ratio: float) -> dict[str, Any]:
    """Fields of the solution of a mesh on which the contact problem cannot be solved."""
    nan, n_nodes = float("nan"), problem.mesh.p.shape[1]
    return {
        "displacement": np.full((problem.components, n_nodes), nan),
        "pressure": np.full(n_nodes, nan),
        "tangential_stress": np.full(n_nodes, nan),
        "energy": nan,
        "audit": Audit(nan, nan, nan, ratio),
        "stationarity": "",
        "stationarity_residual": nan,
    }


def given_areas(problem: ContactProblem, triangles: np.ndarray) -> np.ndarray:
    """(elements,) areas in the mesh as given of triangles (3, elements), some of which it may not have."""
    own = problem.triangles
    areas = signed_areas(problem.mesh.p, own)
    around = mean_around(own, areas, problem.mesh.p.shape[1])[triangles].mean(axis=0)
    known = {tuple(t): a for t, a in zip(np.sort(own, axis=0).T.tolist(), areas, strict=True)}
    sought = np.sort(triangles, axis=0).T.tolist()
    return np.array([known.get(tuple(t), mean) for t, mean in zip(sought, around, strict=True)])
