"""The contact problem of the traces, which the elements leave when their stresses are eliminated.

Traces W of the displacement on the edges are the multipliers of equilibrium between the elements.
In them the dual energy is

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0,

a contact problem of the same form as that of the nodes; its multipliers are the contact forces.

On each edge the traces are the moments of each component of the displacement against Bernstein's
polynomials, those of its ends first, divided by the length. On contact edges the components are those along
the obstacle's tangent and normal, elsewhere x and y. The multiplier of such a moment is a coefficient of the
contact pressure times the length: where none is negative the pressure is nowhere negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.fields import Fields
from rmesh_nlp.certificate.polynomials import Index, moments
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.evaluation import Array


@dataclass(frozen=True)
class Hybrid:
    """The contact problem of the traces, and what leads from its solution back to the elements.

    The sum of the forces through each edge, less the applied ones, is ``matrix @ W - load``. The traces are
    numbered edge by edge, function by function, component by component, then those on an obstacle in the
    interior, element by element.
    """

    skeleton: Skeleton
    conditions: Conditions
    system: ContactSystem  # in the traces that are not given; gaps of an obstacle in the interior first
    matrix: sp.csc_array  # (traces, traces)
    load: Array  # (traces,)
    numbers: Index  # (elements, k), the traces of each element
    turn: sp.csr_array  # (traces, traces), from Cartesian components to the axes of contact edges
    held: NDArray[np.bool_]  # (traces,), which are given
    start: Array  # (traces,), the base
    known: Array  # (traces,), the given ones, counted from the base
    inside: int  # number of gaps of an obstacle in the interior


def hybrid(conditions: Conditions, fields: Fields, computed: Array, u: Array) -> Hybrid:
    """Assemble the contact problem of the traces, counted from those of a displacement (components, nodes).

    ``computed`` is the field of this displacement, to which ``fields`` add what it lacks.
    """
    skeleton, contact, inside = fields.skeleton, conditions.contact, conditions.inside
    n, k = conditions.held.shape[0], conditions.degree + 1
    numbers, size = skeleton.traces(n, k), skeleton.ends.shape[1] * k * n
    turn: sp.sparray = _turn(conditions, skeleton.ends.shape[1])
    exerted = np.bincount(numbers.ravel(), fields.forces(computed).ravel(), size)
    load = turn @ (_vector(conditions.traction.balanced * skeleton.lengths) - exerted)
    start = turn @ _vector(moments(u[:, skeleton.along(skeleton.order)], conditions.degree))
    given = turn @ _vector(conditions.given)
    held = np.abs(turn @ _vector(np.repeat(conditions.held[:, None], k, axis=1))) > 0.5
    added = np.zeros(0, dtype=np.int64)
    if fields.reacts:
        of_base = moments(u[0, skeleton.displaced], conditions.degree, 3).T
        added = size + np.arange(of_base.size)
        numbers, none = np.hstack([numbers, added.reshape(of_base.shape)]), np.zeros(added.size)
        start, given, held = np.append(start, of_base), np.append(given, none), np.append(held, none > 0)
        load = np.append(load, (fields.load[0] * skeleton.areas).T)
        turn = sp.block_diag([turn, sp.eye_array(added.size)])
    matrix = turn @ _assembled(numbers, fields.stiffness, held.size) @ turn.T
    load = load + turn @ np.bincount(numbers.ravel(), fields.source.ravel(), held.size)
    known = np.where(held, given - start, 0.0)
    free = np.flatnonzero(~held)
    # contact on the boundary, function by function
    along = [_contact_traces(conditions, axis).ravel() for axis in range(n)]
    unit = sp.csr_array(sp.eye_array(held.size))[:, free]
    normals, gaps = unit[along[-1]], conditions.offset.ravel() + start[along[-1]]
    tangents, bound = unit[:0], np.zeros(0)
    if fields.reacts:
        normals = sp.vstack([unit[added] * inside.sign, normals])
        gaps = np.append(inside.offset.T + inside.sign * of_base, gaps)
    elif np.any(conditions.friction > 0):
        forces = conditions.friction * skeleton.lengths[contact]
        tangents, bound = unit[along[0]], np.where(held[along[0]], 0.0, forces.ravel())
    matrix = sp.csc_array(matrix)
    stiffness, rest = sp.csc_array(matrix[free][:, free]), (load - matrix @ known)[free]
    system = ContactSystem(stiffness, rest, 0.0, sp.csr_array(normals), sp.csr_array(tangents), gaps, bound)
    return Hybrid(skeleton, conditions, system, matrix, load, numbers, turn, held, start, known, added.size)


def contact_start(assembled: Hybrid) -> Array:
    """(k contact edges,) traces of the base along the first row of ``conditions.axes``, edges fastest."""
    return np.asarray(assembled.start[_contact_traces(assembled.conditions, 0).ravel()])


def _contact_traces(conditions: Conditions, axis: int) -> Index:
    """(k, contact edges) numbers of the traces along a row of ``conditions.axes``."""
    k = conditions.degree + 1
    along = k * conditions.contact + np.arange(k)[:, None]
    return np.asarray(along * conditions.held.shape[0] + axis, dtype=np.int64)


def _vector(field: NDArray) -> Array:
    """A field (components, k, edges), Cartesian, as a vector of traces or forces."""
    return np.ascontiguousarray(field.transpose(2, 1, 0), dtype=float).ravel()


def _turn(conditions: Conditions, edges: int) -> sp.csr_array:
    n, k = conditions.held.shape[0], conditions.degree + 1
    blocks = np.tile(np.eye(n), (edges, 1, 1))
    blocks[conditions.contact] = conditions.axes
    data = np.repeat(blocks, k, axis=0)
    rows = sp.bsr_array((data, np.arange(k * edges), np.arange(k * edges + 1)))
    turn = sp.csr_array(rows)
    turn.eliminate_zeros()
    return turn


def _assembled(numbers: Index, S: Array, size: int) -> sp.csr_array:
    """Sum of element matrices (elements, k, k) over their numbers (elements, k)."""
    row = np.broadcast_to(numbers[:, :, None], S.shape).ravel()
    column = np.broadcast_to(numbers[:, None, :], S.shape).ravel()
    return sp.csr_array(sp.coo_array((S.ravel(), (row, column)), shape=(size, size)))
