"""How far contact nodes must keep off a foundation so that the gap holds everywhere between them.

Along an edge, or in a triangle, the gap is ``sum_i N_i G_i - a`` for gaps G_i at its nodes, N_i the shape
functions, where ``a = sum_i N_i d_i - d`` is the height of the foundation above the interpolant, of
coefficients d_i, of the gap d at zero displacement. So it holds if the nodes that are free keep off by
``max (a - sum_held N_j G_j) / sum_free N_i``. That is exact where the normal is the same everywhere; where it
varies, what is left is added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude
from rmesh_nlp.fem.bernstein import functions, to_coefficients
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.optimize.budget import checkpoint
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet

SAMPLES, FINE = 128, 4
"""Parts of an edge at whose ends gaps hold, its middle is one of these, and of these parts between whose ends
the foundation is looked at."""

LATTICES, POINTS = (48, 32, 24, 16, 12), 150_000
"""The same along the sides of a triangle: the finest with which the mesh has no more points than this, or the
coarsest."""


@dataclass(frozen=True)
class Cells:
    """Contact edges, or triangles of an interior contact set, and the points at which gaps are looked at."""

    contact: ContactSet
    number: Index  # (m,), of the edge among those of the boundary, or of the triangle
    nodes: Index  # (v, m), those of the displacement on each cell
    rows: Index  # (v, m), row of the gap of each node; -1 where its displacement is given
    shares: Array  # (v, k), N_i at the points
    points: Array  # (2, m, k)
    distance: Array  # (m, k), gaps without displacement
    sag: Array  # (m, k - 1) of edges, what they may fall by from one point to the next; of triangles (m, k)
    at_nodes: Array  # (v, m), coefficients d_i of the interpolant of these gaps
    bends: Array  # (v, directions), second differences of N_i between points; no directions if N_i is linear

    @property
    def are_triangles(self) -> bool:
        """Whether they are triangles."""
        return self.sag.shape == self.distance.shape

    def only(self, chosen: Mask) -> Cells:
        """Some of the cells (m,), triangles at order 1 with every other point in each direction."""
        every: Mask | slice = slice(None)
        if self.are_triangles and not self.bends.size:
            every = np.all(np.rint(self.shares / np.min(self.shares[self.shares > 0])) % 2 == 0, axis=0)
        first = {name: getattr(self, name)[:, chosen] for name in ("nodes", "rows", "at_nodes")}
        second = {
            name: getattr(self, name)[..., chosen, :][..., every] for name in ("points", "distance", "sag")
        }
        return replace(self, number=self.number[chosen], shares=self.shares[:, every], **first, **second)

    def unreachable(self, given: Array) -> Index:
        """Cells all of whose nodes are held, at ``given`` (components, nodes), and the foundation higher."""
        gap = np.min(self.at_points(given), axis=1)
        size = ROUNDING * (magnitude(self.distance) + magnitude(given))
        return np.flatnonzero(np.all(self.rows < 0, axis=0) & (gap < -size))

    @cached_property
    def normals(self) -> Array:
        """(components, m, k) unit normals at the points."""
        return self.contact.obstacle.normals(self.points)

    def measures(self, problem: ContactProblem) -> Array:
        """(m, k) measure of the part of an edge that each point stands for, by Simpson's rule."""
        half = np.linalg.norm(np.diff(self.points), axis=0) / 2
        beside = np.pad(half, ((0, 0), (1, 0))) + np.pad(half, ((0, 0), (0, 1)))
        beside = beside * np.where(np.arange(beside.shape[1]) % 2, 4 / 3, 2 / 3)
        return beside * problem.measured(self.points)

    def displaced(self, displacement: Array) -> Array:
        """(components, m, k) the displacement (components, nodes) at the points, less that of what is met."""
        return self.contact.relative(displacement)[:, self.nodes].swapaxes(1, 2) @ self.shares

    def at_points(self, displacement: Array) -> Array:
        """(m, k) gaps at the points for a displacement (components, nodes)."""
        return np.sum(self.normals * self.displaced(displacement), axis=0) + self.distance

    def gaps(self, displacement: Array) -> Array:
        """(m, k) least gaps about the points."""
        return self.at_points(displacement) - self.dips(displacement)

    def near(self, displacement: Array, most: float) -> Mask:
        """(m, k) points between which, or about which, the gap may be at most ``most``."""
        is_near = self.gaps(displacement) <= most
        if self.are_triangles:
            return np.broadcast_to(np.any(is_near, axis=1, keepdims=True), is_near.shape)
        return self._beside(is_near[:, 1:] | is_near[:, :-1])

    def dips(self, displacement: Array) -> Array:
        """(m, k) by how much the gap may be less about the points than there, for a displacement.

        Where it changes by d from one point to the next, and lies at most ``D t (1 - t) / 2`` below its
        chord, it is less than at both by ``(D / 2 - |d|)^2 / (2 D)`` if ``|d| < D / 2``, and else not at all.
        In triangles d is not regarded, nor for the foundation at the ends of an edge: a kink beside an end is
        seen from one side alone, which bounds its depth and not the jump of the slope.
        """
        if self.are_triangles:
            bend = np.zeros(self.distance.shape)
            for bends in self.bends.T:
                bent = np.einsum("cvm,v->cm", self.contact.relative(displacement)[:, self.nodes], bends)
                bend = np.maximum(bend, np.sum(self.normals * bent[..., None], axis=0))
            return self.sag + bend / 6
        gaps, dips = self.at_points(displacement), np.zeros_like(self.sag)
        dips[:, [0, -1]] = self.sag[:, [0, -1]]
        bend = np.diff(gaps - self.distance, 2)
        bend = np.maximum(np.pad(bend, ((0, 0), (1, 1)), "reflect", reflect_type="odd"), 0.0)
        bend = np.maximum(bend[:, 1:], bend[:, :-1]) + 8 * (self.sag - dips)
        rest = np.maximum(bend / 2 - np.abs(np.diff(gaps)), 0.0)
        return self._beside(dips + np.divide(rest**2, 2 * bend, out=np.zeros_like(bend), where=bend > 0))

    @staticmethod
    def _beside(sag: NDArray) -> NDArray:
        """(m, k) largest of what is between points of edges and their neighbours, (m, k - 1)."""
        return np.maximum(np.pad(sag, ((0, 0), (1, 0))), np.pad(sag, ((0, 0), (0, 1))))

    def missing(self, displacement: Array) -> Array:
        """(m,) by how much the free nodes of each cell must keep off more than they do; not negative.

        It is the largest ratio of what is missing to the share of the free nodes, 0 where none is free.
        """
        gaps, result = self.gaps(displacement), np.zeros(len(self.distance))
        low = np.any(gaps < 0, axis=1)
        share = (self.rows[:, low] >= 0).T @ self.shares
        lack = np.divide(-gaps[low], share, out=np.zeros(share.shape), where=share > ROUNDING)
        result[low] = np.max(lack, axis=1, initial=0.0)
        return result


def cells_of(body: Body, space: DisplacementSpace, contact: ContactSet) -> Iterator[Cells]:
    """The cells of a contact set of the space, in parts of moderate size."""
    row = np.full(space.n_nodes, -1)
    row[contact.nodes] = contact.rows
    at: Callable[[Index, Array], tuple[Array, Array]]
    is_inside = contact.obstacle.boundary is Place.INTERIOR
    if is_inside:
        nodes, at = space.elements, body.points
        n = max(n for n in LATTICES if n == LATTICES[-1] or n * n / 2 * nodes.shape[1] <= POINTS)
        every, (barycentric, rows) = 1, _lattice(n)
        where, steps = barycentric[:, None], (np.roll(np.eye(3), 1, axis=0) - np.eye(3)) / n
    else:
        edges = body.edges(str(contact.obstacle.boundary))
        nodes, at, every = space.nodes_of(edges.ends), edges.at, FINE
        where = np.arange(SAMPLES * FINE + 1)[None] / (SAMPLES * FINE)
        barycentric = np.stack([1 - where[0, ::FINE], where[0, ::FINE]])
        steps = np.array([[-1.0], [1.0]]) / SAMPLES
    shares, to_gaps = functions(space.order, barycentric), to_coefficients(space.order, len(barycentric))
    own = np.argmax(shares, axis=1)  # the points of the nodes
    # a quadratic form has twice its value at the step as its second difference
    turns = 2 * functions(space.order, steps) if space.order == 2 else np.zeros((len(shares), 0))
    size = 400_000 // where.shape[-1]
    for first in range(0, nodes.shape[1], size):
        checkpoint()
        part = np.arange(nodes.shape[1])[first : first + size]
        points = at(part, np.broadcast_to(where, (*where.shape[:-2], part.size, where.shape[-1])))[0]
        looked = contact.obstacle.distances(points)
        points, distance = points[..., ::every], looked[:, ::every]
        some, at_nodes = nodes[:, part], to_gaps @ distance[:, own].T
        sag = _about(looked, rows) if is_inside else _between(looked)
        yield Cells(contact, part, some, row[some], shares, points, distance, sag, at_nodes, turns)


def _between(distance: Array) -> Array:
    """(m, k - 1) how far a gap may lie below its chords: d, if below by ``4 d t (1 - t)`` along these.

    A kink is below by ``s t (1 - t)``, s the jump of the slope times the chord's length. The second
    differences beside it add up to ``s / FINE``, and as well where the slope changes evenly. A wave may
    cancel them, but not what they differ by from their neighbours, of which one is that of the wave alone.
    """
    bend = np.pad(np.diff(distance, 2), ((0, 0), (2, 2)))
    kink, wave = np.abs(np.diff(bend)), np.abs(bend)
    both = kink[:, :-2] + kink[:, 2:] + 2 * np.minimum(wave[:, :-3], wave[:, 3:])
    both = np.maximum(both, wave[:, 1:-2] + wave[:, 2:-1])
    return FINE / 4 * np.max(both.reshape(len(bend), -1, FINE), axis=2)


def _about(distance: Array, rows: Index) -> Array:
    """(m, k) how far a gap may lie below its values at the points of a triangle.

    Of a quadratic function it is a sixth of the second difference at most, in the middle. The third
    difference is that of a kink: one of size s at the part r of the way between two points is
    ``s r (1 - r)`` below their line, most on a side of a triangle. It has second differences s r and
    s (1 - r), of which the side of a cell hides one. Five points have two third differences:
    what else bends there cancels one of them at most.
    """
    order = np.argsort(rows.ravel(), kind="stable")
    # the rows that each point belongs to, point after point
    beside, begins = order % rows.shape[1], np.flatnonzero(np.diff(rows.ravel()[order], prepend=-1))
    looked = np.ascontiguousarray(distance.T)[rows]
    bend, kink = (np.max(np.abs(np.diff(looked, n, axis=0)), axis=0) for n in (2, 3))
    return np.maximum.reduceat((bend / 6 + kink)[beside], begins).T


@lru_cache
def _lattice(n: int) -> tuple[Array, Index]:
    """Barycentric points (3, k) of a triangle, and five neighbours in a row (5, rows)."""
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    number = np.full((n + 5, n + 5), -1)
    number[i, j] = np.arange(i.size)
    rows = np.hstack(
        [[number[i + s * di, j + s * dj] for s in range(5)] for di, dj in ((1, 0), (0, 1), (1, -1))]
    )
    return np.stack([n - i - j, i, j]) / n, rows[:, np.all(rows >= 0, axis=0)]
