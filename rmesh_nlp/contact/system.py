"""Contact on a fixed mesh as a quadratic program, and its solution for a given active set.

    min 1/2 u^T K u - F^T u + sum_i b_i |t_i . u_i|   with   gap = N u + gamma >= 0,

(5.1), (5.8), with Tresca bounds b_i = g omega_i >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT, Index
from rmesh_nlp.optimize.status import Status

LARGE = 5000
"""Nodes above which it is used: smaller meshes are factorised fast enough in any order."""

LEAF = 64
"""Nodes that are not halved any more."""


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
    frictional : (contact nodes,) bool array, optional
        Where friction may act if there is any; everywhere by default.
    rigid : (m, motions) array, optional
        Rigid motions that only contact prevents; none by default.
    order : (m,) int array, optional
        The unknowns in the order of their elimination; by default it is found for each factorisation.
    """

    stiffness: sp.csc_array
    load: Array
    constant: float
    normals: sp.csr_array
    tangents: sp.csr_array
    offset: Array
    slip_bound: Array
    frictional: NDArray[np.bool_] | None = None
    rigid: Array | None = None
    order: NDArray[np.int64] | None = None

    def energy(self, u: Array) -> float:
        """J(u), friction included."""
        friction = self.slip_bound @ np.abs(self.tangents @ u) if self.slip_bound.size else 0.0
        return float(0.5 * u @ (self.stiffness @ u) - self.load @ u + self.constant + friction)

    @cached_property
    def rotated(self) -> RotatedSystem:
        """The same system with gaps and slips as unknowns."""
        return RotatedSystem(self)

    def equilibrium(self, active: ActiveSet) -> Equilibrium:
        """Equilibrium with the given nodes touching, sticking and sliding."""
        rotated = self.rotated
        w = np.zeros(self.load.size)
        w[rotated.normal[active.touching]] = -self.offset[active.touching]
        F = rotated.F
        if self.slip_bound.size:
            F = F.copy()
            F[rotated.tangent[rotated.slips]] -= (self.slip_bound * active.sliding)[rotated.slips]
        inside, factor = rotated.factor(active)
        w[inside] = factor.solve((F - rotated.K @ w)[inside])
        residual = rotated.K @ w - rotated.F
        normal_force = np.where(active.touching, residual[rotated.normal], 0.0)
        tangential = np.zeros(0)
        if self.slip_bound.size:
            sticking = rotated.slips & (active.sliding == 0)
            tangential = np.where(sticking, residual[rotated.tangent], -self.slip_bound * active.sliding)
        u = w if rotated.basis is None else rotated.basis @ w
        return Equilibrium(u, self.energy(u), normal_force, tangential, active, Status.CONVERGED, 1)

    @property
    def force_scale(self) -> float:
        """Unit of nodal forces, to make residuals dimensionless.

        The largest applied one; where a foundation alone deforms the body, the force that its initial
        overlap would take.
        """
        applied = max(np.max(np.abs(self.load), initial=0.0), np.max(self.slip_bound, initial=0.0))
        if applied == 0:
            overlap = -np.min(self.offset, initial=0.0)
            applied = overlap * np.max(self.stiffness.diagonal(), initial=0.0)
        return float(max(applied, 1e-300))


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
        Active sets that were tried, a factorisation each; the guess of a cold start takes one more.
    """

    u: Array
    energy: float
    normal_force: Array
    tangential_force: Array
    active: ActiveSet
    status: Status
    iterations: int


def factorised(K: sp.csc_array, *, ordered: bool = False) -> Any:
    """Sparse factorisation of a symmetric positive definite matrix, in its own order if ``ordered``."""
    # SuperLU takes 32-bit indices; SciPy before 1.13 makes 64-bit ones when a matrix is sliced
    indices, starts = (a.astype(np.int32, copy=False) for a in (K.indices, K.indptr))
    K = sp.csc_array((K.data, indices, starts), shape=K.shape)
    # pivots on the diagonal: anything else would give up the ordering, and with it the sparsity
    order = "NATURAL" if ordered else "MMD_AT_PLUS_A"
    return splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class RotatedSystem:
    """The stiffness in coordinates in which every gap and slip is one unknown (plus a constant).

    It must not refer to its system: in a cycle the factorisation would outlive its use by far.
    """

    def __init__(self, system: ContactSystem) -> None:
        basis, self.normal, self.tangent = _contact_basis(system)
        self.basis = basis
        self.slips = self.tangent >= 0  # False where the tangential displacement is given
        if system.frictional is not None:
            self.slips = self.slips & system.frictional[: self.slips.size]
        self.K = system.stiffness if basis is None else sp.csc_array(basis.T @ system.stiffness @ basis)
        self.F = system.load if basis is None else basis.T @ system.load
        self._frictional = system.slip_bound.size > 0
        self._order = system.order
        self._factor: tuple[bytes, NDArray[np.intp], Any] | None = None

    def free(self, active: ActiveSet) -> NDArray[np.bool_]:
        """Unknowns that touching and sticking nodes leave free."""
        free = np.ones(self.F.size, dtype=bool)
        free[self.normal[active.touching]] = False
        if self._frictional:
            free[self.tangent[self.slips & (active.sliding == 0)]] = False
        return free

    def factor(self, active: ActiveSet) -> tuple[NDArray[np.intp], Any]:
        """The free unknowns, in the order of elimination, and the factorised stiffness; the last is kept.

        So derivatives at a contact solution need no factorisation of their own.
        """
        if self._factor is None or self._factor[0] != active.key():
            free = self.free(active)
            inside = np.flatnonzero(free) if self._order is None else self._order[free[self._order]]
            self._factor = None  # its memory first
            factor = factorised(self.K[:, inside][inside], ordered=self._order is not None)
            self._factor = active.key(), inside, factor
        return self._factor[1:]


def _contact_basis(system: ContactSystem) -> tuple[sp.csc_array | None, NDArray, NDArray]:
    """Change of unknowns ``u = basis @ w`` after which N u and T u are single entries of w.

    Returns the basis (None for the identity) and the entries of w that hold N u and T u; -1 where
    T u is given, or no friction acts.
    """
    N, T = sp.csr_array(system.normals), sp.csr_array(system.tangents)
    sticky = np.zeros(N.shape[0], dtype=bool)
    if system.slip_bound.size:
        sticky[:] = True if system.frictional is None else system.frictional
    single = bool(np.all(np.diff(N.indptr) == 1) and np.all(N.data == 1)) and _apart(N)
    tangent = np.full(N.shape[0], -1, np.int64)
    if single and not np.any(sticky):
        return None, N.indices.astype(np.int64), tangent
    if single and np.all(np.diff(T.indptr) <= 1) and np.all(T.data == 1):
        given = np.diff(T.indptr) == 0
        tangent[~given] = T.indices
        return None, N.indices.astype(np.int64), np.where(sticky, tangent, -1)
    basis = sp.lil_array(sp.eye_array(system.load.size))
    normal = np.zeros(N.shape[0], np.int64)
    done = _corner_basis(N, basis, normal)
    for i in np.flatnonzero(~done):
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
        if sticky[i]:
            t_dofs, t_values = _row(T, i)
            if t_dofs.size and t_dofs[0] != normal[i]:
                tangent[i] = t_dofs[0]
                basis[tangent[i], tangent[i]] = 1 / t_values[0]
    return sp.csc_array(basis), normal, np.where(sticky, tangent, -1)


def _shared(N: sp.csr_array) -> sp.coo_array:
    """Pairs of gaps that depend on one unknown, as entries above the diagonal."""
    return sp.coo_array(sp.triu(abs(N) @ abs(N).T, k=1))


def _apart(N: sp.csr_array) -> bool:
    """Whether no two gaps, of one entry each, depend on one unknown."""
    return np.unique(N.indices).size == N.indices.size


def _corner_basis(N: sp.csr_array, basis: Any, normal: NDArray) -> NDArray[np.bool_]:
    """Fills in the basis at nodes that two foundations meet: both gaps are unknowns there.

    Returns which rows it has dealt with.
    """
    done = np.zeros(N.shape[0], dtype=bool)
    shared = _shared(N)
    for one, two in zip(shared.row, shared.col, strict=True):
        dofs = np.unique(np.concatenate([_row(N, one)[0], _row(N, two)[0]]))
        inverse = np.linalg.inv(N[[one, two]][:, dofs].toarray())
        for i, row in enumerate(dofs):
            for j, column in enumerate(dofs):
                basis[row, column] = inverse[i, j]
        normal[one], normal[two] = dofs
        done[[one, two]] = True
    return done


def _row(matrix: sp.csr_array, i: Any) -> tuple[NDArray, Array]:
    part = slice(matrix.indptr[i], matrix.indptr[i + 1])
    return matrix.indices[part], matrix.data[part]


def elimination_order(points: Array, edges: NDArray[np.integer], index: Index) -> NDArray[np.int64]:
    """The unknowns of a nodal field in the order of their elimination.

    Parameters
    ----------
    points : (2, nodes) array
    edges : (2, edges) array
    index : (components, nodes) array
        Number of the unknown behind each component, or ``CONSTANT``.
    """
    unknowns = index[:, dissected(points, edges)].T.ravel()
    unknowns = unknowns[unknowns != CONSTANT]
    _, first = np.unique(unknowns, return_index=True)  # tied nodes have one unknown
    return np.asarray(unknowns[np.sort(first)], dtype=np.int64)


def dissected(points: Array, edges: NDArray[np.integer]) -> NDArray[np.int64]:
    """The nodes, separators after the halves that they separate."""
    n = points.shape[1]
    ends = np.hstack([edges, edges[::-1]])
    adjacent = sp.csr_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(n, n))
    beyond = np.zeros(n)
    parts: list[NDArray[np.int64]] = []  # from the last one to be eliminated to the first
    waiting = [np.arange(n)]
    while waiting:
        nodes = waiting.pop()
        if nodes.size > LEAF:
            here = points[:, nodes]
            along = here[int(np.argmax(np.ptp(here, axis=1)))]
            low = along <= np.median(along)
            if not np.all(low):
                beyond[nodes[~low]] = 1.0
                separates = adjacent[nodes[low]] @ beyond > 0
                beyond[nodes[~low]] = 0.0
                parts.append(nodes[low][separates])
                waiting += [nodes[low][~separates], nodes[~low]]
                continue
        parts.append(nodes)
    return np.concatenate(parts[::-1])
