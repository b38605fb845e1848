"""The reduced model: an outer objective as a function of the outer variables q alone, with its gradient.

Each value is an exact contact solve, u(X(q)) = argmin J(u; X(q)).

- :class:`ReducedEnergy` is L(q) = min_u J(u; X(q)), what ``nested`` minimises.
- :class:`ReducedObjective` is any other F(X, u(X), forces(X)), with its gradient by the adjoint.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.assessment.assessor import Assessor
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.sensitivity import adjoint, weakly_active
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, Block, Evaluator
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.contact_terms import coefficient_terms
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_nlp import Blocks, ElementConstraints, Relocation, SecondDerivatives, relocation
from rmesh_nlp.models.kkt_model import kkt_unknowns


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
        """Contact nodes without strict complementarity: gradients other than the energy's are one of many."""
        return weakly_active(self.system, self.equilibrium)


class ReducedEnergy:
    """Evaluates L(q) by one contact solve, warm-started from the last active set.

    If the objective has terms in the positions alone, such as a distortion, they are part of value and
    gradient. The gradient of the energy is (5.7), (5.11): the partial derivative of the
    Lagrangian of the inner problem with respect to the positions, at fixed displacement and multipliers.
    It includes the motion of the gap, of the friction weights, and of a curved foundation's tangent.

    Attributes
    ----------
    model : ContactSolver
        Of the discretisation of ``relocation``.
    contact_solves, cold_solves : int
        Numbers of contact solves so far, and of those that had no active set to start from.
    factorisations : int
        Of the stiffness, one per active set that these solves tried.
    """

    def __init__(self, relocation: Relocation, model: ContactSolver) -> None:
        self.relocation, self.model = relocation, model
        self.contact_solves = self.cold_solves = self.factorisations = 0
        self._active: ActiveSet | None = None
        self._is_given_counted = False
        self._last: ReducedPoint | None = None
        self._gradient = relocation.lagrangian.gradient
        self._jacobian = relocation.contact_rows.jacobian
        numbers, rows = self._jacobian.pattern, relocation.n_contact + 2 * relocation.n_s
        self._rows = Block(numbers, slice(0, rows), slice(0, relocation.n_q))
        self._position_terms = element_values(relocation.position_groups)

    @classmethod
    def of(cls, model: ContactSolver, objective: Objective = ENERGY) -> ReducedEnergy:
        """The energy, and terms in the positions alone, of the problem that a contact solver solves."""
        return cls(relocation(model.discretisation, objective), model)

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
        """Whether the terms in the positions are; with a barrier no element is inverted or cut by its arc."""
        return _has_upright(self.objective, self.relocation, q) and bool(np.isfinite(self.of_positions(q)))

    @property
    def given(self) -> Equilibrium:
        """The contact solution on the mesh as given: a cold solve once it is first asked for."""
        return self.model.given

    @cached_property
    def assessor(self) -> Assessor:
        """Measures meshes against the continuous problem."""
        return Assessor(self.model, self.given)

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``; the last point is remembered."""
        if self._last is not None and np.array_equal(self._last.q, q):
            return self._last
        system = self.model.system(self.relocation.nodes(q), self.relocation.mesh_map.design(q))
        given = None if np.any(q) else self.given
        equilibrium = solve(system, self._active) if given is None else given
        if given is None or not self._is_given_counted:
            self.contact_solves += 1
            self.cold_solves += given is not None or self._active is None
            self.factorisations += equilibrium.iterations
            self._is_given_counted = self._is_given_counted or given is not None
        self._active = equilibrium.active
        self._last = self.at(q, system, equilibrium)
        return self._last

    def at(self, q: Array, system: ContactSystem, equilibrium: Equilibrium) -> ReducedPoint:
        """Value and gradient where the contact solution is known."""
        friction = equilibrium.tangential_force[self.relocation.friction_rows]
        gradient = self.gradient(self.point(q, equilibrium), equilibrium.normal_force, friction)
        value = equilibrium.energy + self.of_positions(q)
        return ReducedPoint(np.array(q), value, gradient, system, equilibrium, True)

    def gradient(self, x: Array, normal_force: Array, friction: Array) -> Array:
        """Derivative by q of the inner Lagrangian at unknowns ``x = (q, u, s)`` and contact forces.

        ``friction`` (n_s,) has the tangential forces where friction may act.
        """
        rel = self.relocation
        forces = np.zeros(rel.n_contact + 2 * rel.n_s)
        forces[rel.gap_rows], forces[rel.slip_rows] = normal_force, friction
        (_, gradient), (_, rows) = self._gradient(x), self._jacobian(x)
        return np.asarray(gradient[: rel.n_q] - self._rows(rows).T @ forces)

    def point(self, q: Array, equilibrium: Equilibrium) -> Array:
        """The unknowns ``(q, u, s)`` of the energy NLP at a contact solution."""
        return self.unknowns(q, equilibrium.u)

    def unknowns(self, q: Array, u: Array) -> Array:
        """The unknowns ``(q, u, s)`` of the energy NLP at q and displacements (n_u,)."""
        rows = self.relocation.friction_rows
        slip = self._slips(q, u)[rows] if rows.size else np.zeros(0)
        return np.concatenate([q, u, np.abs(slip)])

    def _slips(self, q: Array, u: Array) -> Array:
        return self.model.slips(self.relocation.nodes(q), u, self.relocation.mesh_map.design(q))


def _has_upright(objective: Objective, relocation: Relocation, q: Array) -> bool:
    """Whether no element is inverted where a distortion in the objective needs that."""
    return not objective.has_barrier or is_upright(relocation.problem, relocation.nodes(q))


class ReducedObjective:
    """Any outer objective F(X, u(X), forces(X)) with its gradient by the adjoint.

    With the active set held, ``dF/dq = F_q - R_q^T p - gamma_q^T r - sigma_q^T t``, where K p = F_u on
    the displacements that are free, R is the out-of-balance force, r and t are the adjoint reactions at
    touching and at sticking nodes (:func:`rmesh_nlp.contact.sensitivity.adjoint`), gamma the gaps and sigma
    the slips at fixed displacement. Where F depends on the contact forces, p is minus its derivative by them
    in the directions of those that hold a displacement. At sliding nodes the friction is at its bound
    ``b = g omega + F lambda``, which moves with q and lambda. That is the gradient wherever strict
    complementarity holds.
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        self.energy, self.objective = energy, objective
        rel = energy.relocation
        parts = rel.discretisation
        self.functional = functional = parts.objective(objective, parts.fields())
        self._n = n = np.cumsum([rel.n_q, rel.n_u, rel.n_contact, rel.n_s, rel.n_s, rel.n_s])
        self.n_x = int(n[-1])
        x = ca.MX.sym("x", self.n_x)
        outer = parts.assemble([*functional.groups, *functional.rows], x, ca.MX(0, 1), len(functional.sums))
        self._outer = outer.gradient
        if functional.sums:
            self._sums, self._combine = outer.jacobian, Evaluator(functional.function)
            self._of_sums = Block(self._sums.pattern, slice(None), slice(None))
        self._derivatives = SecondDerivatives(rel)
        self._last: tuple[Equilibrium, Blocks] | None = (
            None  # several functions are differentiated at a point
        )
        terms = [term.on(rel.mesh_map.positions) for term in coefficient_terms(parts.space)]
        self._coefficients = None
        if terms:
            rows = parts.assemble(terms, rel.x, ca.MX(0, 1), rel.n_s).jacobian
            self._coefficients = rows, Block(rows.pattern, slice(0, rel.n_s), slice(0, rel.n_q))

    def is_defined(self, q: Array) -> bool:
        """Whether a distortion in the objective is defined: no element is inverted."""
        return _has_upright(self.objective, self.energy.relocation, q)

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at ``q``."""
        return self.of(self.energy(q))

    def of(self, inner: ReducedPoint) -> ReducedPoint:
        """The objective where the energy and its contact solution are known."""
        x = kkt_unknowns(inner.q, inner.equilibrium, inner.system, self.energy.relocation.friction_rows)
        (value,), slope = self._outer(x, None)
        if self.functional.sums:
            sums, nonzeros = self._sums(x, None)
            (added,), weights = self._combine(sums)
            value, slope = value + added, slope + self._of_sums(nonzeros).T @ weights
        return replace(inner, value=float(value), gradient=self.total(inner, slope), is_energy=False)

    def total(self, inner: ReducedPoint, slope: Array) -> Array:
        """The derivative by q along contact solutions of a function with derivatives ``slope`` by x."""
        rel, system, state = self.energy.relocation, inner.system, inner.equilibrium
        f_q, f_u, by_normal, f_s, minus, plus = np.split(slope, self._n[:-1])
        rows, touch, by_tangential = rel.friction_rows, by_normal.copy(), np.zeros(rel.n_contact)
        if rel.n_s:
            tangents, sliding = system.tangents[rows], state.active.sliding[rows]
            by_slip = np.sign(tangents @ state.u) * f_s
            f_u = f_u + tangents.T @ by_slip
            by_force = (plus - minus) / 2
            by_tangential[rows] = by_force
            by_bound = (plus + minus) / 2 - sliding * by_force
            if system.coulomb is not None:
                touch[rows] += system.coulomb[rows] * by_bound
        p, reaction, friction = adjoint(system, state.active, f_u, touch, by_tangential)
        if self._last is None or self._last[0] is not state:
            self._last = state, self._derivatives(self.energy.point(inner.q, state), state)
        blocks = self._last[1]
        total = f_q - blocks.qu @ p - blocks.gap.T @ reaction
        if rel.n_s:
            by_bound = by_bound - sliding * (tangents @ p)
            total += blocks.qs @ by_bound + blocks.slip.T @ (by_slip - friction[rows])
            if self._coefficients is not None:
                numeric, block = self._coefficients
                values = numeric(self.energy.point(inner.q, state), None)[1]
                total += block(values).T @ (by_bound * state.normal_force[rows])
        return np.asarray(total)


Reduced = ReducedEnergy | ReducedObjective
"""An outer objective as a function of q alone."""
