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
from rmesh_nlp.certificate.fields import TraceFields
from rmesh_nlp.certificate.polynomials import moments
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.evaluation import Array, Index, Mask


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
    held: Mask  # (traces,), which are given
    start: Array  # (traces,), the base
    prescribed: Array  # (traces,), the given ones, counted from the base
    base: (
        Array  # that part of the base in the free traces, from zero in ``system``, along which friction acts
    )

    def of_displacement(self, u: Array) -> Array:
        """(traces,) those of a displacement with coefficients (components, nodes)."""
        return _of_displacement(self.turn, self.skeleton, self.conditions, u)

    def by_element(self, W: Array) -> Array:
        """(elements, k) traces (traces,) of each element, in Cartesian components."""
        return (self.turn.T @ W)[self.numbers]


def hybrid(conditions: Conditions, fields: TraceFields, computed: Array, u: Array) -> Hybrid:
    """Assemble the contact problem of the traces, counted from those of a displacement (components, nodes).

    ``computed`` is the field of this displacement, to which ``fields`` add what it lacks.
    """
    skeleton, inside, degree = fields.skeleton, conditions.inside, conditions.degree
    n, k = conditions.held.shape[0], degree + 1
    on_edges, lengths = skeleton.traces(n, k), skeleton.lengths
    turn, none = _turn(conditions, inside.offset.size), np.zeros(inside.offset.shape)
    edges, size = turn.shape[0] - none.size, turn.shape[0]
    added = np.arange(edges, size)
    numbers = np.hstack([on_edges, added.reshape(len(on_edges), -1)])

    start = _of_displacement(turn, skeleton, conditions, u)
    given = turned(turn, conditions.given, none)
    held = np.abs(turned(turn, np.repeat(conditions.held[:, None], k, axis=1), none)) > 0.5
    prescribed, free = np.where(held, given - start, 0.0), np.flatnonzero(~held)
    inside_load = (fields.load[0] * skeleton.areas)[:, inside.elements]
    load = turned(turn, conditions.traction.balanced * lengths, inside_load)
    load -= turn @ np.bincount(on_edges.ravel(), fields.forces(computed).ravel(), size)
    load += turn @ np.bincount(numbers.ravel(), fields.source.ravel(), size)
    count = numbers.shape[1]
    at = np.repeat(numbers, count, axis=1).ravel(), np.tile(numbers, count).ravel()
    of_elements = sp.csr_array((fields.stiffness.ravel(), at), shape=(size, size))
    matrix = sp.csc_array(turn @ of_elements @ turn.T)
    stiffness, rest = matrix[free][:, free], (load - matrix @ prescribed)[free]
    # contact inside, then on the boundary function by function
    touching = np.arange(edges).reshape(-1, k, n)[conditions.contact].T.reshape(n, -1)
    unit = sp.csr_array(sp.eye_array(size))[:, free]
    normals = sp.vstack([unit[added] * inside.sign, unit[touching[-1]]])
    gap = np.append(inside.offset.T.ravel(), conditions.offset.ravel()) + normals @ start[free]
    tangents, bound = unit[:0], np.zeros(0)
    if np.any(conditions.friction > 0):
        forces = conditions.friction * lengths[conditions.contact]
        tangents, bound = unit[touching[0]], np.where(held[touching[0]], 0.0, forces.ravel())
    # friction turns where the slip is zero, and traces are counted from those of the base
    slips = tangents.T @ start[touching[0]][: bound.size]
    system = ContactSystem(stiffness, rest + stiffness @ slips, 0.0, normals, tangents, gap, bound)
    return Hybrid(skeleton, conditions, system, matrix, load, numbers, turn, held, start, prescribed, slips)


def turned(turn: sp.csr_array, along: NDArray, within: NDArray) -> Array:
    """(traces,) of moments along edges (components, k, edges) and inside (functions, m)."""
    return turn @ np.concatenate([along.T.ravel(), within.T.ravel()])


def _of_displacement(turn: sp.csr_array, skeleton: Skeleton, conditions: Conditions, u: Array) -> Array:
    """See :meth:`Hybrid.of_displacement`."""
    inside, degree = skeleton.displaced[:, conditions.inside.elements], conditions.degree
    along = moments(u[:, skeleton.along(skeleton.order)], degree)
    return turned(turn, along, moments(u[:1, inside], degree, 3))


def _turn(conditions: Conditions, added: int) -> sp.csr_array:
    """From Cartesian components to the axes of contact edges; the last ``added`` traces are inside."""
    k, (n, edges) = conditions.degree + 1, conditions.held.shape
    blocks = np.tile(np.eye(n), (edges, 1, 1))
    blocks[conditions.contact] = conditions.axes
    data = np.concatenate([np.repeat(blocks, k, axis=0), np.ones((added, n, n))])
    turn = sp.csr_array(sp.bsr_array((data, np.arange(len(data)), np.arange(len(data) + 1))))
    turn.eliminate_zeros()
    return turn
