"""The reduced model: an outer objective as a function of the outer variables q alone, with its gradient.

Each value is an exact contact solve, u(X(q)) = argmin J(u; X(q)).

- :class:`ReducedEnergy` is L(q) = min_u J(u; X(q)), what ``nested`` minimises.
- :class:`ReducedObjective` is any other F(X, u(X), forces(X)), with its gradient by the adjoint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet
from rmesh_nlp.evaluation import Array, Block
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.kkt_model import ContactPoint, in_units_of
from rmesh_nlp.models.kkt_point import KKTConditions
from rmesh_nlp.models.second_derivatives import Curvature, Hessian, Lifted


@dataclass(frozen=True)
class ReducedPoint(ContactPoint):
    """An outer objective and its gradient with respect to q at a contact solution."""

    value: float
    gradient: Array
    is_energy: bool


class ReducedEnergy:
    """Evaluates L(q) by one contact solve, warm-started from the last active set.

    If the objective has terms in the positions alone, such as a distortion, they are part of value and
    gradient. The gradient of the energy is (5.7), (5.11): the partial derivative of the
    Lagrangian of the inner problem with respect to the positions, at fixed displacement and multipliers.
    It includes the motion of the gap, of the friction weights, and of a curved foundation's tangent.

    Attributes
    ----------
    model : ContactSolver
        Of the problem.
    relocation : Relocation
        The energy NLP of its discretisation.
    contact_solves, cold_solves : int
        Numbers of contact solves so far, and of those that had no active set to start from.
    factorisations : int
        Of the stiffness, one per active set that these solves tried.
    """

    def __init__(self, model: ContactSolver, objective: Objective = ENERGY) -> None:
        self.model, self.relocation = model, relocation(model.discretisation, objective)
        self.contact_solves = self.cold_solves = self.factorisations = 0
        self._active: ActiveSet | None = None
        self._is_given_counted = False
        self._last: ContactPoint | None = None
        rel = self.relocation
        self._rows = Block(rel.assembled.first.pattern, columns=slice(0, rel.parts.n_q))
        self._position_terms = objective.in_positions.on(model.discretisation.fields()).evaluate()

    @property
    def energy(self) -> ReducedEnergy:
        """Itself, as the energy of any reduced objective."""
        return self

    @property
    def objective(self) -> Objective:
        """The energy, and terms in the positions alone if there are any."""
        return self.relocation.objective

    def of_positions(self, q: Array) -> float:
        """The terms of the objective in the positions alone; NaN where they are not defined."""
        return self._position_terms(q)

    @property
    def start(self) -> ContactPoint:
        """The contact solution on the mesh as given; it counts as no contact solve of a formulation."""
        return ContactPoint(np.zeros(self.relocation.parts.n_q), self.model.given_system, self.model.given)

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``; the last point is remembered."""
        point = self.solved(q)
        if not isinstance(point, ReducedPoint):
            self._last = point = self.of(point)
        return point

    def solved(self, q: Array) -> ContactPoint:
        """The contact solution at ``q`` alone; the last one is remembered."""
        if self._last is not None and np.array_equal(self._last.q, q):
            return self._last
        system, given = self.model.system_at(q), None if np.any(q) else self.model.given
        equilibrium = solve(system, self._active) if given is None else given
        if given is None or not self._is_given_counted:
            self.contact_solves += 1
            self.cold_solves += given is not None or self._active is None
            self.factorisations += equilibrium.iterations
            self._is_given_counted |= given is not None
        self._active = equilibrium.active
        self._last = ContactPoint(np.array(q), system, equilibrium)
        return self._last

    def of(self, inner: ContactPoint) -> ReducedPoint:
        """Value and gradient where the contact solution is known."""
        q, equilibrium = inner.q, inner.equilibrium
        friction = equilibrium.tangential_force[self.relocation.parts.friction_rows]
        # by strains: u K u of a body that moves by far more than it deforms is mostly rounding
        x = self.unknowns(q, equilibrium.u)
        value, gradient = self.lagrangian(x, equilibrium.normal_force, friction)
        return ReducedPoint(q, inner.system, equilibrium, value, gradient, True)

    @cached_property
    def _curvature(self) -> Curvature:
        return Curvature(self.relocation)

    def hessian(self, point: ContactPoint) -> Lifted:
        """L'' at a contact solution."""
        return self._curvature.at(self.unknowns(point.q, point.equilibrium.u), point)

    def lagrangian(self, x: Array, normal_force: Array, friction: Array) -> tuple[float, Array]:
        """The energy, and the derivative by q of the inner Lagrangian, at ``x = (q, u, s)`` and forces.

        ``friction`` (n_s,) has the tangential forces where friction may act.
        """
        value, gradient, _, rows = self.relocation.assembled.first(x, None)
        forces = self.relocation.multipliers(normal_force, friction)
        return float(value[0]), gradient[: self.relocation.parts.n_q] - self._rows(rows).T @ forces

    def unknowns(self, q: Array, u: Array) -> Array:
        """The unknowns ``(q, u, s)`` of the energy NLP at q and displacements (n_u,)."""
        rel = self.relocation
        slip = self.model.slips(rel.nodes(q), u, rel.parts.mesh_map.design(q))
        return rel.joined(q, u, np.abs(slip[rel.parts.friction_rows]))


class ReducedObjective:
    """Any outer objective F(X, u(X), forces(X)) with its gradient along contact solutions.

    The active set is held: that is the gradient wherever strict complementarity holds
    (:mod:`rmesh_nlp.models.kkt_point`).
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        self.energy, self.objective = energy, objective

    @cached_property
    def conditions(self) -> KKTConditions:
        """The KKT conditions, in units of the contact solution on the mesh as given."""
        parts = self.energy.relocation.parts
        return KKTConditions(in_units_of(parts, self.objective, self.energy.start))

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``."""
        return self.of(self.energy.solved(q))

    def of(self, inner: ContactPoint) -> ReducedPoint:
        """The objective where the contact solution is known."""
        at, unit = self.conditions.at(inner), self.conditions.program.value
        gradient, _ = at.totals(unit * at.slope)
        return ReducedPoint(inner.q, inner.system, inner.equilibrium, unit * at.value, gradient, False)

    def hessian(self, point: ContactPoint, factor: float = 1.0, constraints: Array | None = None) -> Hessian:
        """The second derivative of ``factor F + constraints . c`` at a contact solution."""
        at = self.conditions.at(point)
        return at.hessian(factor * self.conditions.program.value, constraints)


Reduced = ReducedEnergy | ReducedObjective
"""An outer objective as a function of q alone."""
