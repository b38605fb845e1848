"""The admissible displacement of least energy on a mesh.

Nodes that keep off a foundation by the largest height beside them keep off by more than they must. Here the
gap is imposed at points within contact edges (triangles), which are added until none is violated:

    min 1/2 u K u - F u + sum_i b_i s_i   with   g_k(u) = a_k . u + c_k >= 0,   s_i >= |t_i . u|,

a convex quadratic program, which Ipopt solves in units of a length and of a force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.standoff import Cells
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, constant_of, magnitude
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.optimize.nlp import NLP, Derivatives
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status

QUADRATIC = {
    "tol": 1e-12,  # multiplier times gap, so that what is open presses by a billionth of the load
    **dict.fromkeys(("hessian_constant", "jac_c_constant", "jac_d_constant"), "yes"),
}
"""Ipopt's options."""


def tightened(
    system: ContactSystem, state: Equilibrium, cells: Sequence[Cells], field: Field
) -> Equilibrium | None:
    """The admissible displacement of least energy from an admissible one; None if it is not found.

    The friction of ``system`` is regarded, its gaps are not. ``field`` (components, nodes) is the
    displacement as a function of the unknowns. The forces at points are shared among their nodes; a node
    touches where its share is positive.
    """
    length = float(magnitude(state.u) + np.max(np.abs(system.offset), initial=1e-300))
    acted = [field.index[np.any(part.normals != 0, axis=(1, 2))][:, part.nodes].ravel() for part in cells]
    u, last = state.u, np.unique(np.concatenate([system.tangents[: system.slip_bound.size].indices, *acted]))
    last = last[last >= 0]
    program = system.condensed(last)
    if program is None:
        program, last = system, np.arange(u.size)
    chosen, off = _worst(cells, field.values(u), state.normal_force), ROUNDING * length
    while True:  # each program has more of finitely many points than the last one, or keeps off farther
        rows, gap = _points(cells, chosen, field, u)
        result = _minimised(program, rows[:, last], gap - off, u[last], length)
        if result is None:
            return None
        contact, pressing, is_closed = result
        u = np.zeros(u.size)  # of the others no gap depends
        u[last] = contact.u
        violated = _worst(cells, field.values(u))
        if not violated.size:
            break
        before, chosen = chosen, np.unique(np.hstack([chosen, violated]), axis=1)  # in the order of the parts
        if chosen.shape == before.shape:  # the gap falls more between points than it did
            off *= 10
    force, of_closed = np.zeros((2, system.offset.size))
    for number, part in enumerate(cells):
        own = chosen[0] == number
        _, cell, point = chosen[:, own]
        part.share(force, cell, point, pressing[own])
        part.share(of_closed, cell, point, (pressing * is_closed)[own])
    if last.size < u.size:
        push = np.zeros(u.size)
        push[last] = program.stiffness @ contact.u - program.load
        u = factorised(system.stiffness)(system.load + push)
    active = replace(contact.active, touching=of_closed > 0)
    return replace(contact, u=u, energy=system.energy(u), normal_force=force, active=active)


def _minimised(
    system: ContactSystem, rows: sp.csr_array, gap: Array, start: Array, length: float
) -> tuple[Equilibrium, Array, Mask] | None:
    """The solution of the program with forces at points in the place of nodes, and which of these are closed.

    ``rows`` (points, n_u) are those of the gaps, ``gap`` (points,) these at zero displacement. A point is
    closed, and a node slides, where the multiplier is larger than the distance, and vice versa. None if Ipopt
    finds none.
    """
    slips, force, m = np.flatnonzero(system.rotated.slips), system.force_scale, start.size
    tangents, one, zero = system.tangents[slips], sp.eye_array(slips.size), np.zeros(slips.size)
    hessian = sp.block_diag([system.stiffness * (length / force), 0 * one])
    linear = np.append(-system.load, system.slip_bound[slips]) / force
    matrix = sp.block_array([[rows, None], [-tangents, one], [tangents, one]])
    program = _quadratic(hessian, linear, matrix, np.concatenate([gap / length, zero, zero]))
    result = Solver(program, options=QUADRATIC)(np.append(start, np.abs(tangents @ start)) / length)
    if not result.converged:
        return None
    ends = [gap.size, gap.size + slips.size]
    (distance, *_), (pressing, below, above) = np.split(result.g, ends), np.split(-result.lam_g, ends)
    tangential, sliding = np.zeros(system.slip_bound.size), np.zeros(system.slip_bound.size, dtype=np.int8)
    tangential[slips] = force * (above - below)
    slides = np.minimum(below, above) < result.x[m:]
    sliding[slips] = np.where(slides, np.sign(below - above), 0)
    u, nothing = length * result.x[:m], np.zeros(system.offset.size)
    active = ActiveSet(nothing > 0, sliding)
    state = Equilibrium(u, system.energy(u), nothing, tangential, active, Status.CONVERGED, 1)
    return state, force * pressing, pressing > distance


def _quadratic(hessian: sp.sparray, linear: Array, matrix: sp.sparray, constant: Array) -> NLP:
    """``min x H x / 2 + l x`` with ``A x + c >= 0``, and derivatives, which CasADi needs longer to find."""
    x, p, lam_f = ca.MX.sym("x", linear.size), ca.MX(0, 1), ca.MX.sym("lam_f")
    H, A = constant_of(hessian), constant_of(matrix)
    f, g, slope = ca.dot(H @ x / 2 + linear, x), A @ x + constant, H @ x + linear
    derivatives = Derivatives(
        ca.Function("slope", [x, p], [f, slope]),
        ca.Function("jacobian", [x, p], [g, A]),
        ca.Function("hessian", [x, p, lam_f, ca.MX.sym("lam_g", constant.size)], [lam_f * ca.triu(H)]),
    )
    free, rows = np.full(linear.size, np.inf), np.full(constant.size, np.inf)
    return NLP(x, p, f, g, -free, free, 0 * constant, rows, derivatives)


def _worst(cells: Sequence[Cells], displacement: Array, force: Array | None = None) -> Index:
    """(3, n) part, cell and point of least gap of the cells where it is violated.

    With normal forces (gaps,) of all cells whose nodes press on the foundation.
    """
    points = []
    for number, part in enumerate(cells):
        gap = part.gaps(displacement)
        cell = np.flatnonzero(np.min(gap, axis=1) < 0 if force is None else part.pressed(force))
        points.append(np.stack([np.full(cell.size, number), cell, np.argmin(gap[cell], axis=1)]))
    return np.hstack(points)


def _points(cells: Sequence[Cells], chosen: Index, field: Field, u: Array) -> tuple[sp.csr_array, Array]:
    """Rows (points, n_u) of the gaps at the chosen points, and these (points,) at zero unknowns.

    They are less by what they fall between points if the displacement is near u.
    """
    rows, gaps, displacement = [], [], field.values(u)
    for number, part in enumerate(cells):
        cell, point = chosen[1:, chosen[0] == number]
        nodes = part.nodes[:, cell]
        weight = part.normals[:, cell, point][:, None] * part.shares[:, point]  # (components, v, m)
        index = field.index[:, nodes]
        free, row = index >= 0, np.broadcast_to(np.arange(cell.size), index.shape)
        rows.append(sp.csr_array((weight[free], (row[free], index[free])), shape=(cell.size, u.size)))
        given = np.where(free, 0.0, weight * field.offset[:, nodes]).sum(axis=(0, 1))
        low = part.low - part.dips(displacement)
        gaps.append(given + low[cell, point])
    return sp.vstack(rows), np.concatenate(gaps)
