"""The admissible displacement of least energy on a mesh.

Nodes that keep off a foundation by the largest height beside them keep off by more than they must. Here the
gap is imposed at points within contact edges (triangles), which are added until none is violated:

    min 1/2 u K u - F u + sum_i b_i s_i   with   g_k(u) = a_k . u + c_k >= 0,   s_i >= |t_i . u|,

a convex quadratic program, which Ipopt solves in units of a length and of a force.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.assessment.standoff import Cells
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status

Index = NDArray[np.int64]

TOLERANCE = 1e-12
"""Of Ipopt: multiplier times gap, so that what is open presses by a billionth of the load."""

ROUNDS = 30
"""Programs, each with the worst points of the last solution added."""


def tightened(
    system: ContactSystem, state: Equilibrium, cells: Sequence[Cells], field: Field
) -> Equilibrium | None:
    """The admissible displacement of least energy from an admissible one; None if it is not found.

    The friction of ``system`` is regarded, its gaps are not. ``field`` (components, nodes) is the
    displacement as a function of the unknowns. The forces at points are shared among their nodes; a node
    touches where its share is positive.
    """
    u, chosen, slips = state.u, _closed(cells, field.values(state.u), state), _slips(system)
    length = float(np.max(np.abs(u), initial=0.0) + np.max(np.abs(system.offset), initial=1e-300))
    for _ in range(ROUNDS):
        # the points keep off by a little more, so that rounding violates nothing
        points = _points(cells, chosen, field, ROUNDING * length, u)
        minimiser = _minimised(system, points, slips, u, length)
        if minimiser is None:
            return None
        u = minimiser.u
        violated = _violated(cells, field.values(u))
        if not violated.size:
            force, of_closed = np.zeros((2, system.offset.size))
            pressing = minimiser.pressing
            for number, part in enumerate(cells):
                own = chosen[0] == number
                _, cell, point = chosen[:, own]
                part.share(force, cell, point, pressing[own])
                part.share(of_closed, cell, point, (pressing * minimiser.closed)[own])
            active = ActiveSet(of_closed > 0, minimiser.sliding)
            return Equilibrium(u, system.energy(u), force, minimiser.friction, active, Status.CONVERGED, 1)
        chosen = np.unique(np.hstack([chosen, violated]), axis=1)  # in the order of the parts
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


class _Minimiser(NamedTuple):
    """Displacement, forces at the points and which are closed, friction and slip directions at nodes."""

    u: Array
    pressing: Array
    closed: NDArray[np.bool_]
    friction: Array
    sliding: NDArray[np.int8]


def _minimised(
    system: ContactSystem, points: _Points, slips: _Slips, start: Array, length: float
) -> _Minimiser | None:
    """The solution of the program with some points; None if Ipopt finds none.

    A point is closed, and a node slides, where the multiplier is larger than the distance, and vice versa.
    """
    m, n, force = start.size, slips.number.size, system.force_scale
    x = ca.MX.sym("x", m + n)
    u, s = x[:m], x[m:]
    K, A, T = (_constant(rows) for rows in (system.stiffness * (length / force), points.rows, slips.rows))
    f = ca.bilin(K, u, u) / 2 - ca.dot(system.load / force, u) + ca.dot(slips.bound / force, s)
    g = ca.vertcat(A @ u + points.gap / length, s - T @ u, s + T @ u)
    free, size = np.full(m + n, np.inf), points.gap.size + 2 * n
    program = NLP(x, ca.MX(0, 1), f, g, -free, free, np.zeros(size), np.full(size, np.inf))
    guess = np.append(start, np.abs(slips.rows @ start)) / length
    result = Solver(program, options={"tol": TOLERANCE})(guess)
    if not result.converged:
        return None
    ends = [points.gap.size, points.gap.size + n]
    (gap, _, _), (pressing, below, above) = np.split(result.g, ends), np.split(-result.lam_g, ends)
    friction, sliding = np.zeros(system.slip_bound.size), np.zeros(system.slip_bound.size, dtype=np.int8)
    friction[slips.number] = force * (above - below)
    slides = np.minimum(below, above) < result.x[m:]
    sliding[slips.number] = np.where(slides, np.sign(below - above), 0)
    return _Minimiser(length * result.x[:m], force * pressing, pressing > gap, friction, sliding)


def _constant(matrix: sp.sparray) -> ca.DM:
    columns = sp.csc_array(matrix)
    columns.sort_indices()
    pattern = ca.Sparsity(*columns.shape, columns.indptr.tolist(), columns.indices.tolist())
    return ca.DM(pattern, columns.data.tolist())


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


def _violated(cells: Sequence[Cells], displacement: Array) -> Index:
    """(3, n) the worst points of cells where the gap is violated."""
    violated = [np.zeros((3, 0), dtype=np.int64)]
    for number, part in enumerate(cells):
        gap = part.gaps(displacement)
        cell = np.flatnonzero(np.min(gap, axis=1) < 0)
        violated.append(np.stack([np.full(cell.size, number), cell, np.argmin(gap[cell], axis=1)]))
    return np.hstack(violated)


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
