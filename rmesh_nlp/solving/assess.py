"""One assessment of where a formulation ended, from which its solution is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import Audit, equilibrium_residual, law_residual, quantities
from rmesh_nlp.assessment.conclusion import Measured, conclusion
from rmesh_nlp.contact.setup_warnings import penetration_warnings, setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import Equilibrium
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
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import ContactQuantities, Findings, Residuals, Zones
from rmesh_nlp.solving.solution import Assessment

ACCURATE = 20
"""Degree of the rule by which other objectives than the energy are assessed."""

ENERGY_AGREEMENT = 1e-6
"""Largest relative difference between a formulation's energy and that of the exact contact solve."""

PROVED = ("S", "B")
"""Labels of an MPCC that prove first-order optimality where strict complementarity fails, and with it the
gradient of an objective other than the energy."""

EXPLOITED = {
    "quadrature": "The rule for the loads is too coarse: take a higher degree.",
    "penetration": "Between its nodes the contact boundary passes into the foundation: take gap = 'edge'.",
    "friction": "The friction bound varies within edges.",
    "geometry": "The edges along a curve have grown.",
    "": "",
}
"""What the message of an exploited solution adds."""


def assess(first: Outer, outcome: Outcome, *, relocates: bool = True) -> Assessment:
    """Measure where a formulation ended, on the problem itself.

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
    begin = outer if is_comparable(first, outer) else first  # what it begins from, by the same rules
    same_edges = begin is outer
    areas = signed_areas(problem.mesh.p, problem.triangles) if same_edges else _given_areas(first, outer)
    ratios = area_ratios(problem, nodes) if same_edges else signed_areas(nodes, problem.triangles) / areas
    ratio, start = float(np.min(ratios)), begin.assessor.initial
    common: dict[str, Any] = {
        "problem": problem,
        "objective": str(outer.objective),
        "mesh": relocated_mesh(problem.mesh, nodes),
        "energy_initial": begin.given.energy,
        "energy_initial_audited": start.energy,
        "solver_status": outcome.status,
        "initial_nodes": np.array((problem if same_edges else first.problem).mesh.p),
        "initial_areas": areas,
        "details": outcome.details,
    }
    if not ratio > 0:
        return _unsolved(outer, ratio, common)
    exact = outer.energy(q)
    after = outer.assessor.solve(nodes, exact.equilibrium.active)
    found = outcome.own if outcome.decides and outcome.own is not None else exact.equilibrium
    function = outer.function
    point = exact if isinstance(function, ReducedEnergy) else function.of(exact)
    residual = outer.residual(point)
    proved = outcome.label in PROVED and bool(np.any(point.weak))
    states = tuple(
        (one.energy, one.state if one.problem is whose.problem else own)
        for one, whose, own in ((start, begin, begin.given), (after, outer, exact.equilibrium))
    )
    decrease, size = _decrease(begin, outer, q, states)
    if function is outer.energy and size_of(point) > 0:
        size = max(size, size_of(point))
    claimed, expected = outcome.claimed, exact.value
    if outcome.decides:
        claimed, expected = found.energy, exact.equilibrium.energy
    unit = size_of(exact)
    contact = (begin.given.status, start.status, exact.equilibrium.status, after.status)
    measured = Measured(
        audit=outer.assessor.audit(nodes, found, after, ratio),
        contact=next((status for status in contact if status is not Status.CONVERGED), Status.CONVERGED),
        consistent=claimed is None or unit == 0 or abs(claimed - expected) <= ENERGY_AGREEMENT * unit,
        gain=begin.given.energy - found.energy,
        gain_audited=start.energy - after.energy,
        decrease=decrease,
        size=size,
        is_energy=function is outer.energy,
        stationary=residual <= outer.tolerance or proved or not relocates,
        corrections={
            name: value - begin.assessor.initial_corrections[name]
            for name, value in outer.assessor.corrections(nodes, found, after).items()
        },
    )
    end = conclusion(outcome.status, measured)
    label = outcome.label
    if label is None:
        label = "KKT" if residual <= outer.tolerance else ""
    weights = nodal_weights(problem, nodes)
    change = None
    if problem.motion.curves:
        was = signed_areas(first.problem.mesh.p, first.problem.triangles).sum()
        change = signed_areas(nodes, problem.triangles).sum() / was - 1
    return Assessment(
        **common,
        displacement=outer.contact.displacement.values(found.u),
        pressure=_nodal_stress(outer.contact, found.normal_force, weights),
        tangential_stress=_nodal_stress(outer.contact, found.tangential_force, weights),
        energy=found.energy,
        audit=measured.audit,
        status=end.status,
        valid=end.valid,
        improved=end.improved,
        success=end.success,
        stationarity=label,
        stationarity_residual=residual,
        multipliers=multipliers(outer.energy, q, point.gradient),
        detail=EXPLOITED[measured.exploits] if end.status is Status.EXPLOITED else "",
        measured=measured,
        assessed=(start, after),
        residuals=_residuals(outer, nodes, outcome.own or found, exact.equilibrium),
        zones=_zones(outer, exact.equilibrium),
        findings=Findings(
            exploits=measured.exploits or None,
            warnings=_warnings(outer, begin.given, nodes, found),
            objective_value=point.value,
            objective_initial=function(np.zeros(outer.n)).value if same_edges else None,
            domain_area_change=change,
        ),
        quantities=_quantities(begin, outer, nodes, found),
    )


def is_comparable(first: Outer, last: Outer) -> bool:
    """Whether an end is compared with its own mesh before any motion.

    That is the given one, or a refinement. With other edges it is one that was relocated already.
    """
    one, other = first.problem.mesh, last.problem.mesh
    if one is other or one.p.shape != other.p.shape:
        return True
    return np.array_equal(one.p, other.p) and np.array_equal(one.t, other.t)


def objective_value(energy: ReducedEnergy, objective: Objective, q: Array, state: Equilibrium) -> float:
    """An objective at outer variables (n,) and a contact solution, by the assessment's rule."""
    rel = energy.relocation
    problem = rel.problem.with_rule(ACCURATE)
    groups = objective.groups(problem, rel.mesh_map.positions, rel.displacement, rel.slip)
    return float(sum(np.sum(part) for part in element_values(groups)(energy.point(q, state))))


def _unsolved(outer: Outer, ratio: float, common: dict[str, Any]) -> Assessment:
    """The assessment of a mesh on which the contact problem cannot be solved."""
    problem, nan = outer.problem, float("nan")
    n_nodes = problem.mesh.p.shape[1]
    return Assessment(
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
    )


def _zones(outer: Outer, state: Equilibrium) -> Zones | None:
    rows = outer.problem.friction_rows
    if not rows.size:
        return None
    sliding = int(np.count_nonzero(state.active.sliding[rows]))
    return Zones(int(rows.size) - sliding, sliding)


def _residuals(outer: Outer, nodes: Array, own: Equilibrium, exact: Equilibrium) -> Residuals:
    system = outer.contact.system(nodes)
    values = [
        measure(system, state.u, state.normal_force, state.tangential_force)
        for state in (own, exact)
        for measure in (equilibrium_residual, law_residual)
    ]
    return Residuals(outer.tolerance, *values)


def _warnings(outer: Outer, initial: Equilibrium, nodes: Array, state: Equilibrium) -> tuple[str, ...]:
    """Signs of a wrong set-up, and of foundations that pass into the relocated mesh."""
    start, contact = outer.assessor.initial, outer.contact
    load = start.system.load if start.problem is outer.problem else None  # by an accurate rule
    found = setup_warnings(outer.problem, contact, initial, load)
    messages = [warning.message for warning in found if warning.kind != "penetration"]
    after = penetration_warnings(outer.problem, nodes, contact.displacement.values(state.u))
    return (*messages, *(warning.message for warning in after))


def _quantities(begin: Outer, outer: Outer, nodes: Array, found: Equilibrium) -> ContactQuantities | None:
    given = np.asarray(begin.problem.mesh.p)
    before = quantities(begin.contact.discretisation.space, given, begin.contact.system(given), begin.given)
    after = quantities(outer.contact.discretisation.space, nodes, outer.contact.system(nodes), found)
    return None if before is None or after is None else ContactQuantities(before, after)


def _decrease(
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
        Outer variables.
    states : two of (float, Equilibrium)
        The continuous energy and the displacement, on the mesh as given and at ``q``.
    """
    ends, function = ((begin, np.zeros(begin.n)), (outer, q)), outer.function
    if begin is not outer and not isinstance(function, ReducedEnergy):
        # edges were flipped: objectives other than the energy are compared by their own rule
        one, two = begin.minimising(outer.objective).function(ends[0][1]).value, function(q).value
    elif isinstance(function, ReducedEnergy):
        one, two = (
            energy + (whose.energy.of_positions(at) if begin is outer else 0.0)
            for (energy, _), (whose, at) in zip(states, ends, strict=True)
        )
    elif isinstance(function, ReducedCertificate):  # by that rule already
        one, two = function(np.zeros(q.size)).value, function(q).value
    else:
        one, two = (
            objective_value(whose.energy, outer.objective, at, state)
            for (_, state), (whose, at) in zip(states, ends, strict=True)
        )
    return one - two, max(abs(one), abs(two))


def _nodal_stress(model: ContactSolver, force: Array, weights: Array) -> Array:
    """(nodes,) contact forces over the weights omega_i of their nodes, in N/m^2; zero off the contact set."""
    stress = np.zeros(model.problem.mesh.p.shape[1])
    if force.size:
        np.add.at(stress, model.contact_nodes, force / weights)  # a node may meet two foundations
    return stress


def _given_areas(first: Outer, last: Outer) -> Array:
    """(elements,) areas in the mesh as given of the last triangles, some of which it may not have."""
    problem, triangles = first.problem, last.problem.triangles
    own = problem.triangles
    areas = signed_areas(problem.mesh.p, own)
    around = mean_around(own, areas, problem.mesh.p.shape[1])[triangles].mean(axis=0)
    known = {tuple(t): a for t, a in zip(np.sort(own, axis=0).T.tolist(), areas, strict=True)}
    sought = np.sort(triangles, axis=0).T.tolist()
    return np.array([known.get(tuple(t), mean) for t, mean in zip(sought, around, strict=True)])
