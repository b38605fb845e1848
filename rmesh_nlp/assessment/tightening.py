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
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import brentq

from rmesh_nlp.assessment.standoff import Cells
from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
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
    """The admissible displacement of least energy from an admissible one; None if it is not found.

    The friction of ``system`` is regarded, its gaps are not. ``field`` (components, nodes) is the
    displacement as a function of the unknowns. The forces at points are shared among their nodes; a node
    touches where its share is positive.
    """
    margin = MARGIN * float(np.max(np.abs(state.u), initial=0.0) + np.max(np.abs(system.offset), initial=0.0))
    chosen, slips = _closed(cells, field.values(state.u), state), _slips(system)
    solver = _Multipliers(system, _points(cells, chosen, field, margin, state.u), slips, PENALTY)
    u, pressing, friction = state.u.copy(), np.zeros(chosen.shape[1]), state.tangential_force[slips.number]
    before = np.inf
    for _ in range(ROUNDS):
        minimiser = solver.minimised(u, pressing, friction)
        if minimiser is None:
            return None
        u = minimiser
        pressing, friction, open_by = solver.updated(u, pressing, friction)
        violated = _violated(cells, field.values(u), chosen)
        if violated.size:
            chosen, pressing = np.hstack([chosen, violated]), np.append(pressing, np.zeros(violated.shape[1]))
            order = np.argsort(chosen[0], kind="stable")  # part by part
            chosen, pressing = chosen[:, order], pressing[order]
            solver = _Multipliers(system, _points(cells, chosen, field, margin, u), slips, solver.penalty)
            before = np.inf
            continue
        if open_by <= margin:
            return _equilibrium(system, cells, chosen, u, pressing, slips.number, friction)
        if open_by > SLOW * before and solver.penalty < LARGEST:
            solver = _Multipliers(system, solver.points, slips, 10 * solver.penalty)
        before = open_by
    return None


class _Points(NamedTuple):
    """Rows (points, n_u) of gaps, and the gaps at zero unknowns."""

    rows: sp.csr_array
    gap: Array


class _Slips(NamedTuple):
    """Rows (n, n_u) of the slips at nodes where friction acts, their numbers among the gaps, bounds."""

    rows: sp.csr_array
    number: Index
    bound: Array


class _Multipliers:
    """The augmented energy of one set of points, and its minimiser."""

    def __init__(self, system: ContactSystem, points: _Points, slips: _Slips, penalty: float) -> None:
        self._system, self.points, self._slips, self.penalty = system, points, slips, penalty
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
        K, F, A, T = self._system.stiffness, self._system.load, self.points.rows, self._slips.rows
        for _ in range(STEPS):
            now, stuck = self._forces(u, pressing, friction)
            residual = K @ u - F - A.T @ now - T.T @ stuck
            scale = max(self._system.force_scale, float(np.max(now, initial=0.0)))
            if np.max(np.abs(residual), initial=0.0) <= BALANCE * scale:
                return u
            step = -self._solved(now > 0, np.abs(stuck) < self._slips.bound, residual)
            u = u + self._length(u, step, pressing, friction) * step
        return None

    def _forces(self, u: Array, pressing: Array, friction: Array) -> tuple[Array, Array]:
        gap = self.points.rows @ u + self.points.gap
        stuck = np.clip(friction - self._r * (self._slips.rows @ u), -self._slips.bound, self._slips.bound)
        return np.maximum(pressing - self._r * gap, 0.0), stuck

    def _solved(self, presses: NDArray[np.bool_], sticks: NDArray[np.bool_], right: Array) -> Array:
        key = presses.tobytes() + sticks.tobytes()
        if self._factor is None or self._factor[0] != key:
            A, T = self.points.rows[presses], self._slips.rows[sticks]
            K = self._system.stiffness
            small = 1e-12 * K.diagonal()  # contact may hold the body, and not in every set
            matrix = K + self._r * (A.T @ A + T.T @ T) + sp.diags_array(small)
            self._factor = key, factorised(sp.csc_array(matrix))
        return np.asarray(self._factor[1].solve(right))

    def _length(self, u: Array, step: Array, pressing: Array, friction: Array) -> float:
        """Part of a step at which the slope of the augmented energy is zero, at most 1."""
        K, F, A, T = self._system.stiffness, self._system.load, self.points.rows, self._slips.rows
        constant, linear = float((K @ u - F) @ step), float(step @ (K @ step))
        along, slipping = A @ step, T @ step

        def slope(t: float) -> float:
            now, stuck = self._forces(u + t * step, pressing, friction)
            return constant + t * linear - float(along @ now) - float(slipping @ stuck)

        return 1.0 if slope(1.0) <= 0 else float(brentq(slope, 0.0, 1.0, xtol=1e-14, rtol=1e-6))


def _slips(system: ContactSystem) -> _Slips:
    tangents = sp.csr_array(system.tangents)
    acts = (np.diff(tangents.indptr) > 0) & bool(system.slip_bound.size)
    if system.frictional is not None:
        acts &= system.frictional[: acts.size]
    number = np.flatnonzero(acts)
    return _Slips(tangents[number], number, system.slip_bound[number])


def _closed(cells: Sequence[Cells], displacement: Array, state: Equilibrium) -> Index:
    """(3, n) part, cell and point of least gap of the cells whose nodes press on the foundation."""
    closed = [np.zeros((3, 0), dtype=np.int64)]
    for number, part in enumerate(cells):
        presses, free = np.zeros(part.rows.shape, dtype=bool), part.rows >= 0
        presses[free] = state.normal_force[part.rows[free]] > 0
        cell = np.flatnonzero(np.any(presses, axis=0))
        point = np.argmin(part.gaps(displacement)[cell], axis=1)
        closed.append(np.stack([np.full(cell.size, number), cell, point]))
    return np.hstack(closed)


def _violated(cells: Sequence[Cells], displacement: Array, chosen: Index) -> Index:
    """(3, n) the worst points of cells where the gap is violated, those that are chosen already left out."""
    taken, new = set(zip(*chosen.tolist(), strict=True)), []
    for number, part in enumerate(cells):
        gap = part.gaps(displacement)
        worst = np.argmin(gap, axis=1)
        for cell in np.flatnonzero(np.min(gap, axis=1) < 0).tolist():
            if (number, cell, int(worst[cell])) not in taken:
                new.append((number, cell, int(worst[cell])))
    return np.array(new, dtype=np.int64).reshape(-1, 3).T


def _points(cells: Sequence[Cells], chosen: Index, field: Field, margin: float, u: Array) -> _Points:
    """The gaps at the chosen points, less what they fall by between points if the displacement is near u."""
    rows, gaps, n_u, displacement = [], [], int(field.index.max()) + 1, field.values(u)
    for number, part in enumerate(cells):
        cell, point = chosen[1:, chosen[0] == number]
        nodes = part.nodes[:, cell]
        weight = part.normals[:, cell, point][:, None] * part.shares[:, point]  # (components, v, m)
        index = field.index[:, nodes]
        free, row = index >= 0, np.broadcast_to(np.arange(cell.size), index.shape)
        rows.append(sp.csr_array((weight[free], (row[free], index[free])), shape=(cell.size, n_u)))
        given = np.where(free, 0.0, weight * field.offset[:, nodes]).sum(axis=(0, 1))
        low = part.low - part.dips(displacement)
        gaps.append(given + low[cell, point] - margin)
    return _Points(sp.csr_array(sp.vstack(rows)), np.concatenate(gaps))


def _equilibrium(
    system: ContactSystem,
    cells: Sequence[Cells],
    chosen: Index,
    u: Array,
    pressing: Array,
    slips: Index,
    friction: Array,
) -> Equilibrium:
    force, tangential = np.zeros(system.offset.size), np.zeros(system.slip_bound.size)
    for number, part in enumerate(cells):
        own = chosen[0] == number
        cell, point = chosen[1:, own]
        part.share(force, cell, point, pressing[own])
    tangential[slips] = friction
    slides = np.abs(tangential) >= system.slip_bound * (1 - 1e-9)
    sliding = np.where(slides, -np.sign(tangential), 0).astype(np.int8)
    active = ActiveSet(force > 0, sliding)
    return Equilibrium(u, system.energy(u), force, tangential, active, Status.CONVERGED, 1)
