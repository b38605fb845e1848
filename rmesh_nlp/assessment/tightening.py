"""The admissible displacement of least energy on a mesh.

Nodes that keep off a foundation by the largest height beside them keep off by more than they must. Here the
gap is imposed at all points within contact edges (triangles) at once, by springs of stiffness k,

    min 1/2 u K u - F u + sum_p k/2 max(d - g_p(u), 0)^2 + sum_i b_i |t_i . u|,   g_p(u) = a_p . u + c_p,

and friction by springs that slide: ``b |s|`` is ``k s^2 / 2`` near 0. Newton's method, for stiffer and
stiffer springs, ends where it does not change which are pressed and which slide. At last the points keep off
by d, a little more than they give way (M. Hintermueller, K. Kunisch, Path-following methods for a class of
constrained minimization problems in function space, SIAM J. Optim. 17 (2006) 159-187).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.standoff import Cells
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array, Index
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.optimize.status import Status

STIFFNESSES = tuple(10.0**k for k in range(7))
"""Of the springs, in units of the largest entry of K."""

STEPS, REPEATS = 50, 10
"""Most steps of Newton's method with springs of one stiffness, and times that the points keep off farther."""


@dataclass(frozen=True)
class _Springs:
    """Those at the points of the cells and at the nodes that may slip, of one stiffness."""

    program: ContactSystem
    cells: Sequence[Cells]
    places: Sequence[Index]  # (m, components, v) of the unknowns of each cell of a part, -1 of none
    displacement: Callable[[Array], Array]
    stiffness: float = 1.0
    dips: Sequence[Array] = ()  # (m, k) of each part
    distance: float = 0.0

    def forces(self, u: Array) -> tuple[float, Array, list[Array]]:
        """The value that is minimised, friction (slips,), and pressures (m, k) at the points of each part."""
        program, k, x = self.program, self.stiffness, self.displacement(u)
        slip = program.tangents[: program.slip_bound.size] @ u
        friction = np.clip(k * slip, -program.slip_bound, program.slip_bound)
        pushes = [
            k * np.maximum(self.distance + dip - part.along(x) - part.low, 0.0)
            for part, dip in zip(self.cells, self.dips, strict=True)
        ]
        stored = sum(np.vdot(push, push) for push in pushes) - friction @ friction
        energy = u @ (program.stiffness @ u / 2 - program.load) + friction @ slip
        return energy + stored / (2 * k), friction, pushes

    def linearised(
        self, u: Array, friction: Array, pushes: Sequence[Array]
    ) -> tuple[Array, sp.csc_array, bytes]:
        """Gradient, second derivatives, and a name of the springs that act."""
        program, k = self.program, self.stiffness
        sticks, tangents = np.abs(friction) < program.slip_bound, program.tangents[: friction.size]
        gradient = program.stiffness @ u - program.load + tangents.T @ friction
        parts, names = [k * (tangents[sticks].T @ tangents[sticks])], [sticks.tobytes()]
        for part, places, push in zip(self.cells, self.places, pushes, strict=True):
            pressed = push > 0
            own = np.flatnonzero(np.any(pressed, axis=1))
            ways = np.einsum("cmk,vk->mcvk", part.normals[:, own], part.shares)
            ways = ways.reshape(own.size, places[0].size, push.shape[1])
            at = places[own].reshape(ways.shape[:2])
            local = k * (ways * pressed[own, None]) @ ways.swapaxes(1, 2)
            row, column = (np.broadcast_to(each, local.shape) for each in (at[:, :, None], at[:, None]))
            kept = (row >= 0) & (column >= 0)
            parts.append(
                sp.csc_array((local[kept], (row[kept], column[kept])), shape=program.stiffness.shape)
            )
            np.subtract.at(gradient, at[at >= 0], (ways @ push[own, :, None])[..., 0][at >= 0])
            names.append(pressed.tobytes())
        return gradient, sp.csc_array(sum(parts, program.stiffness)), b"".join(names)

    def at(self, u: Array, **changes: Any) -> _Springs:
        """With other numbers, and what displacements fall by between the points as about ``u``."""
        return replace(self, dips=[part.dips(self.displacement(u)) for part in self.cells], **changes)

    def minimised(self, u: Array) -> Array:
        """Where the value is least, from ``u`` on, or where Newton's method comes to."""
        value, friction, pushes = self.forces(u)
        gradient, matrix, name = self.linearised(u, friction, pushes)
        for _ in range(STEPS):
            try:
                step = factorised(matrix)(-gradient)
            except RuntimeError:  # singular: nothing presses, and only contact holds the body
                break
            part, slope, before, trial = 1.0, gradient @ step, (value, name), self.forces(u + step)
            while trial[0] > value + 1e-4 * part * slope and part > ROUNDING:
                part /= 2
                trial = self.forces(u + part * step)
            u, (value, friction, pushes) = u + part * step, trial
            gradient, matrix, name = self.linearised(u, friction, pushes)
            if value >= before[0] or (name == before[1] and part == 1):
                break
        return u


def tightened(
    system: ContactSystem, state: Equilibrium, cells: Sequence[Cells], field: Field
) -> Equilibrium | None:
    """The admissible displacement of least energy from an admissible one; None if it is not found.

    The friction of ``system`` is regarded, its gaps are not. ``field`` (components, nodes) is the
    displacement as a function of the unknowns. The forces at points are shared among their nodes; a node
    touches where its share is positive.
    """
    n, indices = state.u.size, [np.moveaxis(field.index[:, part.nodes], 2, 0) for part in cells]
    acted = [
        index[np.any(part.normals != 0, axis=2).T].ravel() for part, index in zip(cells, indices, strict=True)
    ]
    last = np.unique(np.concatenate([system.tangents[: system.slip_bound.size].indices, *acted]))
    last = last[last >= 0]
    program = system.condensed(last)
    if program is None:
        program, last = system, np.arange(n)
    place = np.full(n + 1, -1)  # the last one is that of no unknown
    place[last] = np.arange(last.size)

    def displacement(x: Array) -> Array:
        u = np.zeros(n)  # of the others no gap depends
        u[last] = x
        return field.values(u)

    x, unit = state.u[last], np.max(program.stiffness.diagonal())
    # else a body that only contact holds would have no step where nothing presses
    ground = ROUNDING * unit * sp.eye_array(last.size, format="csc")
    program = replace(program, stiffness=program.stiffness + ground)
    springs = _Springs(program, cells, [place[index] for index in indices], displacement)
    for times in STIFFNESSES:
        springs = springs.at(x, stiffness=times * unit)
        x = springs.minimised(x)
    for _ in range(REPEATS):
        least = min(np.min(part.gaps(displacement(x))) for part in cells)
        if least >= 0:
            return _equilibrium(system, springs, x, last)
        springs = springs.at(x, distance=springs.distance - 2 * least)
        x = springs.minimised(x)
    return None


def _equilibrium(system: ContactSystem, springs: _Springs, x: Array, last: Index) -> Equilibrium:
    """All unknowns with those that contact acts on, and the forces at the nodes."""
    program, u, push = springs.program, x, np.zeros(system.load.size)
    if last.size < push.size:
        push[last] = program.stiffness @ x - program.load
        u = factorised(system.stiffness)(system.load + push)
    _, friction, pushes = springs.forces(x)
    force, sliding = np.zeros(system.offset.size), np.abs(friction) >= program.slip_bound
    for part, pressures in zip(springs.cells, pushes, strict=True):
        free = part.rows >= 0
        np.add.at(force, part.rows[free], (part.shares @ pressures.T)[free])
    active = ActiveSet(force > 0, (sliding * np.sign(friction)).astype(np.int8))
    return Equilibrium(u, system.energy(u), force, -friction, active, Status.CONVERGED, 1)
