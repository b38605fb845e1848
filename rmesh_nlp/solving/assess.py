"""One assessment of where a formulation ended, from which its solution is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.assessor import Audit, equilibrium_residual, law_residual, quantities
from rmesh_nlp.assessment.conclusion import MET, Measured, conclusion
from rmesh_nlp.assessment.coulomb import coulomb_residual, growth
from rmesh_nlp.contact.setup_warnings import penetration_warnings, setup_warnings
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.contact.uniqueness import contraction
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.kkt_model import kkt_unknowns
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedObjective, ReducedPoint
from rmesh_nlp.models.residual import multipliers, size_of
from rmesh_nlp.mpcc.result import in_words
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.problem.design import names_in
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Constrained, ContactQuantities, Findings, Label
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
}
"""What the message of an exploited solution adds."""


@dataclass(frozen=True)
class _Ends:
    """The two meshes that are compared: where ``begin`` begins, and the last one of ``outer``, at ``q``.

    ``exact`` and ``point`` are the energy and the outer objective at ``q``, ``found`` is the solution there;
    ``start`` and ``after`` are the admissible displacements of the assessment on either mesh. Of a problem
    with design variables both are the problems at the first and at the last design; ``designed`` is the one
    that has them, where ``point`` is. ``comparable`` says that it is where both ends are.
    """

    begin: Outer
    outer: Outer
    designed: Outer
    q: Array
    nodes: Array
    exact: ReducedPoint
    point: ReducedPoint
    found: Equilibrium
    start: Admissible
    after: Admissible
    comparable: bool

    @property
    def at_start(self) -> ReducedPoint:
        """The outer objective at the first design on the mesh before any motion."""
        return self.designed.function(np.zeros(self.designed.n))


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
    designed = outcome.outer
    nodes, given = designed.nodes(outcome.q), np.array(designed.problem.mesh.p)
    begin = designed if is_comparable(first, designed) else first  # what it begins from, by the same rules
    areas = signed_areas(given, designed.problem.triangles)
    upright = bool(np.min(signed_areas(nodes, designed.problem.triangles) / areas) > 0)
    comparable = begin is designed
    begin = begin.at_design(np.zeros(begin.n))[0]
    outer, q = designed.at_design(outcome.q) if upright else (begin, outcome.q)
    problem, start = outer.problem, begin.assessor.initial
    ratio = float(np.min(signed_areas(nodes, problem.triangles) / areas))
    common: dict[str, Any] = {
        "problem": problem,
        "objective": str(outer.objective),
        "mesh": relocated_mesh(problem.mesh, nodes),
        "energy_initial": begin.given.energy,
        "energy_initial_audited": start.energy,
        "solver_status": outcome.status,
        "initial_nodes": given,
        "initial_areas": areas,
        "details": outcome.details,
        "design": designed.figures(outcome.q),
        "designed": designed.problem if designed.figures(outcome.q) else None,
    }
    if not ratio > 0:  # the contact problem cannot be solved
        unknown = np.full((problem.components, outer.discretisation.space.n_nodes), np.nan)
        stress = {"pressure": unknown[0], "tangential_stress": unknown[0]}
        audit = Audit(np.nan, np.nan, np.nan, ratio)
        return Assessment(**common, **stress, displacement=unknown, audit=audit, status=Status.INVALID_MESH)
    exact = outer.energy(q)
    ends = _Ends(
        begin,
        outer,
        designed,
        q,
        nodes,
        exact,
        point=designed.function(outcome.q),
        found=outcome.own if outcome.decides and outcome.own is not None else exact.equilibrium,
        start=start,
        after=outer.assessor.solve(nodes, exact.equilibrium.active),
        comparable=comparable,
    )
    residual = designed.residual(ends.point)
    over_branches = _over_branches(ends, residual, outcome.status in MET) if relocates else None
    if over_branches is None:
        label, words = outcome.label, None
        proved = label in PROVED and bool(np.any(ends.point.weak))
        stationary = residual <= designed.tolerance or proved or not relocates
        if label is None:
            label = "KKT" if residual <= designed.tolerance else ""
    else:
        label, words = over_branches
        stationary = bool(words.b_stationary)
    measured = _measured(ends, outcome, ratio, stationary)
    end, constrained = conclusion(outcome.status, measured), _constrained(ends)
    detail = EXPLOITED.get(measured.exploits, "") if end.status is Status.EXPLOITED else ""
    if end.status is Status.VIOLATED:
        broken = {text: one for text, one in constrained.items() if one.violation > designed.tolerance}
        detail = "; ".join(f"{text} = {one.in_words()}" for text, one in broken.items())
    return Assessment(
        **common,
        displacement=outer.discretisation.space.values(outer.contact.displacement.values(ends.found.u)),
        pressure=_nodal_stress(ends, ends.found.normal_force),
        tangential_stress=_nodal_stress(ends, ends.found.tangential_force),
        energy=ends.found.energy,
        audit=measured.audit,
        status=end.status,
        valid=end.valid,
        improved=end.improved,
        success=end.success,
        stationarity=label,
        stationarity_residual=residual,
        multipliers=multipliers(designed.energy, outcome.q, ends.point.gradient, designed.constraints),
        detail=detail,
        measured=measured,
        assessed=(start, ends.after),
        findings=_findings(ends, outcome.own or ends.found, first.problem, measured.exploits or None),
        quantities=_quantities(ends),
        label=words,
        constraints=constrained,
    )


def _constrained(ends: _Ends) -> dict[str, Constrained]:
    """What the problem constrains, where it ended, without levels; what is bounded twice is there once."""
    rows, found = ends.designed.constraints, dict[str, Constrained]()
    own = ends.designed.problem.constraints
    for one, (text, *figures) in zip(own, [] if rows is None else rows.values(ends.point), strict=False):
        if not set(names_in(one.bounds[1])) <= ends.designed.figures(ends.point.q).keys():
            continue
        value, lower, upper = figures
        known = found.get(text, Constrained(value, lower, upper))
        found[text] = Constrained(value, max(lower, known.lower), min(upper, known.upper))
    return found


def _over_branches(ends: _Ends, residual: float, claimed: bool) -> tuple[str, Label] | None:
    """Stationarity label over the branches of the contact; None for the energy, which is smooth across them.

    Where no pair is biactive a small first-order residual is the proof. A large one is none against it if the
    solver ``claimed`` to have met its test: its multipliers are fitted without a look at the signs of those
    of limits, and linear programs tell.
    """
    outer, point = ends.designed, ends.point
    if not isinstance(outer.function, ReducedObjective):
        return None
    stationary = residual <= outer.tolerance
    if not np.any(point.weak) and (stationary or not claimed):
        label = "S" if stationary else ""
        return label, Label(in_words(label, stationary, 0), stationary, 0, [])
    found = outer.branches(point)
    words = in_words(found.label, found.b_stationary, found.pairs.size)
    nodes = outer.kkt.pair_rows(found.pairs)
    return found.label, Label(
        words,
        found.b_stationary,
        int(found.pairs.size),
        np.unique(outer.contact.contact_nodes[nodes]).tolist(),
        found.rate,
    )


def is_comparable(first: Outer, last: Outer) -> bool:
    """Whether an end is compared with its own mesh before any motion, and not with the given one.

    Its mesh is the given one or a refinement of it: nodes of that keep their numbers. A new mesh was
    made to have less error.
    """
    one, other = first.problem.mesh, last.problem.mesh
    n = one.p.shape[1]
    kept = other.p.shape[1] >= n and np.array_equal(one.p, other.p[:, :n])
    return one is other or (kept and (other.p.shape[1] > n or np.array_equal(one.t, other.t)))


def objective_value(energy: ReducedEnergy, objective: Objective, q: Array, state: Equilibrium) -> float:
    """An objective at outer variables (n,) and a contact solution, by the assessment's rule."""
    rel = energy.relocation
    fields, accurate = rel.discretisation.fields(), rel.problem.with_rule(ACCURATE)
    fields = fields._replace(problem=accurate, positions=fields.positions.at_rest(q))
    system = energy.model.system(rel.nodes(q), rel.mesh_map.design(q))
    x = kkt_unknowns(q, state, system, rel.friction_rows)
    return objective.on(fields).evaluate()(x)


def _measured(ends: _Ends, outcome: Outcome, ratio: float, stationary: bool) -> Measured:
    """What the status rests on."""
    begin, outer, designed, found, after = ends.begin, ends.outer, ends.designed, ends.found, ends.after
    is_energy = outer.function is outer.energy
    decrease, size = _decrease(ends)
    if is_energy:
        size = max(size, size_of(ends.point))
    claimed, expected = outcome.claimed, ends.exact.value
    if outcome.decides:
        claimed, expected = found.energy, ends.exact.equilibrium.energy
    unit = size_of(ends.exact)
    solves = (begin.given.status, ends.start.status, ends.exact.equilibrium.status, after.status)
    before = begin.assessor.initial_corrections
    return Measured(
        audit=outer.assessor.audit(ends.nodes, found, after, ratio),
        contact=next((status for status in solves if status is not Status.CONVERGED), Status.CONVERGED),
        consistent=claimed is None or unit == 0 or abs(claimed - expected) <= ENERGY_AGREEMENT * unit,
        gain=begin.given.energy - found.energy,
        gain_audited=ends.start.energy - after.energy,
        gain_computed=max(begin.given.energy, ends.start.energy) - found.energy,
        decrease=decrease,
        violation=designed.merit(ends.point)[0],
        begins_violated=designed.constraints is not None and designed.merit(ends.at_start)[0] > 0,
        size=size,
        is_energy=is_energy,
        stationary=stationary,
        corrections={
            name: value - before[name]
            for name, value in outer.assessor.corrections(ends.nodes, found, after).items()
        },
    )


def _decrease(ends: _Ends) -> tuple[float, float]:
    """Decrease of the minimised objective, measured by the assessment, and the objective's size."""
    begin, outer, q, function = ends.begin, ends.outer, ends.q, ends.outer.function
    same, zero = begin is outer, np.zeros(begin.n)
    if ends.designed.problem.design and isinstance(function, ReducedObjective):
        one, two = (
            objective_value(at.energy, outer.objective, q, state)
            for at, q, state in ((begin, zero, begin.given), (outer, ends.q, ends.exact.equilibrium))
        )
    elif isinstance(function, ReducedEnergy):
        one, two = ends.start.energy, ends.after.energy
        if same:
            one, two = one + outer.energy.of_positions(zero), two + outer.energy.of_positions(q)
    elif not same:  # on another mesh by the objective's own rule
        one, two = begin.minimising(outer.objective).function(zero).value, function(q).value
    else:
        one, two = (
            objective_value(
                outer.energy, outer.objective, at, there.state if there.problem is outer.problem else own
            )
            for at, there, own in ((zero, ends.start, begin.given), (q, ends.after, ends.exact.equilibrium))
        )
    return one - two, max(abs(one), abs(two))


def _findings(ends: _Ends, own: Equilibrium, given: ContactProblem, exploits: str | None) -> Findings:
    """What else is measured of the last mesh; ``own`` is the formulation's displacement."""
    outer, problem, exact = ends.outer, ends.outer.problem, ends.exact.equilibrium
    system, rows = outer.contact.system(ends.nodes), ends.outer.discretisation.friction_rows
    sliding = int(np.count_nonzero(exact.active.sliding[rows])) if rows.size else None
    change = None
    if problem.motion.curves:
        was = signed_areas(given.mesh.p, given.triangles).sum()
        change = signed_areas(ends.nodes, problem.triangles).sum() / was - 1
    residuals = {
        f"{whose}_{name}_residual": measure(system, state.u, state.normal_force, state.tangential_force)
        for whose, state in (("own", own), ("assessed", exact))
        for name, measure in (("equilibrium", equilibrium_residual), ("complementarity", law_residual))
    }
    before, after = _coulomb(ends)
    grown = growth(before, after)
    return Findings(
        tolerance=outer.tolerance,
        **residuals,
        sticking_nodes=None if sliding is None else int(rows.size) - sliding,
        sliding_nodes=sliding,
        exploits=exploits,
        warnings=_warnings(ends) + (() if grown is None else (grown,)),
        objective_value=ends.point.value,
        objective_initial=ends.at_start.value if ends.comparable else None,
        domain_area_change=change,
        coulomb_residual=after,
        coulomb_residual_initial=before,
    )


def _coulomb(ends: _Ends) -> tuple[float | None, float | None]:
    """Violation of Coulomb's law along edges on the given and on the last mesh."""
    before, after = (
        coulomb_residual(
            outer.discretisation.space,
            nodes,
            outer.contact.displacement.values(state.u),
            state.normal_force,
            state.tangential_force,
        )
        for outer, nodes, state in (
            (ends.begin, np.asarray(ends.begin.problem.mesh.p), ends.begin.given),
            (ends.outer, ends.nodes, ends.found),
        )
    )
    return before, after


def _warnings(ends: _Ends) -> tuple[str, ...]:
    """Signs of a wrong set-up, and of foundations that pass into the relocated mesh."""
    begin, start = ends.begin, ends.start
    load = start.system.load if start.problem is begin.problem else None  # by an accurate rule
    said = setup_warnings(begin.problem, begin.contact, begin.given, load)
    found = [one for one in said if one.kind != "penetration"]
    displacement = ends.outer.contact.displacement.values(ends.found.u)
    found += penetration_warnings(ends.outer.discretisation.space, ends.nodes, displacement)
    messages = [one.message for one in found]
    if (ratio := contraction(ends.exact.system, ends.exact.equilibrium)) >= 1:
        messages.append(
            f"Coulomb friction is strong: a change of its bounds grows {ratio:.2g} times in a fixed-point "
            "step, and it is not known whether this solution is the only one"
        )
    return tuple(messages)


def _quantities(ends: _Ends) -> ContactQuantities | None:
    before, after = (
        quantities(outer.discretisation.space, nodes, outer.contact.system(nodes), state)
        for outer, nodes, state in (
            (ends.begin, np.asarray(ends.begin.problem.mesh.p), ends.begin.given),
            (ends.outer, ends.nodes, ends.found),
        )
    )
    return None if before is None or after is None else ContactQuantities(before, after)


def _nodal_stress(ends: _Ends, force: Array) -> Array:
    """(nodes,) contact forces over the weights omega_i of their nodes, in N/m^2; zero off the contact set.

    At order 2 these are the values at the nodes' points of a pressure that is quadratic on each edge. Its
    coefficients by ``M p = lambda``, M the mass matrix of the nodes that press, oscillate: forces at vertices
    and at edges err by turns, which the solution multiplies. Errors in the mean square of division and
    solution: Example 6.1 with n = 16 3.7 % and 11 %, Hertz with 16 edges over the half-width 1.2 % and 1.8 %.
    """
    model, space = ends.outer.contact, ends.outer.discretisation.space
    stress = np.zeros(space.n_nodes)
    if force.size:
        # a node may meet two foundations
        np.add.at(stress, model.contact_nodes, force / space.weights(ends.nodes))
    return stress
