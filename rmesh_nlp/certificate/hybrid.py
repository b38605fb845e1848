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
from rmesh_nlp.certificate.skeleton import Index, Skeleton
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.evaluation import Array


@dataclass(frozen=True)
class InteriorObstacle:
    """An obstacle in the interior; moments of the displacement of each element are further unknowns.

    Arrays run over Bernstein's polynomials on each element; moments are against these and divided by the
    area.
    """

    sign: float  # 1 for an obstacle below, -1 above
    gap: Array  # (elements, 3 or 6), moments of the gap of the base
    load: Array  # (elements, 3 or 6), coefficients of the source, times the area


@dataclass(frozen=True)
class Hybrid:
    """The contact problem of the traces, and what leads from its solution back to the elements.

    The sum of the forces through each edge is ``matrix @ W - source``. The traces of an element are numbered
    edge by edge, ends counter-clockwise and then the middle, component by component, then those of an
    obstacle in the interior.
    """

    skeleton: Skeleton
    conditions: Conditions
    system: ContactSystem  # in the traces that are not given; gaps of an obstacle in the interior first
    matrix: sp.csc_array  # (traces, traces)
    source: Array  # (traces,)
    numbers: Index  # (elements, k), the traces of each element
    turn: sp.csr_array  # (traces, traces), from Cartesian components to the axes of contact edges
    held: NDArray[np.bool_]  # (traces,), which are given
    start: Array  # (traces,), the base
    known: Array  # (traces,), the given ones, counted from the base
    applied: Array  # (traces,), applied forces
    inside: int  # number of gaps of an obstacle in the interior

    def traces(self, u: Array) -> Array:
        """All traces for the free ones."""
        W = self.known.copy()
        W[~self.held] = u
        return W

    def reaction(self, traces: Array) -> Array:
        """Sum of the forces through each edge, less the applied ones."""
        return np.asarray(self.matrix @ traces - self.source - self.applied)

    def of_elements(self, traces: Array) -> Array:
        """(elements, k) traces of each element, Cartesian."""
        return np.asarray((self.turn.T @ traces)[self.numbers])


def hybrid(
    skeleton: Skeleton,
    conditions: Conditions,
    local: tuple[Array, Array],
    base: Array,
    interior: InteriorObstacle | None = None,
) -> Hybrid:
    """Assemble the contact problem of the traces, counted from ``base`` (components, k, edges).

    Forces through the edges of an element are ``local[0] @ traces - local[1]``, with (elements, k, k) and
    (elements, k) arrays.
    """
    n, k, contact = conditions.held.shape[0], conditions.degree + 1, conditions.contact
    numbers, size = _numbers(skeleton, n, k), skeleton.ends.shape[1] * k * n
    turn: sp.sparray = _turn(conditions, skeleton.ends.shape[1])
    start = turn @ _vector(base)
    applied = turn @ _vector(conditions.applied * skeleton.lengths)
    given = turn @ _vector(conditions.given)
    held = np.abs(turn @ _vector(np.repeat(conditions.held[:, None], k, axis=1))) > 0.5
    added = np.zeros(0, dtype=np.int64)
    if interior is not None:
        added = size + np.arange(interior.load.size)
        numbers, none = np.hstack([numbers, added.reshape(interior.load.shape)]), np.zeros(added.size)
        start, given, held = np.append(start, none), np.append(given, none), np.append(held, none > 0)
        applied = np.append(applied, interior.load.ravel())
        turn = sp.block_diag([turn, sp.eye_array(added.size)])
    matrix = turn @ _assembled(numbers, local[0], held.size) @ turn.T
    source = turn @ np.bincount(numbers.ravel(), local[1].ravel(), held.size)
    fixed = np.where(held, given - start, 0.0)
    free = np.flatnonzero(~held)
    # contact on the boundary, function by function
    along = [_contact_traces(conditions, axis).ravel() for axis in range(n)]
    edge = np.tile(skeleton.lengths[contact], k)
    unit = sp.csr_array(sp.eye_array(held.size))[:, free]
    normals, gaps = unit[along[-1]], conditions.offset.ravel() + start[along[-1]]
    tangents, bound = unit[:0], np.zeros(0)
    if interior is not None:
        normals = sp.vstack([unit[added] * interior.sign, normals])
        gaps = np.concatenate([interior.gap.ravel(), gaps])
    elif np.any(conditions.friction > 0):
        tangents, bound = unit[along[0]], np.where(held[along[0]], 0.0, conditions.friction.ravel() * edge)
    load = (applied + source - matrix @ fixed)[free]
    matrix = sp.csc_array(matrix)
    stiffness = sp.csc_array(matrix[free][:, free])
    system = ContactSystem(stiffness, load, 0.0, sp.csr_array(normals), sp.csr_array(tangents), gaps, bound)
    return Hybrid(
        skeleton, conditions, system, matrix, source, numbers, turn, held, start, fixed, applied, added.size
    )


def contact_start(assembled: Hybrid) -> Array:
    """(k contact edges,) traces of the base along the first row of ``conditions.axes``, edges fastest."""
    return np.asarray(assembled.start[_contact_traces(assembled.conditions, 0).ravel()])


def _contact_traces(conditions: Conditions, axis: int) -> Index:
    """(k, contact edges) numbers of the traces along a row of ``conditions.axes``."""
    k = conditions.degree + 1
    along = k * conditions.contact + np.arange(k)[:, None]
    return np.asarray(along * conditions.held.shape[0] + axis, dtype=np.int64)


def _numbers(skeleton: Skeleton, components: int, k: int) -> Index:
    along = (k * skeleton.edges[:, None] + skeleton.places(k)) * components
    numbers = along[:, :, None] + np.arange(components)[:, None]
    return np.ascontiguousarray(numbers.reshape(3 * k * components, -1).T)


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
