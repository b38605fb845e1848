"""The inner problem: contact on a fixed mesh, solved exactly by a primal-dual active set.

At fixed node positions the inner problem is a strictly convex quadratic program,

    min 1/2 u^T K u - F^T u + sum_i b_i |t_i . u_i|   with   gap = N u + gamma >= 0,

(5.1), (5.8), with Tresca bounds b_i = g omega_i >= 0. The active set (which nodes touch,
which stick) is found by a semismooth Newton method [1]_; when that does not make progress,
single least-index changes [2]_ guarantee that no set is visited for ever.

References
----------
.. [1] M. Hintermüller, K. Ito, K. Kunisch, The primal-dual active set strategy as a
   semismooth Newton method, SIAM J. Optim. 13 (2003) 865-888.
.. [2] J. J. Júdice, F. M. Pires, A block principal pivoting algorithm for large-scale
   strictly monotone linear complementarity problems, Comput. Oper. Res. 21 (1994) 587-596.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.directions import Directions
from rmesh_nlp.contact.first_guess import first_set
from rmesh_nlp.contact.floating import check_load, check_unique, holding
from rmesh_nlp.contact.ordering import LARGE, elimination_order
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, numbered
from rmesh_nlp.fem.fields import unknown_field
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.rigid import rigid_motions

MAX_ITERATIONS = 100
"""Factorisations that one contact solve may take."""

PATIENCE = 3
"""Block changes of the active set without fewer violations before single changes begin."""


class ContactModel:
    """Builds the contact system of a problem for any node positions.

    Parameters
    ----------
    problem : ContactProblem or Discretisation

    Raises
    ------
    ProblemError
        If only contact holds the body and the load does not press it on, or not in one place.

    Attributes
    ----------
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    contact_nodes : int array
        The node of every gap.
    frictional : bool array
        Whether friction may act there.
    normals, tangents : sparse arrays
        Those of the contact system on the initial mesh; where no foundation is curved, on every mesh.
    """

    def __init__(self, problem: ContactProblem | Discretisation) -> None:
        self.discretisation = parts = discretise(problem)
        self.problem = problem = parts.problem
        self.displacement, self.n_u = parts.displacement, parts.n_u
        self.contact_nodes = parts.contact_nodes
        n_nodes = problem.mesh.p.shape[1]
        self._given = given = _Given(problem)
        positions, X = given.positions, given.symbol
        u = ca.MX.sym("u", self.n_u)
        terms = (*parts.strain, *parts.gaps)
        inner = parts.assemble(
            [term.on(positions, self.displacement) for term in terms], u, X, self.contact_nodes.size
        )
        zero = ca.MX.zeros(self.n_u)
        value, gradient = inner.grad_f(zero, X)
        gap = ca.densify(
            ca.Function("gap", [u, X], [inner.g])(zero, X)
        )  # a constant gap may be a sparse zero
        no_rows = ca.MX.zeros(self.contact_nodes.size)
        hessian = inner.hess_lag(zero, X, 1.0, no_rows)
        self._kept = [inner]
        self._evaluate = Evaluator(
            ca.Function("contact_system", [X], [hessian, ca.densify(-gradient), ca.densify(value), gap])
        )
        self._loads = _Loads(parts)
        self._stiffness = Symmetric(numbered(hessian.sparsity()))
        self._curved = any(part.level is not None for part in problem.obstacles)
        self._directions = Directions(problem, self.displacement, self.n_u)
        self.normals, self.tangents = self._directions.rows(problem.mesh.p)
        self.frictional = np.zeros(self.contact_nodes.size, dtype=bool)
        self.frictional[parts.friction_rows] = True
        self._friction = problem.frictional
        if self._friction:
            shape = (len(problem.obstacles), n_nodes)
            slip = ca.MX.sym("s", shape[0] * n_nodes)
            groups = [term.on(positions, unknown_field(shape)) for term in parts.friction]
            friction = parts.assemble(groups, slip, X, 0)
            weights = friction.grad_f(ca.MX.zeros(slip.shape[0]), X)[1]
            self._kept.append(friction)
            self._weights = Evaluator(ca.Function("weights", [X], [weights]))
            numbers = [np.full(part.nodes.size, part.number) for part in problem.contact_sets]
            self._weight_of = self.contact_nodes * shape[0] + np.concatenate(numbers)
        self._floats = rigid_motions(problem).size > 0
        self._check()

    def with_rule(self, rule: str | int) -> ContactModel:
        """The same with loads by another quadrature rule; all that does not depend on it is shared."""
        other = copy(self)
        other.discretisation = self.discretisation.with_rule(rule)
        other.problem = other.discretisation.problem
        other._loads = _Loads(other.discretisation)
        other._check()
        return other

    def _check(self) -> None:
        """Whether the load presses a body on that contact alone holds."""
        if self._floats:
            system = self.system(self.problem.mesh.p)
            check_load(system)
            check_unique(system, solve(system))

    def system(self, nodes: Array) -> ContactSystem:
        """The quadratic program at node positions (2, nodes)."""
        hessian, held, constant, offset = self._evaluate(self._given(nodes))
        work, load = self._loads(nodes)
        stiffness = self._stiffness(hessian)
        bound = self._weights(self._given(nodes))[0][self._weight_of] if self._friction else np.zeros(0)
        normals, tangents = self.normals, self.tangents
        if self._curved:
            normals, tangents = self._directions.rows(nodes)
        return ContactSystem(
            stiffness,
            held + load,
            float(constant[0]) + work,
            normals,
            tangents,
            offset,
            bound,
            self.frictional,
            self._rigid(nodes) if self._floats else None,
            self._order,
        )

    def strain_and_friction(self, nodes: Array, u: Array) -> tuple[float, float]:
        """Strain energy and friction energy of a displacement at node positions."""
        given = self._given(nodes)
        hessian, pull, constant, _ = self._evaluate(given)
        strain = 0.5 * float(u @ (self._stiffness(hessian) @ u)) - float(pull @ u) + float(constant[0])
        friction = 0.0
        if self._friction:
            bound = self._weights(given)[0][self._weight_of]
            friction = float(bound @ np.abs(self.slips(nodes, u)))
        return strain, friction

    @cached_property
    def _order(self) -> NDArray[np.int64] | None:
        """The order of elimination on a large mesh."""
        mesh = self.problem.mesh
        if mesh.p.shape[1] <= LARGE:
            return None
        return elimination_order(mesh.p, mesh.facets, self.displacement.index)

    def slips(self, nodes: Array, u: Array) -> Array:
        """Displacements (gaps,) along the tangents at node positions (2, nodes)."""
        straight = not (self._curved and self._friction)
        tangents = self.tangents if straight else self._directions.rows(nodes)[1]
        return np.asarray(tangents @ u)

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solve at node positions (2, nodes)."""
        return solve(self.system(nodes), start)

    def _rigid(self, nodes: Array) -> Array:
        """The rigid motions that only contact prevents, (n_u, motions)."""
        free = self.displacement.index >= 0
        result = np.zeros((self.n_u, 0))
        for motion in rigid_motions(self.problem, nodes):
            column = np.zeros((self.n_u, 1))
            column[self.displacement.index[free], 0] = motion[free]
            result = np.hstack([result, column])
        return result


class _Given:
    """Node positions as parameters of a function, and the parameters of nodes on curves that go with them."""

    def __init__(self, problem: ContactProblem) -> None:
        n, self._problem = problem.mesh.p.shape[1], problem
        self._curves = [
            (curve, problem.boundary_nodes((name,))) for name, curve in problem.motion.curves.items()
        ]
        positions = unknown_field((2, n), parameter=True)
        along = unknown_field((len(self._curves), n), 2 * n, parameter=True) if self._curves else None
        self.positions = replace(positions, along=along)
        self.symbol = ca.MX.sym("X", (2 + len(self._curves)) * n)

    def __call__(self, nodes: Array) -> Array:
        """The values of ``symbol`` at node positions (2, nodes)."""
        along = np.zeros((len(self._curves), nodes.shape[1]))
        for row, (curve, here) in zip(along, self._curves, strict=True):
            row[here] = curve.nearest(nodes[:, here])
        return np.concatenate([nodes.ravel(order="F"), along.ravel(order="F")])


class _Loads:
    """The loads of a discretisation at node positions, by its quadrature rule."""

    def __init__(self, parts: Discretisation) -> None:
        self._given = given = _Given(parts.problem)
        positions, X = given.positions, given.symbol
        u = ca.MX.sym("u", parts.n_u)
        self._kept = parts.assemble([term.on(positions, parts.displacement) for term in parts.loads], u, X, 0)
        value, gradient = self._kept.grad_f(ca.MX.zeros(parts.n_u), X)
        self._evaluate = Evaluator(ca.Function("loads", [X], [ca.densify(value), -ca.densify(gradient)]))

    def __call__(self, nodes: Array) -> tuple[float, Array]:
        """Minus the work of the loads on the given displacements, and the nodal forces (n_u,)."""
        value, force = self._evaluate(self._given(nodes))
        return float(value[0]), force


def solve(
    system: ContactSystem, start: ActiveSet | None = None, max_iterations: int = MAX_ITERATIONS
) -> Equilibrium:
    """Solve the contact system exactly for its active set.

    Parameters
    ----------
    system : ContactSystem
    start : ActiveSet, optional
        Warm start; by default :func:`rmesh_nlp.contact.first_guess.first_set`.
    max_iterations : int
        Limit on factorisations.

    Returns
    -------
    Equilibrium
        Gaps of touching nodes and slips of sticking nodes are exactly zero up to rounding of
        the change of coordinates. If the status is not CONVERGED the last iterate is returned.
    """
    active = start or first_set(system)
    fewest, patience = np.inf, PATIENCE
    seen: set[bytes] = set()
    for iteration in range(1, max_iterations + 1):
        state = system.equilibrium(active)
        proposal, violations = _next_set(system, state, active)
        if violations == 0:
            return replace(state, iterations=iteration)
        proposal = holding(system, active, state, proposal)
        if proposal.key() == active.key():  # nodes that pull are needed to hold the body
            return replace(state, status=Status.CYCLED, iterations=iteration)
        if violations < fewest:
            fewest, patience = violations, PATIENCE
            seen.clear()
        elif patience > 0:
            patience -= 1
        else:
            proposal = _single_change(active, proposal)
            if proposal.key() in seen:
                return replace(state, status=Status.CYCLED, iterations=iteration)
            seen.add(proposal.key())
        active = proposal
    return replace(state, status=Status.ITERATION_LIMIT, iterations=max_iterations)


def _next_set(system: ContactSystem, state: Equilibrium, active: ActiveSet) -> tuple[ActiveSet, int]:
    """The active set that the signs of gaps and forces ask for, and how many signs are wrong."""
    # rounding of the linear solve must not make a node that just touches flicker
    small_force = 1e-13 * max(system.force_scale, float(np.max(np.abs(state.normal_force), initial=0.0)))
    small_gap = 1e-13 * max(float(np.max(np.abs(state.u), initial=0.0)), 1e-300)
    gap = system.normals @ state.u + system.offset
    touching = np.where(active.touching, state.normal_force >= -small_force, gap < -small_gap)
    sliding = active.sliding
    if system.slip_bound.size:
        slip, force = system.tangents @ state.u, state.tangential_force
        onset = np.where(np.abs(force) > system.slip_bound + small_force, -np.sign(force), 0)
        stays = active.sliding * slip >= -small_gap
        sliding = np.where(active.sliding == 0, onset, np.where(stays, active.sliding, 0)).astype(np.int8)
    wrong = np.sum(touching != active.touching) + np.sum(sliding != active.sliding)
    return ActiveSet(touching, sliding), int(wrong)


def _single_change(active: ActiveSet, proposal: ActiveSet) -> ActiveSet:
    """Only the change of least index (normal directions first)."""
    touching, sliding = active.touching.copy(), active.sliding.copy()
    different = np.flatnonzero(touching != proposal.touching)
    if different.size:
        touching[different[0]] = proposal.touching[different[0]]
    else:
        first = np.flatnonzero(sliding != proposal.sliding)[0]
        sliding[first] = proposal.sliding[first]
    return ActiveSet(touching, sliding)
