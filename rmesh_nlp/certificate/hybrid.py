"""The contact problem of the traces, which the elements leave when their stresses are eliminated.

Traces W of the displacement on the edges are the multipliers of equilibrium between the elements.
In them the dual energy is

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0,

a contact problem of the same form as that of the nodes; its multipliers are the contact forces.

On each edge the traces are the moments of each component of the displacement against Bernstein's
polynomials, those of its ends first, divided by the length. On contact edges the components are those along
the obstacle's tangent and normal, elsewhere x and y. The multiplier of such a moment is a coefficient of the
contact pressure times the length: where none is negative the pressure is nowhere negative. Traces of a pair
count less those of its other edge, those on a tool less its displacement, an unknown with its force as load.
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
    interior, element by element, then displacements of tools.
    """

    skeleton: Skeleton
    conditions: Conditions
    system: ContactSystem  # in the traces that are not given; gaps of an obstacle in the interior first
    normals: sp.csr_array  # (gaps, traces), those of the system with the given traces
    tangents: sp.csr_array  # of the same gaps, with friction or without; zero of those in the interior
    matrix: sp.csc_array  # (traces, traces)
    applied: Array  # (traces,), the given forces on edges and tools
    load: Array  # (traces,)
    numbers: Index  # (elements, k), the traces of each element
    axes: sp.csr_array  # (traces, traces), from Cartesian components to the axes of contact edges
    turn: sp.csr_array  # the same of forces: the transpose of its inverse
    held: Mask  # (traces,), which are given
    start: Array  # (traces,), those of the displacement from which W is counted
    base: Array  # (traces,), those from which the system counts; along friction they do not slip

    def of_displacement(self, u: Array) -> Array:
        """(traces,) those of a displacement with coefficients (components, nodes)."""
        return _of_displacement(self.axes, self.skeleton, self.conditions, u)

    def by_element(self, W: Array) -> Array:
        """(elements, k) traces (traces,) of each element, in Cartesian components."""
        return (self.turn.T @ W)[self.numbers]


def hybrid(conditions: Conditions, fields: TraceFields, computed: Array, u: Array) -> Hybrid:
    """Assemble the contact problem of the traces, counted from those of a displacement (components, nodes).

    ``computed`` is the field of this displacement, to which ``fields`` add what it lacks.
    """
    skeleton, inside, space = fields.skeleton, conditions.inside, fields.skeleton.space
    (n, k, _), problem = conditions.given.shape, space.problem
    on_edges, lengths, none = skeleton.traces(n, k), skeleton.lengths, np.zeros(inside.offset.shape)
    kept = none.size + n * len(problem.tools)
    blocks = conditions.axes.reshape(-1, n * k, n * k)
    axes, turn = (
        _turn(conditions, each, kept) for each in (blocks, np.linalg.inv(blocks).transpose(0, 2, 1))
    )
    edges, size = n * k * lengths.size, turn.shape[0]
    added = np.arange(edges, edges + none.size)
    numbers = np.hstack([on_edges, added.reshape(len(on_edges), -1)])

    start = _of_displacement(axes, skeleton, conditions, u)
    held = np.repeat(conditions.held[:, None], k, axis=1)
    held = np.abs(turned(axes, held, none, problem.tools_held)) > 0.5
    base, free = np.where(held, turned(axes, conditions.given), start), np.flatnonzero(~held)
    on_tools = np.reshape([force for _, force in space.forces], (-1, n)).T
    applied = turned(turn, conditions.traction.balanced * lengths, none, on_tools)
    load = applied.copy()
    load[added] += (fields.load[0] * skeleton.areas)[:, inside.elements].T.ravel()
    load -= turn @ np.bincount(on_edges.ravel(), fields.forces(computed).ravel(), size)
    load += turn @ np.bincount(numbers.ravel(), fields.source.ravel(), size)
    count = numbers.shape[1]
    at = np.repeat(numbers, count, axis=1).ravel(), np.tile(numbers, count).ravel()
    of_elements = sp.csr_array((fields.stiffness.ravel(), at), shape=(size, size))
    matrix = sp.csc_array(turn @ of_elements @ turn.T)
    # contact inside, then on the boundary function by function
    along = jumps(skeleton, conditions)
    normals = sp.csr_array(sp.vstack([sp.csr_array(sp.eye_array(size))[added] * inside.sign, along[-1]]))
    gap = np.append(inside.offset.T.ravel(), conditions.offset.ravel()) + normals @ base
    tangents = sp.vstack([sp.csr_array((none.size, size)), along[0]], "csr")
    rubs = np.any(conditions.friction + conditions.coulomb > 0)
    own = tangents @ sp.diags_array((rubs & ~held & (np.arange(size) < edges)).astype(float))
    share, loads = own.power(2).sum(axis=1), conditions.friction * lengths[conditions.contact]
    bound, coulomb = (np.where(share > 0, np.append(none, each), 0.0) for each in (loads, conditions.coulomb))
    # friction turns where the slip is zero
    base = base - own.T @ (tangents @ base / np.maximum(share, 1.0))
    motions = space.rigid_motions(skeleton.nodes)
    rigid = [_of_displacement(axes, skeleton, conditions, motion)[free] for motion in motions]
    system = ContactSystem(
        matrix[:, free][free],
        (load - matrix @ (base - start))[free],
        0.0,
        normals[:, free],
        tangents[:, free],
        gap,
        bound,
        np.full(gap.size, rubs),
        rigid=np.stack(rigid, axis=1) if rigid else None,
        coulomb=None if problem.has_energy else coulomb,
    )
    forces = system, normals, tangents, matrix, applied, load
    return Hybrid(skeleton, conditions, *forces, numbers, axes, turn, held, start, base)


def turned(turn: sp.csr_array, *parts: NDArray) -> Array:
    """(traces,) of moments along edges (components, k, edges), inside (functions, m) and of tools.

    The last ones are (components, tools) displacements or forces; what is left out is zero.
    """
    values = np.concatenate([part.T.ravel() for part in parts])
    return turn @ np.pad(values, (0, turn.shape[0] - values.size))


def jumps(skeleton: Skeleton, conditions: Conditions) -> list[sp.csr_array]:
    """Rows (k contact edges, traces), a matrix for each axis: traces less those of what is met.

    They run function by function.
    """
    tools, (n, k, edges) = skeleton.body.problem.tools, conditions.given.shape
    number, shape = np.arange(n * k * edges).reshape(edges, k, n).T, (n, k, conditions.contact.size)
    met, moved = np.full(shape, -1), np.zeros((*shape, len(tools), n))
    for part in conditions.parts:
        others = number[:, :, part.others]
        others[:, :2] = np.where(part.reversed, others[:, 1::-1], others[:, :2])
        met[:, :, part.place][:, :, : part.others.size] = others
        if part.number in tools:  # the moments of a constant
            axes = np.mean(conditions.axes[part.place], axis=3)
            moved[:, :, part.place, tools.index(part.number)] = axes.transpose(2, 1, 0, 3)
    count = number.size + conditions.inside.offset.size
    trace = sp.csr_array(sp.eye_array(count + 1, count))  # the last one is of nothing
    own = number[:, :, conditions.contact]
    return [
        sp.csr_array(sp.hstack([trace[a.ravel()] - trace[b.ravel()], -c.reshape(a.size, n * len(tools))]))
        for a, b, c in zip(own, met, moved, strict=True)
    ]


def _of_displacement(axes: sp.csr_array, skeleton: Skeleton, conditions: Conditions, u: Array) -> Array:
    """See :meth:`Hybrid.of_displacement`."""
    space, tools = skeleton.space, u[:, skeleton.space.n_nodes :]
    inside = space.elements[:, conditions.inside.elements]
    return turned(axes, moments(u[:, skeleton.along]), moments(u[:1, inside], 3), tools)


def _turn(conditions: Conditions, blocks: Array, kept: int) -> sp.csr_array:
    """From Cartesian components to the axes of contact edges by ``blocks``; the last ``kept`` traces stay."""
    n, k, edges = conditions.given.shape
    count, size = edges - -kept // (n * k), n * k * edges + kept
    data = np.tile(np.eye(n * k), (count, 1, 1))
    data[conditions.contact] = blocks
    ends = np.arange(n * k).reshape(k, n)
    ends[:2] = ends[1::-1]
    for part in conditions.parts:
        own = blocks[part.place][: part.others.size]
        turned_round = own[:, ends.ravel()[:, None], ends.ravel()]
        data[part.others] = np.where(part.reversed[:, None, None], turned_round, own)
    turn = sp.csr_array(sp.bsr_array((data, np.arange(count), np.arange(count + 1))))[:size, :size]
    turn.eliminate_zeros()
    return turn
