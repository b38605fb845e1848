"""One assessment of where a formulation ended, from which its solution is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.assessor import Audit, Quantities, equilibrium_residual, law_residual, quantities
from rmesh_nlp.assessment.conclusion import Measured, conclusion
from rmesh_nlp.contact.setup_warnings import penetration_warnings, setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.mapping.validity import area_ratios
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.flips import mean_around
from rmesh_nlp.models.reduced_model import ReducedCertificate, ReducedEnergy
from rmesh_nlp.models.residual import multipliers, size_of
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.solving.outcome import Outcome
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


ENERGY_AGREEMENT = 1e-6
"""Largest relative difference between a formulation's energy and that of the exact contact solve."""

PROVED = ("S", "B")
"""Labels of an MPCC that prove first-order optimality where strict complementarity fails, and with it the
gradient of an objective other than the energy."""


@dataclass(frozen=True)
class Assessment:
    """What was measured of an outcome.

    Attributes
    ----------
    outcome : Outcome
    status : Status
        What the assessment says of it.
    valid, improved, success : bool
    measured : Measured or None
        What the status rests on; None where the contact problem could not be solved.
    assessed : tuple of Admissible, optional
        The admissible displacements on the given and on the last mesh.
    fields : mapping
        Fields of :class:`rmesh_nlp.solving.solution.Solution`.
    details : mapping
        Entries of the record.
    """

    outcome: Outcome
    status: Status
    valid: bool
    improved: bool
    success: bool
    measured: Measured | None
    assessed: tuple[Admissible, Admissible] | None
    fields: Mapping[str, Any]
    details: Mapping[str, Any]


def assess(first: Outer, outcome: Outcome, *, relocates: bool = True) -> Assessment:
    """Assess where a formulation ended.

    Parameters
    ----------
    first : Outer
        The outer problem that was given, on whose mesh everything is compared.
    outcome : Outcome
        Its outer problem may have other edges, another rule or another weight.
    relocates : bool
        Whether the formulation moves nodes at all.
    """
    outer, q = outcome.outer, outcome.q
    problem, nodes = outer.problem, outer.nodes(q)
    # what it begins from, by the same rules
    begin = outer if _is_comparable(first.problem, problem) else first
    areas = given_areas(first.problem, problem.triangles) if begin is not outer else None
    ratio = float(
        np.min(
            signed_areas(nodes, problem.triangles) / areas
            if areas is not None
            else area_ratios(problem, nodes)
        )
    )
    start = begin.assessor.initial
    common: dict[str, Any] = {
        "problem": problem,
        "objective": str(outer.objective),
        "mesh": relocated_mesh(problem.mesh, nodes),
        "energy_initial": begin.given.energy,
        "energy_initial_audited": start.energy,
        "solver_status": outcome.status,
    }
    if begin is not outer:
        common |= {"initial_nodes": np.array(first.problem.mesh.p), "initial_areas": areas}
    if not ratio > 0:
        status = Status.INVALID_MESH
        fields = {**common, **unsolved(problem, ratio)}
        return Assessment(outcome, status, False, False, False, None, None, fields, dict(outcome.details))
    exact = outer.energy(q)
    after = outer.assessor.solve(nodes, exact.equilibrium.active)
    found = outcome.own if outcome.decides and outcome.own is not None else exact.equilibrium
    audit = outer.assessor.audit(nodes, found, after, ratio)
    function = outer.function
    point = exact if isinstance(function, ReducedEnergy) else function.of(exact)
    residual = outer.residual(point)
    states = tuple(
        (one.energy, one.state if one.problem is whose.problem else own)
        for one, whose, own in ((start, begin, begin.given), (after, outer, exact.equilibrium))
    )
    decrease, size = decrease_of(begin, outer, q, states)
    if function is outer.energy and size_of(point) > 0:
        size = max(size, size_of(point))
    claimed, expected = outcome.claimed, exact.value
    if outcome.decides:
        claimed, expected = found.energy, exact.equilibrium.energy
    corrections = outer.assessor.corrections(nodes, found, after)
    proved = outcome.label in PROVED and bool(np.any(point.weak))
    measured = Measured(
        audit=audit,
        contact=first_fault(begin.given.status, start.status, exact.equilibrium.status, after.status),
        consistent=claimed is None
        or abs(claimed - expected) <= ENERGY_AGREEMENT * size_of(exact)
        or size_of(exact) == 0,
        gain=begin.given.energy - found.energy,
        gain_audited=start.energy - after.energy,
        decrease=decrease,
        size=size,
        is_energy=function is outer.energy,
        stationary=residual <= outer.tolerance or proved or not relocates,
        corrections={
            name: value - begin.assessor.initial_corrections[name] for name, value in corrections.items()
        },
    )
    end = conclusion(outcome.status, measured)
    label = outcome.label
    if label is None:
        label = "KKT" if residual <= outer.tolerance else ""
    weights = nodal_weights(problem, nodes)
    details: dict[str, Any] = {
        "tolerance": outer.tolerance,
        **own_residuals(outer.contact.system(nodes), outcome.own or found, exact.equilibrium),
        **zones(problem, exact.equilibrium),
        "exploits": measured.exploits or None,
        **_quantities(begin, outer, nodes, found),
        "warnings": warnings_of(outer.contact, begin.given, _accurate_load(outer), nodes, found),
    }
    details["objective_value"] = point.value
    if begin is outer:
        details["objective_initial"] = function(np.zeros(outer.n)).value
    if problem.motion.curves:
        was = signed_areas(first.problem.mesh.p, first.problem.triangles).sum()
        details["domain_area_change"] = signed_areas(nodes, problem.triangles).sum() / was - 1
    fields = {
        **common,
        "displacement": outer.contact.displacement.values(found.u),
        "pressure": nodal_stress(outer.contact, found.normal_force, weights),
        "tangential_stress": nodal_stress(outer.contact, found.tangential_force, weights),
        "energy": found.energy,
        "audit": audit,
        "stationarity": label,
        "stationarity_residual": residual,
        "multipliers": multipliers(outer.energy, q, point.gradient),
        "detail": EXPLOITED[measured.exploits] if end.status is Status.EXPLOITED else "",
    }
    return Assessment(
        outcome,
        end.status,
        end.valid,
        end.improved,
        end.success,
        measured,
        (start, after),
        fields,
        {**outcome.details, **details},
    )


def _is_comparable(given: ContactProblem, last: ContactProblem) -> bool:
    """Whether an end is compared with its own mesh before any motion.

    That is the given one, or a refinement. With other edges it is one that was relocated already.
    """
    one, other = given.mesh, last.mesh
    if one is other or one.p.shape != other.p.shape:
        return True
    return np.array_equal(one.p, other.p) and np.array_equal(one.t, other.t)


def _quantities(begin: Outer, outer: Outer, nodes: Array, found: Equilibrium) -> dict[str, float]:
    """Record entries: pressure, resultant and contact before and after."""
    given, entries = np.asarray(begin.problem.mesh.p), {}
    for suffix, whose, where, state in (("_initial", begin, given, begin.given), ("", outer, nodes, found)):
        here: Quantities | None = quantities(whose.problem, where, whose.contact.system(where), state)
        if here is not None:
            entries.update(here.entries(suffix))
    return entries


def _accurate_load(outer: Outer) -> Array | None:
    """Nodal loads on the mesh as given, by an accurate rule; None if it had to be refined."""
    start = outer.assessor.initial
    return start.system.load if start.problem is outer.problem else None


EXPLOITED = {
    "quadrature": "The rule for the loads is too coarse: take a higher degree.",
    "penetration": "Between its nodes the contact boundary passes into the foundation: take gap = 'edge'.",
    "friction": "The friction bound varies within edges.",
    "geometry": "The edges along a curve have grown.",
    "": "",
}
"""What the message of an exploited solution adds."""
