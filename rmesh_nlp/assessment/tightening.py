"""The admissible displacement of least energy on a mesh.

Nodes that keep off a foundation by the largest height beside them keep off by more than they must, and
friction that is bounded at nodes costs more than along edges. Here gaps and friction are regarded at points
within contact edges (triangles),

    min 1/2 u K u - F u + sum_p b_p |t_p . u|   with   g_p(u) = n_p . u + c_p >= 0,

b_p the bound times the length of its point, by springs of stiffness k with the forces ``clip(f_p + k v_p)``,
v_p the stretch ``-g_p`` or ``-t_p . u``, within [0, inf) or [-b_p, b_p], f_p the forces of the last solution.
Newton's method, for stiffer and stiffer springs, ends where it does not change which of them are within their
limits; with forces that are taken over the springs need not be stiff to be exact (R. T. Rockafellar,
Augmented Lagrange multiplier functions and duality in nonconvex programming, SIAM J. Control 12 (1974)
268-285; P. Alart, A. Curnier, Comput. Methods Appl. Mech. Engrg. 92 (1991) 353-375).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.standoff import Cells
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude

STIFFNESSES, IN_TRIANGLES = (1.0, 1e2, 1e4, 1e6, 1e8), 3
"""Of the springs of gaps, one after the other, in units of the largest entry of K; in triangles the first so
many. An obstacle inside a membrane of 48 squares, order 2, takes 46 steps with three, 153 with all of them,
which lower the energy by 3e-8 of it."""

SLIP, STIFFER = 1e-2, 10.0
"""The first stretch at which friction has its bound, in units of the largest displacement, and the factor of
this stiffness from one time to the next. Where the slip changes its sign within an edge the integral of
friction is smooth. For stiff springs without forces of a last time Newton's method would see a kink at each
point: 366 steps on an ellipse, 33 with these."""

STEPS, REPEATS = 50, 20
"""Most steps of Newton's method with springs of one kind, and times that their forces are taken over."""

EXACT = 1e-13
"""Stretch of springs within their limits that is none, in units of the largest displacement or gap."""


@dataclass(frozen=True)
class Springs:
    """One at each point (m, k) of some cells, along unit vectors (components, m, k)."""

    cells: Cells
    ways: Array
    limit: Array | None  # b_p of friction; None of gaps
    places: Index  # (m, components * v) unknowns of the displacement of each cell, -1 of none
    stiffness: float = 1.0
    offset: Array | float = 0.0  # (m, k) stretch without displacement
    held: Array | float = 0.0  # (m, k), f_p

    def shared(self, state: Equilibrium) -> Array:
        """(m, k) forces at nodes, each shared among the points beside it as its shape function is there."""
        rows, free, shares = self.cells.rows, self.cells.rows >= 0, self.cells.shares
        force = np.maximum(state.normal_force, 0.0) if self.limit is None else state.tangential_force
        number = np.bincount(rows[free], minlength=force.size)
        own = np.where(free, force[rows] / np.maximum(number[rows], 1), 0.0)
        return (own / shares.sum(axis=1)[:, None]).T @ shares

    def at(self, displacement: Array, held: Array, stiffness: float) -> Springs:
        """With forces ``held``, a stiffness, and of gaps with the dips about a displacement."""
        if self.limit is not None:
            return replace(self, held=held, stiffness=stiffness)
        offset = self.cells.dips(displacement) - self.cells.distance
        return replace(self, held=held, stiffness=stiffness, offset=offset)

    def forces(self, displacement: Array) -> tuple[float, Array, Mask]:
        """The energy that is stored, forces (m, k) along the vectors, and which are within their limits."""
        stretch = self.offset - np.sum(self.ways * self.cells.displaced(displacement), axis=0)
        low, high = (0.0, np.inf) if self.limit is None else (-self.limit, self.limit)
        free = self.held + self.stiffness * stretch
        force = np.clip(free, low, high)
        stored = np.vdot(force, stretch) - np.sum((force - self.held) ** 2) / (2 * self.stiffness)
        return float(stored), force, (free > low) & (free < high)

    def pull(self, force: Array, within: Mask, size: int) -> tuple[Array, sp.csc_array]:
        """Their forces (size,) on the unknowns, and the stiffness of those within their limits."""
        own = np.flatnonzero(np.any(within | (force != 0), axis=1))
        ways = np.einsum("cmk,vk->mcvk", self.ways[:, own], self.cells.shares)
        ways = ways.reshape(own.size, self.places.shape[1], force.shape[1])
        at, total = self.places[own], np.zeros(size)
        np.add.at(total, at[at >= 0], (ways @ force[own, :, None])[..., 0][at >= 0])
        local = self.stiffness * (ways * within[own, None]) @ ways.swapaxes(1, 2)
        row, column = (np.broadcast_to(each, local.shape) for each in (at[:, :, None], at[:, None]))
        kept = (row >= 0) & (column >= 0)
        return total, sp.csc_array((local[kept], (row[kept], column[kept])), shape=(size, size))


@dataclass(frozen=True)
class _Program:
    """The energy of unknowns (k,) with springs."""

    system: ContactSystem
    displacement: Callable[[Array], Array]
    springs: Sequence[Springs]

    def value(self, x: Array) -> tuple[float, list[tuple[Array, Mask]]]:
        """What is minimised, and the springs' forces and which are within their limits."""
        total, forces = float(x @ (self.system.stiffness @ x / 2 - self.system.load)), []
        u = self.displacement(x)
        for springs in self.springs:
            stored, force, within = springs.forces(u)
            total += stored
            forces.append((force, within))
        return total, forces

    def minimised(self, x: Array) -> tuple[Array, list[Array]]:
        """Where the value is least, from ``x`` on, or where Newton's method comes to; the forces there."""
        stiffness, (value, forces) = self.system.stiffness, self.value(x)
        # else a body that only contact holds would have no step where nothing presses
        ground = ROUNDING * stiffness.diagonal().max() * sp.eye_array(x.size, format="csc")
        for _ in range(STEPS):
            gradient, matrix = stiffness @ x - self.system.load, stiffness + ground
            for springs, own in zip(self.springs, forces, strict=True):
                pull, own_stiffness = springs.pull(*own, x.size)
                gradient, matrix = gradient - pull, matrix + own_stiffness
            step = factorised(sp.csc_array(matrix))(-gradient)
            part, slope, trial = 1.0, gradient @ step, self.value(x + step)
            if -slope <= EXACT * abs(value):  # no value shows whether the last step is a gain
                return x + step, [force for force, _ in trial[1]]
            while trial[0] > value + 1e-4 * part * slope and part > ROUNDING:
                part /= 2
                trial = self.value(x + part * step)
            if not trial[0] < value:
                break
            x, (value, forces) = x + part * step, trial
        return x, [force for force, _ in forces]


def tightened(
    program: ContactSystem,
    state: Equilibrium,
    displacement: Callable[[Array], Array],
    springs: Sequence[Springs],
) -> tuple[Array, list[Array]]:
    """The unknowns (k,) of least energy, and the forces at the points of all springs.

    ``program`` has the energy without friction, ``state`` a solution with gaps and friction at nodes to begin
    with, ``displacement`` makes (components, nodes) of unknowns. Gaps hold up to rounding.
    """
    x, unit, left = state.u, program.stiffness.diagonal().max(), np.inf
    moved, forces = magnitude(displacement(x)), [part.shared(state) for part in springs]
    size = max([moved, *(magnitude(part.cells.distance) for part in springs)])
    bound = max([magnitude(part.limit) for part in springs if part.limit is not None], default=0.0)
    sliding = bound / (SLIP * moved) if moved > 0 < bound else unit

    def solved(most: float) -> tuple[Array, list[Array], float]:
        u, stiffnesses = displacement(x), [most if part.limit is None else sliding for part in springs]
        own = [part.at(u, f, k) for part, f, k in zip(springs, forces, stiffnesses, strict=True)]
        end, new = _Program(program, displacement, own).minimised(x)
        changes = [magnitude(f - old) / k for f, old, k in zip(new, forces, stiffnesses, strict=True)]
        return end, new, max(changes)

    is_interior = any(part.cells.are_triangles for part in springs)
    stages = STIFFNESSES[:IN_TRIANGLES] if is_interior else STIFFNESSES
    for times in (*stages, *stages[-1:] * REPEATS):
        before = left
        x, forces, left = solved(times * unit)
        sliding *= STIFFER
        if times == stages[-1] and (left <= EXACT * size or left > 0.9 * before):
            break
    # stiff springs multiply rounding of stretches
    return x, solved(unit)[1]
