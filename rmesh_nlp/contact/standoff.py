"""How far contact nodes must keep off a foundation so that the gap holds everywhere between them.

Along an edge, or in a triangle, the gap is ``sum_i N_i G_i - a`` for gaps G_i at its nodes, N_i the shape
functions, where ``a = sum_i N_i d_i - d`` is the height of the foundation above the interpolant, of
coefficients d_i, of the gap d at zero displacement. So it holds if the nodes that are free keep off by
``max (a - sum_held N_j G_j) / sum_free N_i``. That is exact where the normal is the same everywhere; where it
varies, what is left is added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude
from rmesh_nlp.fem.bernstein import functions, to_coefficients
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet

SAMPLES = 128
"""Parts of an edge between whose ends the foundation is looked at; its middle is one of these places."""

LATTICES, POINTS = (48, 32, 24, 16, 12), 150_000
"""The same along the sides of a triangle: the finest with which the mesh has no more points than this, or the
coarsest."""

BETWEEN = 1 / 2
"""Of the largest second difference beside a sample, what the height may exceed it by towards the next ones.
A kink of size s at the part r of the way between two samples rises s r (1 - r) above their line and has
second differences s r and s (1 - r): at most a half, halfway. In a triangle of samples the height over a
ridge is largest on a side. Smooth foundations need an eighth on edges and a sixth in triangles."""


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
    low: Array  # (m, k), the same less what they may fall by between the points
    at_nodes: Array  # (v, m), coefficients d_i of the interpolant of these gaps
    vertices: int  # nodes of a cell at its vertices, which come first
    bends: Array  # (v, directions), second differences of N_i between points; no directions if N_i is linear

    def off(self, given: Array) -> Array:
        """(m,) how far the free nodes of each cell must keep off; -infinity where none is free.

        ``given`` (nodes,) is the displacement along the normal where it is given.
        """
        height = self.shares.T @ self.at_nodes - self.low.T
        return self._needed(height, np.where(self.rows < 0, self.at_nodes + given[self.nodes], 0.0))

    def unreachable(self, given: Array) -> Index:
        """Cells all of whose nodes are held, through which the foundation rises."""
        held = np.flatnonzero(np.all(self.rows < 0, axis=0))
        if held.size == 0:
            return held
        gap = self.shares.T @ given[self.nodes[:, held]] + self.distance[held].T
        size = ROUNDING * (magnitude(self.distance) + magnitude(given))
        return held[np.min(gap, axis=0) < -size]

    @cached_property
    def normals(self) -> Array:
        """(components, m, k) unit normals at the points."""
        return self.contact.obstacle.normals(self.points)

    def along(self, displacement: Array) -> Array:
        """(m, k) components of a displacement (components, nodes) along the normals at the points."""
        u = np.einsum("cvm,vk->cmk", displacement[:, self.nodes], self.shares)
        return np.sum(self.normals * u, axis=0)

    def gaps(self, displacement: Array) -> Array:
        """(m, k) least gaps about the points."""
        return self.along(displacement) + self.low - self.dips(displacement)

    def depths(self, displacement: Array) -> Array:
        """(m,) how far the foundation passes into each cell at its points, 0 without."""
        return np.abs(np.minimum(np.min(self.along(displacement) + self.distance, axis=1), 0.0))

    def dips(self, displacement: Array) -> Array:
        """(m, k) by how much the normal displacement is less between the points: of a parabola an eighth."""
        result = np.zeros(self.low.shape)
        for bends in self.bends.T:
            bent = np.einsum("cvm,v->cm", displacement[:, self.nodes], bends)
            result += np.maximum(np.sum(self.normals * bent[..., None], axis=0), 0.0) / 8
        return result

    def missing(self, displacement: Array) -> Array:
        """(m,) by how much the free nodes of each cell must keep off more than they do; not negative."""
        lack = self._needed(-self.gaps(displacement).T, np.zeros(self.rows.shape))
        return np.maximum(np.where(np.isfinite(lack), lack, 0.0), 0.0)

    def pressed(self, force: Array) -> Mask:
        """(m,) cells of which a free node presses on the foundation with a force of (gaps,)."""
        return np.any((self.rows >= 0) & (force[self.rows] > 0), axis=0)

    def _needed(self, height: Array, held: Array) -> Array:
        """Largest ratio of what is missing (k, m), less what held nodes give, to the share of free ones."""
        free = self.rows >= 0
        share = self.shares.T @ free
        short = height - self.shares.T @ held
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(share > ROUNDING, short / share, -np.inf)
        return np.max(ratio, axis=0, initial=-np.inf)


def cells_of(body: Body, space: DisplacementSpace, contact: ContactSet) -> Iterator[Cells]:
    """The cells of a contact set of the space, in parts of moderate size."""
    row = np.full(space.n_nodes, -1)
    row[contact.nodes] = contact.rows
    at: Callable[[Index, Array], tuple[Array, Array]]
    if contact.obstacle.boundary is Place.INTERIOR:
        nodes, at = space.elements, body.points
        fits = [n for n in LATTICES if n * n / 2 * nodes.shape[1] <= POINTS]
        n = fits[0] if fits else LATTICES[-1]
        barycentric, bends = _lattice(n)
        where, steps = barycentric[:, None], (np.roll(np.eye(3), 1, axis=0) - np.eye(3)) / n
    else:
        edges = body.edges(str(contact.obstacle.boundary))
        nodes, at = space.nodes_of(edges.ends), edges.at
        barycentric, bends, where = np.stack([1 - _ALONG, _ALONG]), _EDGE_BENDS, _ALONG[None]
        steps = np.array([[-1.0], [1.0]]) / SAMPLES
    shares, to_gaps = functions(space.order, barycentric), to_coefficients(space.order, len(barycentric))
    own = np.argmax(shares, axis=1)  # the points of the nodes
    # a quadratic form has twice its value at the step as its second difference
    turns = 2 * functions(space.order, steps) if space.order == 2 else np.zeros((len(shares), 0))
    step, order = max(1, 400_000 // shares.shape[1]), np.argsort(bends.ravel(), kind="stable")
    # the bends that each point belongs to, point after point
    beside, begins = order % bends.shape[1], np.flatnonzero(np.diff(bends.ravel()[order], prepend=-1))
    for first in range(0, nodes.shape[1], step):
        part = np.arange(first, min(first + step, nodes.shape[1]))
        shape = (*where.shape[:-2], part.size, shares.shape[1])
        points = at(part, np.broadcast_to(where, shape))[0]
        distance = contact.obstacle.distances(points)
        bend = distance[:, bends[0]] - 2 * distance[:, bends[1]] + distance[:, bends[2]]
        low = distance - BETWEEN * np.maximum.reduceat(np.abs(bend.T)[beside], begins).T
        some, at_nodes = nodes[:, part], to_gaps @ distance[:, own].T
        yield Cells(
            contact, part, some, row[some], shares, points, distance, low, at_nodes, len(barycentric), turns
        )


_ALONG = np.arange(SAMPLES + 1) / SAMPLES
_EDGE_BENDS = np.arange(SAMPLES - 1) + np.array([[0], [1], [2]])


@lru_cache
def _lattice(n: int) -> tuple[Array, Index]:
    """Barycentric points (3, k) of a triangle, and triples of neighbours in a row, in three directions."""
    places = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {place: k for k, place in enumerate(places)}
    triples = [
        (number[i - di, j - dj], number[i, j], number[i + di, j + dj])
        for i, j in places
        for di, dj in ((1, 0), (0, 1), (1, -1))
        if (i - di, j - dj) in number and (i + di, j + dj) in number
    ]
    points = np.array([[n - i - j, i, j] for i, j in places]).T / n
    return points, np.array(triples).T
