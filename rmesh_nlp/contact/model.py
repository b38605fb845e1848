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

from dataclasses import replace

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.first_guess import first_set
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, numbered
from rmesh_nlp.fem.assembly import assemble
from rmesh_nlp.fem.energy import bulk_groups, displacement_field, friction_group, gap_group
from rmesh_nlp.fem.fields import unknown_field
from rmesh_nlp.optimize.nlp import Status
from rmesh_nlp.problem import ContactProblem

MAX_ITERATIONS = 100
"""Factorisations that one contact solve may take."""

PATIENCE = 3
"""Block changes of the active set without fewer violations before single changes begin."""


class ContactModel:
    """Builds the contact system of a problem for any node positions.

    Parameters
    ----------
    problem : ContactProblem

    Attributes
    ----------
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    contact_nodes : int array
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        self.displacement, self.n_u = displacement_field(problem)
        self.contact_nodes = problem.contact_nodes
        n_nodes = problem.mesh.p.shape[1]
        positions = unknown_field((2, n_nodes), parameter=True)
        u, X = ca.MX.sym("u", self.n_u), ca.MX.sym("X", 2 * n_nodes)
        groups = [
            *bulk_groups(problem, positions, self.displacement),
            gap_group(problem, positions, self.displacement),
        ]
        inner = assemble(groups, u, X, self.contact_nodes.size)
        zero = ca.MX.zeros(self.n_u)
        value, gradient = inner.grad_f(zero, X)
        gap = ca.Function("gap", [u, X], [inner.g])(zero, X)
        no_rows = ca.MX.zeros(self.contact_nodes.size)
        hessian = inner.hess_lag(zero, X, 1.0, no_rows)
        self._kernels = inner.kernels
        self._evaluate = Evaluator(ca.Function("contact_system", [X], [hessian, -gradient, value, gap]))
        self._stiffness = Symmetric(numbered(hessian.sparsity()))
        self.normals = self._unit_rows(problem.obstacle.normal)
        self._friction = problem.frictional
        scalar = problem.components == 1
        self.tangents = sp.csr_array((0, self.n_u)) if scalar else self._unit_rows(problem.obstacle.tangent)
        if self._friction:
            slip = ca.MX.sym("s", n_nodes)
            friction = assemble([friction_group(problem, positions, unknown_field((1, n_nodes)))], slip, X, 0)
            weights = friction.grad_f(ca.MX.zeros(n_nodes), X)[1]
            self._kernels += friction.kernels
            self._weights = Evaluator(ca.Function("weights", [X], [weights]))

    def system(self, nodes: Array) -> ContactSystem:
        """The quadratic program at node positions (2, nodes)."""
        hessian, load, constant, offset = self._evaluate(nodes)
        stiffness = self._stiffness(hessian)
        bound = self._weights(nodes)[0][self.contact_nodes] if self._friction else np.zeros(0)
        return ContactSystem(stiffness, load, float(constant[0]), self.normals, self.tangents, offset, bound)

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solve at node positions (2, nodes)."""
        return solve(self.system(nodes), start)

    def _unit_rows(self, vector: tuple[float, ...]) -> sp.csr_array:
        if self.contact_nodes.size == 0:
            return sp.csr_array((0, self.n_u))
        index = self.displacement.index[:, self.contact_nodes]
        keep = np.asarray(vector)[:, None] * np.ones(index.shape)
        row = np.broadcast_to(np.arange(index.shape[1]), index.shape)
        used = (keep != 0) & (index >= 0)
        return sp.csr_array((keep[used], (row[used], index[used])), shape=(index.shape[1], self.n_u))


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
