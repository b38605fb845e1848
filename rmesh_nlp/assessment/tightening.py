"""The admissible displacement of least energy on a mesh.

Nodes that keep off a foundation by the largest height beside them keep off by more than they must. Here the
gap is imposed at points within contact edges (triangles), which are added until none is violated, and

    min 1/2 u K u - F u + sum_i b_i |t_i . u|   with   g_k(u) = a_k . u + c_k >= 0

is solved by the method of multipliers (M. R. Hestenes, J. Optim. Theory Appl. 4 (1969) 303-320): gaps enter
by ``max(m_k - r g_k, 0)^2 / 2 r``, slips alike with their forces cut off at the bounds, the sum is minimised
by Newton's method with a line search, and the multipliers follow. The stiffness is factorised once for every
set of points that press and nodes that stick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import brentq

from rmesh_nlp.assessment.standoff import Cells
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium, factorised
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.optimize.status import Status

Index = NDArray[np.int64]

ROUNDS = 60
"""Updates of the multipliers, points added included."""

STEPS = 40
"""Newton steps between two of them."""

PENALTY, LARGEST = 1e3, 1e6
"""r over the mean stiffness of the contact nodes: each update lowers the violation about a thousandfold.
Points that lie close together exchange their forces slowly, in proportion to r, which then grows tenfold."""

SLOW = 0.3
"""Least part of the violation that is left by an update, for r to grow."""

BALANCE = 1e-9
"""Out-of-balance force, in parts of the largest one, at which Newton's method ends."""

MARGIN = 1e-7
"""What points keep off the foundation in addition, in parts of the largest displacement and distance, so that
their gaps need be right to this part of them only."""


def tightened(
    system: ContactSystem, state: Equilibrium, cells: Sequence[Cells], field: Field
) -> Equilibrium | None:
    """The admissible displacement of least energy; None if it is not found.

    Parameters
    ----------
    system : ContactSystem
        Its gaps are not regarded, its friction is.
    state : Equilibrium
        An admissible displacement to begin with.
    cells : sequence of Cells
    field : Field
        (components, nodes), the displacement as a function of the unknowns.

    Returns
    -------
    Equilibrium
        The forces at points are shared among their nodes; a node touches where its share is positive.
    """
    size = float(np.max(np.abs(state.u), initial=0.0) + np.max(np.abs(system.offset), initial=0.0))
    chosen = [_closed(part, part.gaps(field.values(state.u)), state) for part in cells]
    points = _points(cells, chosen, field, MARGIN * size)
    slips = _slips(system)
    solver = _Multipliers(system, points, slips, PENALTY)
    u, pressing, friction = state.u.copy(), np.zeros(points.gap.size), state.tangential_force[slips.number]
    before, penalty = np.inf, PENALTY
    for _ in range(ROUNDS):
        found = solver.minimised(u, pressing, friction)
        if found is None:
            return None
        u = found
        pressing, friction, open_by = solver.updated(u, pressing, friction)
        values = field.values(u)
        more = [_violated(part.gaps(values), *of) for part, of in zip(cells, chosen, strict=True)]
        if any(cell.size for cell, _ in more):
            ends = np.cumsum([cell.size for cell, _ in chosen])
            pressing = np.insert(pressing, np.repeat(ends, [cell.size for cell, _ in more]), 0.0)
            chosen = [
                (np.append(one[0], two[0]), np.append(one[1], two[1]))
                for one, two in zip(chosen, more, strict=True)
            ]
            points = _points(cells, chosen, field, MARGIN * size)
            solver, before = _Multipliers(system, points, slips, penalty), np.inf
            continue
        if open_by <= MARGIN * size:
            return _equilibrium(system, cells, chosen, u, pressing, slips.number, friction)
        if open_by > SLOW * before and penalty < LARGEST:
            penalty *= 10
            solver = _Multipliers(system, points, slips, penalty)
        before = open_by
    return None


@dataclass(frozen=True)
class _Points:
    """Rows (points, n_u) of gaps, and the gaps at zero unknowns."""

    rows: sp.csr_array
    gap: Array


@dataclass(frozen=True)
class _Slips:
    """Rows (n, n_u) of the slips at nodes where friction acts, their numbers among the gaps, bounds."""

    rows: sp.csr_array
    number: Index
    bound: Array


class _Multipliers:
    """The augmented energy of one set of points, and its minimiser."""

    def __init__(self, system: ContactSystem, points: _Points, slips: _Slips, penalty: float) -> None:
        self._system, self._points, self._slips, self._bound = system, points, slips, slips.bound
        touched = np.unique(points.rows.indices)
        self._r = penalty * float(np.mean(system.stiffness.diagonal()[touched])) if touched.size else 1.0
        self._factor: tuple[bytes, Any] | None = None

    def updated(self, u: Array, pressing: Array, friction: Array) -> tuple[Array, Array, float]:
        """Multipliers after a minimisation, and the largest gap or slip of what presses or sticks."""
        now, stuck = self._forces(u, pressing, friction)
        changes = np.concatenate([np.abs(now - pressing), np.abs(stuck - friction)])
        return now, stuck, float(np.max(changes, initial=0.0)) / self._r

    def minimised(self, u: Array, pressing: Array, friction: Array) -> Array | None:
        """The minimiser of the augmented energy from ``u``; None if Newton's method does not end."""
        K, F, A, T = self._system.stiffness, self._system.load, self._points.rows, self._slips.rows
        for _ in range(STEPS):
            now, stuck = self._forces(u, pressing, friction)
            residual = K @ u - F - A.T @ now - T.T @ stuck
            scale = max(self._system.force_scale, float(np.max(now, initial=0.0)))
            if np.max(np.abs(residual), initial=0.0) <= BALANCE * scale:
                return u
            step = -self._solved(now > 0, np.abs(stuck) < self._bound, residual)
            u = u + self._length(u, step, pressing, friction) * step
        return None

    def _forces(self, u: Array, pressing: Array, friction: Array) -> tuple[Array, Array]:
        gap = self._points.rows @ u + self._points.gap
        stuck = np.clip(friction - self._r * (self._slips.rows @ u), -self._bound, self._bound)
        return np.maximum(pressing - self._r * gap, 0.0), stuck

    def _solved(self, presses: NDArray[np.bool_], sticks: NDArray[np.bool_], right: Array) -> Array:
        key = presses.tobytes() + sticks.tobytes()
        if self._factor is None or self._factor[0] != key:
            A, T = self._points.rows[presses], self._slips.rows[sticks]
            K = self._system.stiffness
            small = 1e-12 * K.diagonal()  # contact may hold the body, and not in every set
            matrix = K + self._r * (A.T @ A + T.T @ T) + sp.diags_array(small)
            self._factor = key, factorised(sp.csc_array(matrix))
        return np.asarray(self._factor[1].solve(right))

    def _length(self, u: Array, step: Array, pressing: Array, friction: Array) -> float:
        """Part of a step at which the slope of the augmented energy is zero, at most 1."""
        K, F, A, T = self._system.stiffness, self._system.load, self._points.rows, self._slips.rows
        constant, linear = float((K @ u - F) @ step), float(step @ (K @ step))
        along, slipping = A @ step, T @ step

        def slope(t: float) -> float:
            now, stuck = self._forces(u + t * step, pressing, friction)
            return constant + t * linear - float(along @ now) - float(slipping @ stuck)

        return 1.0 if slope(1.0) <= 0 else float(brentq(slope, 0.0, 1.0, xtol=1e-14, rtol=1e-6))


def _slips(system: ContactSystem) -> _Slips:
    if not system.slip_bound.size:
        none = np.zeros(0, dtype=np.int64)
        return _Slips(sp.csr_array((0, system.load.size)), none, np.zeros(0))
    tangents = sp.csr_array(system.tangents)
    acts = np.diff(tangents.indptr) > 0
    if system.frictional is not None:
        acts &= system.frictional
    number = np.flatnonzero(acts)
    return _Slips(tangents[number], number, system.slip_bound[number])


def _closed(part: Cells, gap: Array, state: Equilibrium) -> tuple[Index, Index]:
    """The points of least gap of the cells whose nodes press on the foundation."""
    presses, free = np.zeros(part.rows.shape, dtype=bool), part.rows >= 0
    presses[free] = state.normal_force[part.rows[free]] > 0
    cell = np.flatnonzero(np.any(presses, axis=0))
    return cell, np.argmin(gap[cell], axis=1)


def _violated(gap: Array, cell: Index, point: Index) -> tuple[Index, Index]:
    """The worst points of cells where the gap is violated, those that are chosen already left out."""
    worst = np.argmin(gap, axis=1)
    cells = np.flatnonzero(gap[np.arange(worst.size), worst] < 0)
    known = set(zip(cell.tolist(), point.tolist(), strict=True))
    new = [c for c in cells.tolist() if (c, int(worst[c])) not in known]
    return np.array(new, dtype=np.int64), worst[new]


def _points(
    cells: Sequence[Cells], chosen: Sequence[tuple[Index, Index]], field: Field, margin: float
) -> _Points:
    rows, gaps, n_u = [], [], int(field.index.max()) + 1
    for part, (cell, point) in zip(cells, chosen, strict=True):
        normals = part.normals[:, cell, point]  # (components, m)
        index, offset = field.index[:, part.nodes[:, cell]], field.offset[:, part.nodes[:, cell]]
        weight = normals[:, None] * part.shares[:, point][None]
        number = np.broadcast_to(np.arange(cell.size), index.shape)
        free = index >= 0
        rows.append(sp.csr_array((weight[free], (number[free], index[free])), shape=(cell.size, n_u)))
        given = np.where(free, 0.0, weight * offset).sum(axis=(0, 1))
        gaps.append(given + part.low[cell, point] - margin)
    return _Points(sp.csr_array(sp.vstack(rows)), np.concatenate(gaps))


def _equilibrium(
    system: ContactSystem,
    cells: Sequence[Cells],
    chosen: Sequence[tuple[Index, Index]],
    u: Array,
    pressing: Array,
    slips: Index,
    friction: Array,
) -> Equilibrium:
    force, first = np.zeros(system.offset.size), 0
    for part, (cell, point) in zip(cells, chosen, strict=True):
        part.share(force, cell, point, pressing[first : first + cell.size])
        first += cell.size
    tangential = np.zeros(system.slip_bound.size)
    tangential[slips] = friction
    slides = np.abs(tangential) >= system.slip_bound * (1 - 1e-9) if tangential.size else tangential
    sliding = np.where(slides, -np.sign(tangential), 0).astype(np.int8)
    return Equilibrium(
        u, system.energy(u), force, tangential, ActiveSet(force > 0, sliding), Status.CONVERGED, 1
    )
