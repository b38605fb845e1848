"""A mesh with its equilibrium, as it is measured: the mesh as given, and that where a formulation ended."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from skfem import MeshTri

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.contact_results import ContactResult, contact_results, unlimited_peaks
from rmesh_nlp.assessment.coulomb import coulomb_residual
from rmesh_nlp.assessment.measures import (
    ContactResiduals,
    corrections,
    residuals,
)
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.setup_warnings import SetupWarning, penetration_warnings, setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.contact.uniqueness import contraction
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_pressure import contact_stresses
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.mapping.validity import least_area_ratio
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.kkt_model import ContactPoint, kkt_unknowns
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.models.residual import size_of
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.design import names_in
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Constrained

ACCURATE = 20
"""Degree of the rule by which other objectives than the energy are assessed, and of a safe discretisation."""

NAN = float("nan")


def accurate(problem: ContactProblem) -> ContactProblem:
    """The same problem with a rule for loads that is exact, or of degree ``ACCURATE``; itself if it has one.

    Beside curves none is exact.
    """
    exact, rule = None if problem.motion.curves else problem.exact_rule, problem.rule
    has_one = rule == exact or (isinstance(rule, int) and rule >= ACCURATE)
    return problem if has_one else problem.with_rule(exact or ACCURATE)


@dataclass(frozen=True, kw_only=True)
class State:
    """A mesh with its equilibrium, as it was measured. Where elements are inverted, all else is NaN.

    Attributes
    ----------
    problem : ContactProblem
        Design variables are numbers.
    design : mapping of str to float
        These numbers, by the names of the variables.
    mesh : skfem.MeshTri
        Of the problem, its nodes where they are.
    before : (2, nodes) array
        Positions before any motion.
    min_area_ratio : float
        Least signed area of an element over that before any motion; not positive if one is inverted.
    equilibrium : Equilibrium
        The contact solution by the problem's own rules.
    displacement : (components, nodes) array
        Its values in units of length, at the vertices and of order 2 at the middles of edges.
    pressure : (nodes,) array
        Likewise: contact pressure in N/m^2, >= 0, zero off the contact boundary, recovered from nodal forces
        (:mod:`rmesh_nlp.fem.contact_pressure`).
    tangential_stress : (nodes,) array
        Friction on the body in N/m^2, along the tangent; zero without friction.
    residuals : ContactResiduals
        Of that solution.
    penetration : float
        Deepest one between contact nodes, in units of length.
    coulomb_residual : float, optional
        Violation of Coulomb's law along edges, see :mod:`rmesh_nlp.assessment.coulomb`.
    sticking_nodes, sliding_nodes : int, optional
        With friction.
    tools : mapping of int to list of float
        Displacements of foundations that a force moves, by the numbers of the obstacles.
    contact : mapping
        Forces, peak pressure and length of the contact, by contact boundary; empty where it is not solved.
    continuous : Admissible, optional
        The displacement that is admissible for the continuous problem, and its energy; None without audit.
    corrections : mapping of str to float
        What the continuous energy differs by from the own one, by the names in ``EXPLOITS``.
    point : ReducedPoint, optional
        The outer objective by the problem's own rules, and its gradient.
    objective_audited : float
        What is minimised, by the rule of the assessment.
    size : float
        In units of which rounding of it is.
    violation : float
        Of the constraints of the outer problem, 0 up to its tolerance.
    constraints : mapping of str to Constrained
        Quantities that the problem constrains, by their texts.
    warnings : tuple of str
        Foundations that pass into the body, and a contact solution that may be one of several.
    doubts : tuple of SetupWarning
        Signs of a wrong set-up.
    """

    problem: ContactProblem
    design: Mapping[str, float]
    mesh: MeshTri
    before: Array
    min_area_ratio: float
    equilibrium: Equilibrium
    displacement: Array
    pressure: Array
    tangential_stress: Array
    residuals: ContactResiduals = ContactResiduals(NAN, NAN)  # noqa: RUF009 frozen
    penetration: float = NAN
    coulomb_residual: float | None = None
    sticking_nodes: int | None = None
    sliding_nodes: int | None = None
    tools: Mapping[int, list[float]] = field(default_factory=dict)
    contact: Mapping[str, ContactResult] = field(default_factory=dict)
    continuous: Admissible | None = field(default=None, repr=False)
    corrections: Mapping[str, float] = field(default_factory=dict)
    point: ReducedPoint | None = field(default=None, repr=False)
    objective_audited: float = NAN
    size: float = NAN
    violation: float = NAN
    constraints: Mapping[str, Constrained] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    doubts: tuple[SetupWarning, ...] = ()

    @property
    def placed(self) -> ContactProblem:
        """The problem with its tools where they ended."""
        return self.problem.placed(self.tools)

    @property
    def energy(self) -> float:
        """J of the contact solution by the problem's own rules."""
        return self.equilibrium.energy

    @property
    def energy_audited(self) -> float:
        """J of the continuous problem, of the displacement that is admissible for it."""
        return NAN if self.continuous is None else self.continuous.energy

    @property
    def objective(self) -> float:
        """What is minimised, by the problem's own rules."""
        return NAN if self.point is None else self.point.value

    @property
    def contact_status(self) -> Status:
        """CONVERGED if the contact solves have, by the problem's own rules and by the assessment's."""
        own = self.equilibrium.status
        return self.continuous.status if own is Status.CONVERGED and self.continuous is not None else own


def measured(outer: Outer, q: Array, *, audit: bool = True) -> State:
    """Measure the mesh at outer variables ``q`` and its equilibrium, with an audit the continuous energy."""
    is_given = not np.any(q)
    before = np.array(outer.problem.mesh.p)
    nodes = outer.nodes(q)
    ratio = least_area_ratio(outer.problem, nodes)
    if not ratio > 0:
        return _unsolvable(outer, q, before, ratio)
    at, position = outer.at_design(q)
    if is_given:  # with shapes it is where these begin
        nodes = at.problem.mesh.p
    exact = at.energy.start if is_given else at.energy(position)
    point = outer.at_start if is_given else outer.function(q)
    solved, system, space = exact.equilibrium, exact.system, at.discretisation.space
    continuous, is_solved = at.continuous(position) if audit else None, solved.status is Status.CONVERGED
    displacement = at.contact.displacement.values(solved.u)
    pressure, tangential = contact_stresses(space, nodes, solved.normal_force, solved.tangential_force)
    rows = at.discretisation.friction_rows
    sliding = int(np.count_nonzero(solved.active.sliding[rows])) if rows.size else None
    audited = point.value if continuous is None else _audited(at, position, solved, continuous)
    passing = penetrations(space, nodes, displacement)
    # the load by an accurate rule, where it is on the same mesh
    load = None
    if continuous is not None and continuous.problem is at.problem:
        load = continuous.system.load
    natural = 0.0 if at.objective.collapses else at.objective.size  # an energy has that of its strain
    return State(
        problem=at.problem,
        design=outer.figures(q),
        mesh=relocated_mesh(at.problem.mesh, nodes),
        before=before,
        min_area_ratio=ratio,
        equilibrium=solved,
        displacement=space.values(displacement),
        pressure=pressure,
        tangential_stress=tangential,
        residuals=residuals(system, solved),
        penetration=max((part.depth for part in passing), default=0.0),
        coulomb_residual=coulomb_residual(
            space, nodes, displacement, solved.normal_force, solved.tangential_force
        ),
        sticking_nodes=None if sliding is None else rows.size - sliding,
        sliding_nodes=sliding,
        tools=space.tools(displacement),
        contact=contact_results(space, nodes, system, solved) if is_solved else {},
        continuous=continuous,
        corrections={} if continuous is None else corrections(at.contact, nodes, solved, continuous),
        point=point,
        objective_audited=audited,
        size=max(abs(audited), size_of(point), natural),
        violation=outer.merit(point)[0],
        constraints=_constrained(outer, point),
        warnings=(
            *(warning.message for warning in penetration_warnings(passing)),
            *_ambiguous(exact),
            *unlimited_peaks(space, nodes, solved).values(),
        ),
        doubts=setup_warnings(at.contact, load, nodes, solved),
    )


def _ambiguous(point: ContactPoint) -> Iterator[str]:
    if (ratio := contraction(point.system, point.equilibrium)) >= 1:
        yield (
            f"Coulomb friction is strong: a change of its bounds grows {ratio:.2g} times in a fixed-point "
            "step, and it is not known whether this solution is the only one"
        )


def _unsolvable(outer: Outer, q: Array, before: Array, ratio: float) -> State:
    """A mesh with inverted elements, on which the contact problem has no meaning."""
    parts, problem = outer.discretisation, outer.problem.at_design()
    unknown, forces = np.full((problem.components, parts.space.n_nodes), NAN), np.full(parts.n_contact, NAN)
    active = ActiveSet(np.zeros(parts.n_contact, dtype=bool), np.zeros(parts.n_contact, dtype=np.int8))
    u, status = np.full(parts.n_u, NAN), Status.INVALID_MESH
    return State(
        problem=problem,
        design=outer.figures(q),
        mesh=relocated_mesh(problem.mesh, outer.nodes(q)),
        before=before,
        min_area_ratio=ratio,
        equilibrium=Equilibrium(u, NAN, forces, forces, active, status, 0),
        displacement=unknown,
        pressure=unknown[0],
        tangential_stress=unknown[0],
    )


def objective_value(solver: ContactSolver, objective: Objective, q: Array, state: Equilibrium) -> float:
    """An objective at outer variables (n,) and a contact solution, by the assessment's rule."""
    parts, accurate = solver.discretisation, DisplacementSpace(solver.problem.with_rule(ACCURATE))
    fields = parts.fields()
    fields = fields._replace(space=accurate, positions=fields.positions.at_rest(q))
    x = kkt_unknowns(ContactPoint(q, solver.system_at(q), state), parts.friction_rows)
    return objective.on(fields).evaluate()(x)


def _audited(outer: Outer, q: Array, solved: Equilibrium, continuous: Admissible) -> float:
    """What is minimised, at the displacement that is admissible for the continuous problem.

    Another objective than the energy is of the contact solution where that needs a refined mesh.
    """
    if outer.objective.collapses:
        return continuous.energy + outer.energy.of_positions(q)
    state = continuous.state if continuous.problem is outer.problem else solved
    return objective_value(outer.contact, outer.objective, q, state)


def _constrained(outer: Outer, point: ReducedPoint) -> dict[str, Constrained]:
    """What the problem constrains, without levels; what is bounded twice is there once."""
    if outer.constraints is None:
        return {}
    constrained, names = dict[str, Constrained](), outer.figures(point.q).keys()
    of_levels = [not set(names_in(constraint.bounds[1])) <= names for constraint in outer.problem.constraints]
    for skipped, (text, value, lower, upper) in zip(of_levels, outer.constraints.values(point), strict=True):
        if not skipped:
            bounds = constrained.get(text, Constrained(value, lower, upper))
            constrained[text] = Constrained(value, max(lower, bounds.lower), min(upper, bounds.upper))
    return constrained
