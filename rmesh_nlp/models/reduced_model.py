"""The reduced model: an outer objective as a function of the outer variables q alone, with its gradient.

Each value is an exact contact solve, u(X(q)) = argmin J(u; X(q)).

- :class:`ReducedEnergy` is L(q) = min_u J(u; X(q)), what ``nested`` minimises.
- :class:`ReducedObjective` is any other F(X, u(X)), with its gradient by the adjoint.
- :class:`ReducedCertificate` has the guaranteed bound of the error among its terms, the upper less the lower
  bound of the least energy. The upper one is the energy of the displacement by the rule of the assessment,
  the lower one the dual energy of a flux in equilibrium (:mod:`rmesh_nlp.certificate.lower_bound`). Half the
  square of the error in the energy norm is at most their difference. Both are minima or maxima over the mesh,
  and are differentiated with what attains them fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.lower_bound import DEGREE, LowerBound
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.sensitivity import adjoint, weakly_active
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_nlp import ElementConstraints, Relocation, SecondDerivatives, relocation


@dataclass(frozen=True)
class ReducedPoint:
    """An outer objective, its gradient with respect to q, and the contact solution behind it."""

    q: Array
    value: float
    gradient: Array
    system: ContactSystem
    equilibrium: Equilibrium
    is_energy: bool

    @property
    def weak(self) -> NDArray[np.bool_]:
        """Contact nodes where strict complementarity fails.

        There the gradient of an objective other than the energy is only one element of a
        generalised gradient.
        """
        return weakly_active(self.system, self.equilibrium)


class ReducedEnergy:
    """Evaluates L(q) by one contact solve, warm-started from the last active set.

    If the objective has terms in the positions alone, such as a distortion, they are part of value and
    gradient. The gradient of the energy is (5.7), (5.11): the partial derivative of the
    Lagrangian of the inner problem with respect to the positions, at fixed displacement and multipliers.
    It includes the motion of the gap, of the friction weights, and of a curved foundation's tangent.

    Attributes
    ----------
    contact_solves : int
        Number of contact solves so far.
    cold_solves : int
        Those of them that had no active set to start from.
    factorisations : int
        Of the stiffness, one per active set that these solves tried.
    """

    def __init__(self, relocation: Relocation, model: ContactSolver | None = None) -> None:
        self.relocation = relocation
        self.model = model or ContactSolver(relocation.discretisation)
        self.contact_solves = self.cold_solves = self.factorisations = 0
        self._active: ActiveSet | None = None
        self._given: Equilibrium | None = None
        self._is_given_counted = False
        self._last: ReducedPoint | None = None
        x, none, assembled = relocation.x, ca.MX(0, 1), relocation.assembled
        normal, tangential = (
            ca.MX.sym("normal", relocation.n_contact),
            ca.MX.sym("tangential", relocation.n_s),
        )
        jacobian = assembled.jac_g(x, none)[1][:, : relocation.n_q]
        gradient = assembled.grad_f(x, none)[1][: relocation.n_q, :]
        gradient -= jacobian[relocation.gap_rows, :].T @ normal
        gradient -= jacobian[relocation.slip_rows, :].T @ tangential
        self._gradient = Evaluator(
            ca.Function("reduced_gradient", [x, normal, tangential], [ca.densify(gradient)])
        )
        self._position_terms = element_values(relocation.position_groups)

    @property
    def energy(self) -> ReducedEnergy:
        """Itself, as the energy of any reduced objective."""
        return self

    @property
    def objective(self) -> Objective:
        """The energy, and terms in the positions alone if there are any."""
        return self.relocation.objective

    @cached_property
    def validity(self) -> ElementConstraints:
        """Element validity as a function of q."""
        return ElementConstraints(self.relocation)

    def of_positions(self, q: Array) -> float:
        """The terms of the objective in the positions alone; NaN where they are not defined."""
        x = np.concatenate([q, np.zeros(self.relocation.n_x - q.size)])
        return float(sum(values.sum() for values in self._position_terms(x)))

    def is_defined(self, q: Array) -> bool:
        """Whether the terms in the positions are defined.

        Where one stands in the place of area constraints no element may be inverted or cut by its arc.
        """
        rel = self.relocation
        if rel.objective.has_barrier and not is_upright(rel.problem, rel.nodes(q)):
            return False
        return bool(np.isfinite(self.of_positions(q)))

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``; the last point is remembered."""
        if self._last is not None and np.array_equal(self._last.q, q):
            return self._last
        system = self.model.system(self.relocation.nodes(q))
        if self._given is not None and not np.any(q):
            return self._at_given(q, system, self._given)
        equilibrium = solve(system, self._active)
        self.contact_solves += 1
        self.cold_solves += self._active is None
        self.factorisations += equilibrium.iterations
        self._active = equilibrium.active
        self._last = self.at(q, system, equilibrium)
        return self._last

    def knows(self, given: Equilibrium) -> None:
        """Take over the contact solution on the mesh as given.

        It counts as a cold solve when it is first asked for, and is not solved again.
        """
        self._given = given

    def _at_given(self, q: Array, system: ContactSystem, given: Equilibrium) -> ReducedPoint:
        if not self._is_given_counted:
            self._is_given_counted = True
            self.contact_solves += 1
            self.cold_solves += 1
            self.factorisations += given.iterations
        self._active = self._active or given.active
        self._last = self.at(q, system, given)
        return self._last

    def at(self, q: Array, system: ContactSystem, equilibrium: Equilibrium) -> ReducedPoint:
        """Value and gradient where the contact solution is known."""
        friction = equilibrium.tangential_force[self.relocation.friction_rows]
        gradient = self.gradient(self.point(q, equilibrium), equilibrium.normal_force, friction)
        value = equilibrium.energy + self.of_positions(q)
        return ReducedPoint(np.array(q), value, gradient, system, equilibrium, True)

    def gradient(self, x: Array, normal_force: Array, friction: Array) -> Array:
        """Derivative by q of the inner Lagrangian at unknowns ``x = (q, u, s)`` and contact forces.

        Parameters
        ----------
        x : (n_q + n_u + n_s,) array
        normal_force : (contact nodes,) array
        friction : (n_s,) array
            Tangential forces where friction may act.
        """
        return self._gradient(x, normal_force, friction)[0]

    def point(self, q: Array, equilibrium: Equilibrium) -> Array:
        """The unknowns ``(q, u, s)`` of the energy NLP at a contact solution."""
        return self.unknowns(q, equilibrium.u)

    def unknowns(self, q: Array, u: Array) -> Array:
        """The unknowns ``(q, u, s)`` of the energy NLP at q and displacements (n_u,)."""
        rows = self.relocation.friction_rows
        slip = self.model.slips(self.relocation.nodes(q), u)[rows] if rows.size else np.zeros(0)
        return np.concatenate([q, u, np.abs(slip)])


class ReducedObjective:
    """Any outer objective F(X, u(X)) with its gradient by the adjoint.

    With the active set held, ``dF/dq = F_q - R_q^T p - gamma_q^T r - sigma_q^T t``, where K p = F_u on
    the displacements that are free, R is the out-of-balance force, r and t are the adjoint reactions at
    touching and at sticking nodes (:func:`rmesh_nlp.contact.sensitivity.adjoint`), gamma the gaps and sigma
    the slips at fixed displacement. That is the gradient wherever strict complementarity holds.
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        self.energy, self.objective = energy, objective
        rel = energy.relocation
        fields = (rel.mesh_map.positions, rel.displacement, rel.slip)
        groups = rel.discretisation.objective(objective, *fields)
        outer = rel.discretisation.assemble(groups, rel.x, ca.MX(0, 1), 0)
        self._kept = outer
        self._outer = Evaluator(outer.grad_f)
        self._derivatives = SecondDerivatives(rel)

    def is_defined(self, q: Array) -> bool:
        """Whether a distortion in the objective is defined: no element is inverted."""
        rel = self.energy.relocation
        return not self.objective.has_barrier or is_upright(rel.problem, rel.nodes(q))

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``."""
        return self.of(self.energy(q))

    def of(self, inner: ReducedPoint) -> ReducedPoint:
        """The objective where the energy and its contact solution are known."""
        rel, q, system, state = self.energy.relocation, inner.q, inner.system, inner.equilibrium
        x = self.energy.point(q, state)
        value, gradient = self._outer(x, [])
        f_q, f_u, f_s = np.split(gradient, [rel.n_q, rel.n_q + rel.n_u])
        rows = rel.friction_rows
        if rel.n_s:
            tangents = system.tangents[rows]
            by_slip = np.sign(tangents @ state.u) * f_s
            f_u = f_u + tangents.T @ by_slip
        p, reaction, friction = adjoint(system, state.active, f_u)
        blocks = self._derivatives(x, state)
        total = f_q - blocks.qu @ p - blocks.gap.T @ reaction
        if rel.n_s:
            total -= blocks.qs @ (state.active.sliding[rows] * (tangents @ p))
            total += blocks.slip.T @ (by_slip - friction[rows])
        return ReducedPoint(np.array(q), float(value[0]), total, system, state, False)


CERTIFICATE = "certificate"
"""Of the term in an objective."""


class ReducedCertificate:
    """An outer objective with the bound of the error among its terms.

    Attributes
    ----------
    energy : ReducedEnergy
        Of the problem with its own rule.
    objective : Objective
    upper : ReducedEnergy
        By the rule of the assessment.
    weight : float
        Of the bound in the objective.

    Raises
    ------
    ValueError
        If the problem is not scalar, or is of a kind for which no certificate is known.
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        self.energy, self.objective = energy, objective
        problem = energy.relocation.problem
        self.upper = ReducedEnergy(relocation(replace(problem, quadrature=DEGREE)))
        self._lower = LowerBound(problem, self.upper.relocation.discretisation.space)
        self.weight = sum(weight for weight, term in objective.terms if term.name == CERTIFICATE)
        others = tuple((weight, term) for weight, term in objective.terms if term.name != CERTIFICATE)
        self._others = ReducedObjective(energy, Objective(others)) if others else None

    def is_defined(self, q: Array) -> bool:
        """Whether a distortion in the objective is defined: no element is inverted."""
        return self._others is None or self._others.is_defined(q)

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``."""
        return self.of(self.energy(q))

    def of(self, inner: ReducedPoint) -> ReducedPoint:
        """The objective where the energy and its contact solution are known."""
        upper = self.upper(inner.q)
        rel = self.upper.relocation
        displacement = rel.displacement.values(self.upper.point(inner.q, upper.equilibrium))
        lower, slope = self._lower(rel.nodes(inner.q), displacement)
        positions = rel.mesh_map.positions
        moving = positions.index != CONSTANT
        of_lower = np.bincount(
            positions.index[moving], (slope * positions.slopes(inner.q))[moving], minlength=inner.q.size
        )
        value, gradient = self.weight * (upper.value - lower), self.weight * (upper.gradient - of_lower)
        if self._others is not None:
            rest = self._others.of(inner)
            value, gradient = value + rest.value, gradient + rest.gradient
        return ReducedPoint(inner.q, value, gradient, inner.system, inner.equilibrium, False)


Reduced = ReducedEnergy | ReducedObjective | ReducedCertificate
"""An outer objective as a function of q alone."""


def has_certificate(objective: Objective) -> bool:
    """Whether the bound of the error is among the terms of an objective."""
    return any(term.name == CERTIFICATE for _, term in objective.terms)


def outer_function(energy: ReducedEnergy, objective: Objective) -> ReducedObjective | ReducedCertificate:
    """Any outer objective but the energy by itself."""
    kind = ReducedCertificate if has_certificate(objective) else ReducedObjective
    return kind(energy, objective)
