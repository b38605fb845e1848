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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.assembly import assemble, unknown_field
from rmesh_nlp.energy import (
    bulk_groups,
    displacement_field,
    friction_group,
    gap_group,
)
from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.nlp import Status
from rmesh_nlp.problem import ContactProblem

MAX_ITERATIONS = 100
"""Factorisations that one contact solve may take."""

PATIENCE = 3
"""Block changes of the active set without fewer violations before single changes begin."""


@dataclass(frozen=True)
class ContactSystem:
    """The quadratic program of the inner problem at fixed node positions.

    Attributes
    ----------
    stiffness : (m, m) sparse array
        K, over the displacement unknowns.
    load : (m,) array
        F.
    constant : float
        Energy at zero displacement.
    normals, tangents : (contact nodes, m) sparse arrays
        Rows with unit vectors; a scalar problem has no tangents.
    offset : (contact nodes,) array
        gamma, the gap at zero displacement.
    slip_bound : (contact nodes,) array
        b = g omega, the largest tangential force; empty without friction.
    """

    stiffness: sp.csc_array
    load: Array
    constant: float
    normals: sp.csr_array
    tangents: sp.csr_array
    offset: Array
    slip_bound: Array

    def energy(self, u: Array) -> float:
        """J(u), friction included."""
        friction = self.slip_bound @ np.abs(self.tangents @ u) if self.slip_bound.size else 0.0
        return float(0.5 * u @ (self.stiffness @ u) - self.load @ u + self.constant + friction)

    @property
    def force_scale(self) -> float:
        """Unit of nodal forces, to make residuals dimensionless."""
        return float(
            max(np.max(np.abs(self.load), initial=0.0), np.max(self.slip_bound, initial=0.0), 1e-300)
        )


@dataclass(frozen=True)
class ActiveSet:
    """Which contact nodes touch, and how they slide: -1, +1, or 0 for stick."""

    touching: NDArray[np.bool_]
    sliding: NDArray[np.int8]

    def key(self) -> bytes:
        """A hashable name."""
        return self.touching.tobytes() + self.sliding.tobytes()


@dataclass(frozen=True)
class Equilibrium:
    """Solution of a contact problem on a fixed mesh.

    Attributes
    ----------
    u : (m,) array
        Displacement unknowns.
    energy : float
    normal_force : (contact nodes,) array
        Multipliers of the gaps, nodal forces >= 0 pushing the body off the foundation.
    tangential_force : (contact nodes,) array
        Friction on the body, -b <= force <= b, opposite to the slip.
    active : ActiveSet
    status : Status
        CONVERGED, CYCLED or ITERATION_LIMIT.
    iterations : int
        Factorisations, one for each active set that was tried.
    """

    u: Array
    energy: float
    normal_force: Array
    tangential_force: Array
    active: ActiveSet
    status: Status
    iterations: int


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
        self._evaluate = Evaluator(ca.Function("contact_system", [X], [hessian, -gradient, value, gap]))
        self._upper = pattern(hessian.sparsity())
        self.normals = self._unit_rows(problem.obstacle.normal)
        self._friction = problem.frictional
        scalar = problem.components == 1
        self.tangents = sp.csr_array((0, self.n_u)) if scalar else self._unit_rows(problem.obstacle.tangent)
        if self._friction:
            slip = ca.MX.sym("s", n_nodes)
            friction = assemble([friction_group(problem, positions, unknown_field((1, n_nodes)))], slip, X, 0)
            weights = friction.grad_f(ca.MX.zeros(n_nodes), X)[1]
            self._weights = Evaluator(ca.Function("weights", [X], [weights]))

    def system(self, nodes: Array) -> ContactSystem:
        """The quadratic program at node positions (2, nodes)."""
        hessian, load, constant, offset = self._evaluate(nodes)
        upper = self._upper.copy()
        upper.data = hessian
        stiffness = sp.csc_array(upper + sp.triu(upper, 1).T)
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
        Warm start; by default nodes with an initial gap of zero or less touch, and all stick.
    max_iterations : int
        Limit on factorisations.

    Returns
    -------
    Equilibrium
        Gaps of touching nodes and slips of sticking nodes are exactly zero up to rounding of
        the change of coordinates. If the status is not CONVERGED the last iterate is returned.
    """
    rotated = _Rotated(system)
    active = start if start is not None else _initial_set(system)
    fewest, patience = np.inf, PATIENCE
    seen: set[bytes] = set()
    for iteration in range(1, max_iterations + 1):
        state = rotated.solve(active)
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


def _initial_set(system: ContactSystem) -> ActiveSet:
    return ActiveSet(system.offset <= 0, np.zeros(system.slip_bound.size, dtype=np.int8))


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


def adjoint(system: ContactSystem, active: ActiveSet, right: Array) -> tuple[Array, Array]:
    """Adjoint of the contact solution with its active set held.

    Solves ``K p = right`` over the displacements that the active set leaves free, p = 0 in
    the normal direction of touching and in the tangential direction of sticking nodes.

    Returns
    -------
    p : (m,) array
    reaction : (contact nodes,) array
        ``right - K p`` in the normal direction of touching nodes, zero at the others.
    """
    rotated = _Rotated(system)
    turned = right if rotated.basis is None else rotated.basis.T @ right
    inside = np.flatnonzero(rotated.free(active))
    p = np.zeros(turned.size)
    p[inside] = _factor(rotated.K[:, inside][inside]).solve(turned[inside])
    reaction = np.where(active.touching, (turned - rotated.K @ p)[rotated.normal], 0.0)
    return p if rotated.basis is None else rotated.basis @ p, reaction


def tangent_response(
    system: ContactSystem, active: ActiveSet
) -> Callable[[Array, Array], tuple[Array, Array]]:
    """First-order change of displacement and normal force with the active set held.

    The returned function takes the change of the out-of-balance force ``K u - F`` at fixed
    displacement and the change of the gaps, and gives those of ``u`` and ``lambda``. The
    stiffness is factorised once.
    """
    rotated = _Rotated(system)
    inside = np.flatnonzero(rotated.free(active))
    rows = sp.csr_array(rotated.K)[inside]
    factor = _factor(rotated.K[:, inside][inside])
    touching = rotated.normal[active.touching]

    def respond(force: Array, gap: Array) -> tuple[Array, Array]:
        turned = force if rotated.basis is None else rotated.basis.T @ force
        w = np.zeros(turned.size)
        w[touching] = -gap[active.touching]
        w[inside] = factor.solve(-turned[inside] - rows @ w)
        change = np.zeros(gap.size)
        change[active.touching] = (rotated.K @ w + turned)[touching]
        return (w if rotated.basis is None else rotated.basis @ w), change

    return respond


def weakly_active(system: ContactSystem, state: Equilibrium, tolerance: float = 1e-6) -> NDArray[np.bool_]:
    """Contact nodes where strict complementarity fails, in scaled units.

    Gap and normal force both vanish, or slip vanishes while the friction is at its bound.
    There u(X) has only one-sided derivatives.
    """
    force = system.force_scale
    length = max(float(np.max(np.abs(state.u), initial=0.0)), 1e-300)
    gap = system.normals @ state.u + system.offset
    weak = np.maximum(np.abs(gap) / length, np.abs(state.normal_force) / force) < tolerance
    if system.slip_bound.size:
        slip = np.abs(system.tangents @ state.u) / length
        reserve = np.abs(system.slip_bound - np.abs(state.tangential_force)) / force
        weak |= np.maximum(slip, reserve) < tolerance
    return np.asarray(weak)


def _factor(K: sp.csc_array) -> Any:
    """Sparse factorisation of a symmetric positive definite matrix."""
    return splu(K, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


class _Rotated:
    """The system in coordinates in which every gap and slip is one unknown (plus a constant)."""

    def __init__(self, system: ContactSystem) -> None:
        self.system = system
        basis, self.normal, self.tangent = _contact_basis(system)
        self.basis = basis
        self.slips = self.tangent >= 0  # False where the tangential displacement is given
        self.K = system.stiffness if basis is None else sp.csc_array(basis.T @ system.stiffness @ basis)
        self.F = system.load if basis is None else basis.T @ system.load

    def free(self, active: ActiveSet) -> NDArray[np.bool_]:
        """Unknowns that touching and sticking nodes leave free."""
        free = np.ones(self.F.size, dtype=bool)
        free[self.normal[active.touching]] = False
        if self.system.slip_bound.size:
            free[self.tangent[self.slips & (active.sliding == 0)]] = False
        return free

    def solve(self, active: ActiveSet) -> Equilibrium:
        """Equilibrium with the given nodes touching, sticking and sliding."""
        system = self.system
        w = np.zeros(self.F.size)
        w[self.normal[active.touching]] = -system.offset[active.touching]
        F = self.F
        if system.slip_bound.size:
            F = F.copy()
            F[self.tangent[self.slips]] -= (system.slip_bound * active.sliding)[self.slips]
        inside = np.flatnonzero(self.free(active))
        K = self.K[:, inside]
        right = F[inside] - (self.K[inside] @ w)
        w[inside] = _factor(K[inside]).solve(right)
        residual = self.K @ w - self.F
        normal_force = np.where(active.touching, residual[self.normal], 0.0)
        tangential = np.zeros(0)
        if system.slip_bound.size:
            sticking = self.slips & (active.sliding == 0)
            tangential = np.where(sticking, residual[self.tangent], -system.slip_bound * active.sliding)
        u = w if self.basis is None else self.basis @ w
        return Equilibrium(u, system.energy(u), normal_force, tangential, active, Status.CONVERGED, 1)


def _contact_basis(system: ContactSystem) -> tuple[sp.csc_array | None, NDArray, NDArray]:
    """Change of unknowns ``u = basis @ w`` after which N u and T u are single entries of w.

    Returns the basis (None for the identity) and the entries of w that hold N u and T u; -1 where
    T u is given.
    """
    N, T = sp.csr_array(system.normals), sp.csr_array(system.tangents)
    single = np.diff(N.indptr) == 1
    if np.all(single) and np.all(N.data == 1) and np.all(np.diff(T.indptr) <= 1) and np.all(T.data == 1):
        tangent = np.full(T.shape[0], -1, np.int64)
        tangent[np.diff(T.indptr) == 1] = T.indices
        return None, N.indices.astype(np.int64), tangent
    basis = sp.lil_array(sp.eye_array(system.load.size))
    normal, tangent = np.zeros(N.shape[0], np.int64), np.full(T.shape[0], -1, np.int64)
    for i in range(N.shape[0]):
        n_dofs, n_values = _row(N, i)
        normal[i] = n_dofs[np.argmax(np.abs(n_values))]
        if n_dofs.size == 1:
            basis[normal[i], normal[i]] = 1 / n_values[0]
        else:  # columns n and t, orthonormal, so n.u and t.u are the new unknowns
            other = n_dofs[np.argmin(np.abs(n_values))]
            pair = n_values[n_dofs == normal[i]][0], n_values[n_dofs == other][0]
            direction = _row(T, i)
            sign = dict(zip(*direction, strict=True))
            basis[normal[i], normal[i]], basis[other, normal[i]] = pair
            basis[normal[i], other], basis[other, other] = sign[normal[i]], sign[other]
            tangent[i] = other
            continue
        if T.shape[0]:
            t_dofs, t_values = _row(T, i)
            if t_dofs.size and t_dofs[0] != normal[i]:
                tangent[i] = t_dofs[0]
                basis[tangent[i], tangent[i]] = 1 / t_values[0]
    return sp.csc_array(basis), normal, tangent


def _row(matrix: sp.csr_array, i: int) -> tuple[NDArray, Array]:
    part = slice(matrix.indptr[i], matrix.indptr[i + 1])
    return matrix.indices[part], matrix.data[part]


def pattern(sparsity: ca.Sparsity) -> sp.csc_array:
    """A scipy matrix of ones with the pattern of a CasADi one."""
    shape = sparsity.shape
    data = np.ones(sparsity.nnz())
    return sp.csc_array((data, sparsity.row(), sparsity.colind()), shape=shape)
