"""The contact problem of the traces, which the elements leave when their stresses are eliminated.

Traces W of the displacement on the edges are the multipliers of equilibrium between the elements.
In them the dual energy is

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0,

a contact problem of the same form as that of the nodes; its multipliers are the contact forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions, linear_values
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.evaluation import Array

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class TraceSpace:
    """Moments of the displacement on the edges, numbered.

    For each end of an edge the moments of each component against the linear function of that end,
    divided by the length. On contact edges the components are those along the obstacle's tangent and
    normal, elsewhere x and y.
    """

    skeleton: Skeleton
    conditions: Conditions

    @property
    def components(self) -> int:
        """Displacement components."""
        return int(self.conditions.held.shape[0])

    @property
    def size(self) -> int:
        """Number of traces."""
        return int(self.skeleton.ends.shape[1] * 2 * self.components)

    @cached_property
    def of_elements(self) -> Numbers:
        """(elements, local traces) numbers: edge by edge, ends counter-clockwise, component by component."""
        n = self.components
        at_ends = (2 * self.skeleton.edges[:, None] + self.skeleton.place) * n
        numbers = at_ends[:, :, None] + np.arange(n)[:, None]
        return np.ascontiguousarray(numbers.reshape(6 * n, -1).T)

    def of_contact(self, axis: int) -> Numbers:
        """(2, contact edges) numbers along a row of ``conditions.axes``."""
        at_ends = 2 * self.conditions.contact + np.arange(2)[:, None]
        return np.asarray(at_ends * self.components + axis, dtype=np.int64)

    def vector(self, field: NDArray) -> Array:
        """A field (components, 2, edges), Cartesian, as a vector of traces or forces."""
        contact, axes = self.conditions.contact, self.conditions.axes
        turned = field.astype(float)
        turned[:, :, contact] = np.einsum("eij,jme->ime", axes, turned[:, :, contact])
        return np.ascontiguousarray(turned.transpose(2, 1, 0)).ravel()

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Which traces are given."""
        both = np.repeat(self.conditions.held[:, None], 2, axis=1)
        return np.asarray(np.abs(self.vector(both)) > 0.5)

    def rotations(self) -> tuple[NDArray[np.int64], Array]:
        """Elements with turned traces, and their matrices (these, k, k) from Cartesian to turned ones."""
        n, conditions = self.components, self.conditions
        oblique = np.any(np.abs(conditions.axes - np.eye(n)) > 0, axis=(1, 2))
        position = np.full(self.skeleton.ends.shape[1], -1)
        position[conditions.contact[oblique]] = np.flatnonzero(oblique)
        which = position[self.skeleton.edges]
        elements = np.flatnonzero(np.any(which >= 0, axis=0))
        result = np.tile(np.eye(6 * n), (elements.size, 1, 1))
        for i in range(3):
            has = np.flatnonzero(which[i, elements] >= 0)
            for end in range(2):
                at = slice((2 * i + end) * n, (2 * i + end + 1) * n)
                result[has, at, at] = conditions.axes[which[i, elements[has]]]
        return elements, result

    def base(self, displacement: Array) -> Array:
        """(components, 2, edges) moments of a piecewise linear displacement (components, nodes)."""
        ends = displacement[:, self.skeleton.ends]
        return np.asarray((2 * ends + ends[:, ::-1]) / 6)


@dataclass(frozen=True)
class LocalSystems:
    """The elements after their stresses are eliminated.

    Attributes
    ----------
    stiffness : (elements, k, k) array
    source : (elements, k) array
        Forces through the edges are ``stiffness @ traces - source``, traces counted from the base.
    base : (components, 2, edges) array
        Moments of the displacement from which traces are counted.
    """

    stiffness: Array
    source: Array
    base: Array


@dataclass(frozen=True)
class InteriorObstacle:
    """An obstacle in the interior; moments of the displacement of each element are further unknowns.

    Arrays run over the vertices of each element; moments are against their linear functions and
    divided by the area.

    Attributes
    ----------
    sign : float
        1 for an obstacle below, -1 above.
    gap : (elements, 3) array
        Moments of the gap of the base.
    load : (elements, 3) array
        Values of the source, times the area.
    touching : (elements, 3) bool array
        Where the elements touch at first.
    """

    sign: float
    gap: Array
    load: Array
    touching: NDArray[np.bool_]


@dataclass(frozen=True)
class Hybrid:
    """The contact problem of the traces, and what leads from its solution back to the elements.

    Attributes
    ----------
    system : ContactSystem
        In the traces that are not given; the gaps of an obstacle in the interior come first.
    space : TraceSpace
    numbers : (elements, k) int array
        Of all traces, those of an obstacle in the interior included.
    free : int array
        Numbers of the traces that are not given.
    held : (traces,) bool array
    start, known : (traces,) arrays
        The base, and where the given traces are, counted from it.
    applied : (traces,) array
        Applied forces.
    inside : int
        Number of gaps of an obstacle in the interior.
    """

    system: ContactSystem
    space: TraceSpace
    numbers: Numbers
    free: NDArray[np.int64]
    held: NDArray[np.bool_]
    start: Array
    known: Array
    applied: Array
    inside: int
    _matrices: tuple[Array, Array]
    _turning: tuple[NDArray[np.int64], Array]

    def traces(self, u: Array) -> Array:
        """All traces for the free ones."""
        W = self.known.copy()
        W[self.free] = u
        return W

    def through(self, traces: Array) -> Array:
        """Sum of the forces through each edge."""
        return _through(self.numbers, *self._matrices, traces)

    def of_elements(self, traces: Array) -> Array:
        """(elements, k) traces of each element, Cartesian."""
        found, (turned, rotation) = traces[self.numbers], self._turning
        if turned.size:
            found[turned] = np.einsum("eji,ej->ei", rotation, found[turned])
        return np.asarray(found)

    def assembled(self, forces: Array) -> Array:
        """Sums over the elements of their forces (elements, k), Cartesian."""
        turned, rotation = self._turning
        if turned.size:
            forces = forces.copy()
            forces[turned] = np.einsum("eij,ej->ei", rotation, forces[turned])
        return np.asarray(np.bincount(self.numbers.ravel(), forces.ravel(), self.held.size), dtype=float)


def _through(numbers: Numbers, S: Array, b: Array, traces: Array) -> Array:
    forces = np.einsum("eij,ej->ei", S, traces[numbers]) - b
    return np.asarray(np.bincount(numbers.ravel(), forces.ravel(), traces.size), dtype=float)


def hybrid(space: TraceSpace, local: LocalSystems, interior: InteriorObstacle | None = None) -> Hybrid:
    """Assemble the contact problem of the traces."""
    conditions, lengths = space.conditions, space.skeleton.lengths
    S, b, turned, rotation = _turned(space, local)
    numbers, size = space.of_elements, space.size
    start = space.vector(local.base)
    applied = space.vector(edge_loads(conditions.traction) * lengths)
    held, inside = space.held, 0
    if interior is not None:
        added = size + np.arange(3 * len(numbers))
        inside = added.size
        numbers, size = np.hstack([numbers, added.reshape(-1, 3)]), size + inside
        start, applied = np.append(start, np.zeros(inside)), np.append(applied, interior.load.ravel())
        held = np.append(held, np.zeros(inside, dtype=bool))
    known, given = np.zeros(size), np.flatnonzero(held)
    known[given] = space.vector(conditions.given)[given] - start[given]
    free = np.flatnonzero(~held)
    index = np.full(size, -1, dtype=np.int64)
    index[free] = np.arange(free.size)
    load = (applied - _through(numbers, S, b, known))[free]
    K = assembled(index[numbers], S, free.size)
    rows, tangents, gaps, bound = _boundary_contact(space, index, start, free.size)
    if interior is not None:
        tangents, bound = sp.csr_array((0, free.size)), np.zeros(0)
        rows = sp.csr_array(sp.vstack([_rows(index[added], free.size) * interior.sign, rows]))
        gaps = np.concatenate([interior.gap.ravel(), gaps])
    system = ContactSystem(K, load, 0.0, rows, tangents, gaps, bound)
    return Hybrid(
        system, space, numbers, free, held, start, known, applied, inside, (S, b), (turned, rotation)
    )


def _turned(space: TraceSpace, local: LocalSystems) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Matrices and sources along the axes of the contact edges, which elements that concerns, and how."""
    S, b = local.stiffness, local.source
    turned, of_edges = space.rotations()
    k = of_edges.shape[1]
    rotation = np.tile(np.eye(b.shape[1]), (turned.size, 1, 1))  # moments of elements are not turned
    rotation[:, :k, :k] = of_edges
    if turned.size:
        S, b = S.copy(), b.copy()
        S[turned] = rotation @ S[turned] @ rotation.transpose(0, 2, 1)
        b[turned] = np.einsum("eij,ej->ei", rotation, b[turned])
    return S, b, turned, rotation


def _boundary_contact(
    space: TraceSpace, index: Numbers, start: Array, size: int
) -> tuple[sp.csr_array, sp.csr_array, Array, Array]:
    """Normals, tangents, gaps and friction bounds of the contact edges, end by end."""
    conditions = space.conditions
    edge = space.skeleton.lengths[conditions.contact]
    along_normal = space.of_contact(space.components - 1)
    gap = (conditions.offset + start[along_normal]).ravel()
    normals = _rows(index[along_normal].ravel(), size)
    if not np.any(conditions.friction > 0):
        return normals, sp.csr_array((0, size)), gap, np.zeros(0)
    tangent = index[space.of_contact(0)].ravel()
    bound = np.where(tangent >= 0, (conditions.friction * edge).ravel(), 0.0)
    return normals, _rows(tangent, size), gap, bound


def edge_loads(moments: Array) -> Array:
    """Values at the ends of edges (components, 2, edges) of the linear functions with these moments."""
    return np.stack([linear_values(part) for part in moments])


def assembled(numbers: Numbers, S: Array, size: int) -> sp.csc_array:
    """Sum of element matrices (elements, k, k) over their numbers (elements, k); -1 drops a row."""
    k = numbers.shape[1]
    row = np.broadcast_to(numbers[:, :, None], S.shape).ravel()
    column = np.broadcast_to(numbers[:, None, :], S.shape).ravel()
    keep = (row >= 0) & (column >= 0) if np.any(numbers < 0) else slice(None)
    place = (row[keep], column[keep])
    return sp.csc_array(sp.coo_array((S.reshape(-1, k * k).ravel()[keep], place), shape=(size, size)))


def _rows(numbers: Numbers, size: int) -> sp.csr_array:
    """One row per entry, with a one at its number; an empty one for -1."""
    used = numbers >= 0
    place = (np.flatnonzero(used), numbers[used])
    return sp.csr_array((np.ones(int(used.sum())), place), shape=(numbers.size, size))
