"""Contact on a fixed mesh as a quadratic program, and its solution for a given active set.

    min 1/2 u^T K u - F^T u + sum_i b_i |t_i . u_i|   with   gap = N u + gamma >= 0,

(5.1), (5.8), with Tresca bounds b_i = g omega_i >= 0. With Coulomb's coefficient F the bound is b_i + F_i
lambda_i, lambda the contact force: no longer a program, but the conditions of one for each bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from rmesh_nlp.contact.factorisation import Condensed, Solve, factorised, factorised_lu
from rmesh_nlp.evaluation import Array, Index, Mask, magnitude
from rmesh_nlp.optimize.activity import both_vanish
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True)
class ContactSystem:
    """The quadratic program of the inner problem at fixed node positions, over displacement unknowns (m,).

    Attributes
    ----------
    stiffness, load, constant : (m, m) sparse array, (m,) array, float
        K, F, and the energy at zero displacement.
    normals, tangents : (gaps, m) sparse arrays
        N and T, rows with unit vectors; those of T are empty in a scalar problem.
    offset : (gaps,) array
        gamma, the gap at zero displacement.
    slip_bound : (gaps,) array
        b = g omega, the largest tangential force; zero without friction.
    frictional : (gaps,) bool array
        Where friction may act.
    rigid : (m, motions) array, optional
        Rigid motions that only contact prevents; none by default.
    coulomb : (gaps,) array, optional
        F; zero by default.
    """

    stiffness: sp.csc_array
    load: Array
    constant: float
    normals: sp.csr_array
    tangents: sp.csr_array
    offset: Array
    slip_bound: Array
    frictional: Mask
    rigid: Array | None = None
    coulomb: Array | None = None

    def bound(self, normal: Array) -> Array:
        """(gaps,) the largest tangential force under contact forces (gaps,)."""
        if self.coulomb is None:
            return self.slip_bound
        return self.slip_bound + self.coulomb * np.maximum(normal, 0.0)

    def friction(self, state: Equilibrium) -> tuple[Array, Array, Array]:
        """(gaps,) slip magnitudes s, and multipliers mu-, mu+ of ``s - u_t >= 0`` and ``s + u_t >= 0``."""
        bound, force = self.bound(state.normal_force), state.tangential_force
        return np.abs(self.tangents @ state.u), (bound - force) / 2, (bound + force) / 2

    def energy(self, u: Array) -> float:
        """J(u), friction of Tresca included."""
        friction = self.slip_bound @ np.abs(self.tangents @ u)
        return float(0.5 * u @ (self.stiffness @ u) - self.load @ u + self.constant + friction)

    def with_offset(self, offset: Array) -> ContactSystem:
        """With gaps (gaps,) at zero displacement; the last factors are kept, which do not depend on these."""
        other = replace(self, offset=offset)
        vars(other)["rotated"] = self.rotated
        return other

    def condensed(self, last: Index) -> tuple[ContactSystem, Callable[[Array], Array]] | None:
        """The program in the unknowns ``last`` (k,) alone, among which are all that contact acts on.

        And all unknowns (m,) in equilibrium with these. None where there are none, or where its matrix has
        more entries than factors.
        """
        # factors have four times the entries of the stiffness or more
        if last.size == 0 or last.size**2 > 4 * self.stiffness.nnz:
            return None
        part = Condensed(self.stiffness, self.load, last)
        own = {name: getattr(self, name)[:, last] for name in ("normals", "tangents")}
        rigid = None if self.rigid is None else self.rigid[last]
        return replace(self, stiffness=sp.csc_array(part.S), load=part.load, rigid=rigid, **own), part.whole

    @property
    def of_gaps(self) -> ContactSystem | None:
        """The program in gaps and slips alone, all else in equilibrium; None as of :meth:`condensed`."""
        rotated, last, rigid, (gaps, m) = self.rotated, self.rotated.last, None, self.normals.shape
        slips, unit = np.flatnonzero(rotated.slips), sp.csr_array(sp.eye_array(m))
        along = sp.csr_array((np.ones(slips.size), (slips, last[gaps:])), shape=(gaps, m))
        if self.rigid is not None:
            rigid = np.zeros_like(self.rigid)
            rigid[last] = sp.vstack([self.normals, self.tangents[slips]]) @ self.rigid
        rows = {"normals": unit[rotated.normal], "tangents": along}
        turned = replace(self, stiffness=rotated.K, load=rotated.F, rigid=rigid, **rows).condensed(last)
        return turned and turned[0]

    @cached_property
    def rotated(self) -> RotatedSystem:
        """The same system with gaps and slips as unknowns."""
        return RotatedSystem(self)

    def equilibrium(self, active: ActiveSet) -> Equilibrium:
        """Equilibrium with the given nodes touching, sticking and sliding."""
        rotated = self.rotated
        F = rotated.F.copy()
        friction = -self.slip_bound * active.sliding
        F[rotated.tangent[rotated.slips]] += friction[rotated.slips]
        w = rotated.solved(active, F, self.offset)
        residual = rotated.K @ w - rotated.F
        normal_force = np.where(active.touching, residual[rotated.normal], 0.0)
        if self.coulomb is not None:
            friction = friction - active.sliding * self.coulomb * normal_force
        friction = np.where(rotated.sticking(active), residual[rotated.tangent], friction)
        u = rotated.basis @ w
        return Equilibrium(u, self.energy(u), normal_force, friction, active, Status.CONVERGED, 1)

    def response(self, active: ActiveSet, load: Array, offset: Array) -> Array:
        """(m,) how u changes with the load (m,) and the offset (gaps,), the active set held.

        With Coulomb friction it is the adjoint: what residuals change in ``load . u - offset . force``, force
        the normal ones. Without, the two are the same.
        """
        rotated = self.rotated
        return rotated.basis @ rotated.adjoint(active, rotated.basis.T @ load, offset)

    def weak(self, state: Equilibrium) -> Mask:
        """(gaps,) where strict complementarity fails: there u(X) has one-sided derivatives only.

        Gap and normal force both vanish, or slip vanishes while the friction is at its bound.
        """
        force, length = self.force_scale, max(magnitude(state.u), 1e-300)
        weak = both_vanish((self.normals @ state.u + self.offset) / length, state.normal_force / force)
        slip = self.tangents @ state.u
        reserve = self.bound(state.normal_force) - np.abs(state.tangential_force)
        return weak | (self.frictional & both_vanish(slip / length, reserve / force))

    @property
    def force_scale(self) -> float:
        """Unit of nodal forces: the largest applied one, or the force that an initial overlap would take."""
        applied = max(magnitude(self.load), np.max(self.slip_bound, initial=0.0))
        if applied == 0:
            applied = -np.min(self.offset, initial=0.0) * np.max(self.stiffness.diagonal(), initial=0.0)
        return float(max(applied, 1e-300))


@dataclass(frozen=True)
class ActiveSet:
    """Which contact nodes touch, and how they slide: -1, +1, or 0 for stick."""

    touching: Mask
    sliding: NDArray[np.int8]

    def key(self) -> bytes:
        """A hashable name."""
        return self.touching.tobytes() + self.sliding.tobytes()


class OwnState(NamedTuple):
    """Displacement and contact forces of a solver, as in :class:`Equilibrium`, whether they hold or not."""

    u: Array
    normal_force: Array
    tangential_force: Array


@dataclass(frozen=True)
class Equilibrium:
    """Solution of a contact problem on a fixed mesh.

    Attributes
    ----------
    normal_force : (gaps,) array
        Multipliers of the gaps, nodal forces >= 0 pushing the body off the foundation.
    tangential_force : (gaps,) array
        Friction on the body, -b <= force <= b, opposite to the slip.
    status : Status
        CONVERGED or ITERATION_LIMIT, with Coulomb friction also CYCLED.
    iterations : int
        Factorisations: of active sets that were tried, and of steps of the interior-point method. Those of
        the condensed problem are not counted.
    """

    u: Array
    energy: float
    normal_force: Array
    tangential_force: Array
    active: ActiveSet
    status: Status
    iterations: int


class Factors(NamedTuple):
    """Solutions with the stiffness over the unknowns ``inside``, and with its transpose."""

    inside: Index
    solve: Solve
    transposed: Solve


class RotatedSystem:
    """The stiffness in coordinates in which every gap and slip is one unknown (plus a constant).

    It must not refer to its system: in a cycle the factorisation would outlive its use by far.
    """

    def __init__(self, system: ContactSystem) -> None:
        self.basis, self.normal, self.tangent = _contact_basis(system)
        self.slips = self.tangent >= 0  # False where the tangential displacement is given
        plain = self.basis.nnz == self.basis.shape[0] and np.all(self.basis.data == 1)
        self.K = system.stiffness if plain else sp.csc_array(self.basis.T @ system.stiffness @ self.basis)
        self.F = self.basis.T @ system.load
        self._coulomb = system.coulomb
        self._factor: tuple[bytes, Factors] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Without the factors, which can't be pickled."""
        return {**vars(self), "_factor": None}

    @property
    def last(self) -> Index:
        """The unknowns that are gaps, then those that are slips."""
        return np.append(self.normal, self.tangent[self.slips])

    def sticking(self, active: ActiveSet) -> Mask:
        """Nodes whose slip the active set holds."""
        return self.slips & (active.sliding == 0)

    def factor(self, active: ActiveSet) -> Factors:
        """Factors of the stiffness over the free unknowns; the last ones are kept.

        So derivatives at a contact solution need no factorisation of their own.
        """
        pull, sticking = self.coupling(active), self.sticking(active)
        of_pull = b"" if pull is None else pull.data.tobytes() + pull.indices.tobytes()
        key = active.touching.tobytes() + sticking.tobytes() + of_pull
        if self._factor is None or self._factor[0] != key:
            held = np.append(self.normal[active.touching], self.tangent[sticking])
            inside = np.delete(np.arange(self.F.size), held)
            self._factor = None  # its memory first
            if pull is None:
                solve = transposed = factorised(self.K[:, inside][inside])
            else:
                solve, transposed = factorised_lu((self.K + pull @ self.K)[:, inside][inside])
            self._factor = key, Factors(inside, solve, transposed)
        return self._factor[1]

    def solved(self, active: ActiveSet, force: Array, offset: Array) -> Array:
        """(m,) unknowns under a force (m,), with gaps and slips closed that the active set holds."""
        w, (inside, solve, _) = np.zeros(force.size), self.factor(active)
        w[self.normal[active.touching]] = -offset[active.touching]
        residual, pull = force - self.K @ w, self.coupling(active)
        w[inside] = solve((residual if pull is None else residual + pull @ residual)[inside])
        return w

    def adjoint(self, active: ActiveSet, force: Array, offset: Array) -> Array:
        """(m,) of :meth:`solved`: slips, ``s F`` times, add to the gaps of sliding nodes."""
        w, (inside, _, transposed) = np.zeros(force.size), self.factor(active)
        w[self.normal[active.touching]] = -offset[active.touching]
        w[inside] = transposed((force - self.K @ w)[inside])
        pull = self.coupling(active)
        return w if pull is None else w + pull.T @ w

    def coupling(self, active: ActiveSet) -> sp.csr_array | None:
        """C, which adds the rows of the gaps of sliding nodes to those of their slips: ``s F`` times.

        With ``r = K w - F`` the tangential force of such a node is ``r_t = -s (b + F r_n)``. None without
        Coulomb friction.
        """
        if self._coulomb is None:
            return None
        slides = np.flatnonzero(active.touching & self.slips & (active.sliding != 0) & (self._coulomb > 0))
        values = active.sliding[slides] * self._coulomb[slides]
        place = self.tangent[slides], self.normal[slides]
        return sp.csr_array((values, place), shape=self.K.shape)


def _contact_basis(system: ContactSystem) -> tuple[sp.csc_array, Index, Index]:
    """Basis of ``u = basis @ w``, and the entries of w that are N u and T u.

    They are -1 where T u is given, or no friction acts. A gap takes the place of the displacement that it
    depends on most, of those that no row with fewer has taken, and a slip that of one which is left.
    """
    N, T, taken = system.normals, system.tangents, np.zeros(system.load.size, dtype=bool)
    normal, tangent = _places(N, taken), np.full(N.shape[0], -1)
    tangent[system.frictional] = _places(T[system.frictional], taken)
    slips = np.flatnonzero(tangent >= 0)
    places, rest = np.append(normal, tangent[slips]), np.flatnonzero(~taken)
    rows, order = sp.vstack([N, T[slips]], format="csr"), np.append(places, rest)
    if rows.nnz == places.size:
        scale = np.ones(taken.size)
        scale[places] = 1 / rows.data
        return sp.csc_array(sp.diags_array(scale)), normal, tangent
    # the rows that share displacements, mostly those of one node, are few
    inverse = _inverse(sp.csc_array(rows[:, places]))
    blocks = [[inverse, -inverse @ rows[:, rest]], [None, sp.eye_array(rest.size)]]
    basis = sp.block_array(blocks, format="coo")
    where = order[basis.row], order[basis.col]
    return sp.csc_array((basis.data, where), shape=basis.shape), normal, tangent


def _inverse(matrix: sp.csc_array) -> sp.csr_array:
    """The inverse of a matrix that is block diagonal up to the order of its unknowns, with small blocks."""
    _, block = connected_components(matrix, directed=False)
    order = np.argsort(block, kind="stable")
    first = np.searchsorted(block[order], block)
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    own = place - first  # which one of its block each unknown is
    columns = splu(matrix).solve(np.eye(int(np.max(own)) + 1)[own])
    row, which = np.nonzero(columns)
    column = order[first[row] + which]
    return sp.csr_array((columns[row, which], (row, column)), shape=matrix.shape)


def _places(rows: sp.csr_array, taken: Mask) -> Index:
    """For each row the column of its largest entry that is not taken, which then is; -1 without any.

    Entries count for less in a column of many, such as that of a tool; of equal ones the first is taken, so
    that gap and slip of a pair at 45 degrees take both components of one node.
    """
    entries, place = rows.tocoo(), np.full(rows.shape[0], -1)
    size = np.abs(entries.data) / np.bincount(entries.col)[entries.col]
    order = np.lexsort((entries.col, -np.round(size, 9), np.diff(rows.indptr)[entries.row]))
    row, column = entries.row[order], entries.col[order]
    while (left := (place[row] < 0) & ~taken[column]).any():
        row, column = row[left], column[left]
        chosen = np.sort(np.unique(row, return_index=True)[1])
        chosen = chosen[np.unique(column[chosen], return_index=True)[1]]
        place[row[chosen]], taken[column[chosen]] = column[chosen], True
    return place
