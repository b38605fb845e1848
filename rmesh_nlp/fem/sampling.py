"""Fields by their values at nodes, cut into straight pieces for pictures and files.

Cells are triangles with three nodes at their vertices, or six: after those the ones at the middles of their
edges, in the order of ``bernstein.SIDES``. Positions are such a field too: edges along curves are bent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, vstack

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import SIDES, functions, to_coefficients
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body

Index = NDArray[np.int64]

MOST = 40_000  # pieces up to which they are halved, twice at most
SMALL = {3: ((0, 1, 2),), 6: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))}
"""The straight triangles between the nodes of a cell, by how many it has."""

ALONG = {2: 1, 3: 8}
"""Straight pieces in which an edge is drawn, by the number of its nodes."""


def points_of(space: DisplacementSpace, X: Array) -> Array:
    """(2, nodes) where the nodes are on the body with its vertices at X (2, vertices).

    Middles of edges on curves are on the curve, unlike those of :meth:`DisplacementSpace.points`.
    """
    points = np.array(space.points(X))
    for arcs in Body(space.problem, X).arcs:
        for middle in space.nodes_of(space.problem.mesh.facets[:, arcs.facets])[2:]:
            points[:, middle] = arcs.at(np.arange(middle.size), np.full((middle.size, 1), 0.5))[0][..., 0]
    return points


@dataclass(frozen=True)
class Pieces:
    """Cells cut into straight triangles on which fields are drawn as linear.

    ``triangles`` are (3, elements * pieces), those of an element one after the other; ``weights`` (points,
    nodes) take the values at nodes to those at the points of the pieces.
    """

    triangles: Index
    weights: csr_array

    def __call__(self, values: Array) -> Array:
        """(..., points) values at the points of a field (..., nodes)."""
        return np.asarray((self.weights @ np.asarray(values, dtype=float).T).T)


def pieces(cells: Index, n_nodes: int) -> Pieces:
    """The pieces of cells: a triangle with three nodes is its own; one with six is cut into 64, 16 or 4."""
    return _cut(cells, n_nodes, _halvings(cells))


def _halvings(cells: Index) -> int:
    """How often pieces are halved."""
    return 0 if len(cells) == 3 else sum(cells.shape[1] * each <= MOST for each in (16, 64))


def _cut(cells: Index, n_nodes: int, halvings: int) -> Pieces:
    weights = eye_array(n_nodes, format="csr")
    for _ in range(halvings):
        cells, finer = _halved(cells, weights.shape[0])
        weights = finer @ weights
    small = np.stack([cells[list(piece)] for piece in SMALL[len(cells)]], axis=-1)
    return Pieces(small.reshape(3, -1), weights)


def _halved(cells: Index, n: int) -> tuple[Index, csr_array]:
    """Four cells of each, (6, 4 elements), and the weights (nodes, n) of the values at their nodes."""
    children = np.stack([cells[list(piece)] for piece in SMALL[6]], axis=-1).astype(np.int64)
    ends = children[np.array(SIDES[3])]  # (side, end, element, child)
    names = ends.min(axis=1) * n + ends.max(axis=1)
    _, first, number = np.unique(names, return_index=True, return_inverse=True)
    finer = np.concatenate([children, n + number.reshape(names.shape)]).reshape(6, -1)
    side, element, child = np.unravel_index(first, names.shape)
    at = _nodes()[:, np.array(SMALL[6])[:, np.array(SIDES[3])]].mean(axis=-1)[:, child, side]  # (3, new)
    weights = functions(2, at).T @ to_coefficients(2, 3)
    rows = np.broadcast_to(np.arange(first.size)[:, None], weights.shape)
    new = csr_array((weights.ravel(), (rows.ravel(), cells[:, element].T.ravel())), shape=(first.size, n))
    return finer, vstack([eye_array(n), new], format="csr")


def _nodes() -> Array:
    """(3, 6) barycentric coordinates of the nodes of a cell."""
    corners = np.eye(3)
    return np.hstack([corners, np.stack([(corners[a] + corners[b]) / 2 for a, b in SIDES[3]], axis=1)])


def centres(cells: Index) -> Array:
    """(3, pieces) barycentric coordinates of the centres of the pieces of each cell."""
    n = len(cells)
    cut = _cut(np.arange(n)[:, None], n, _halvings(cells))
    return np.asarray(cut(_nodes()[:, :n])[:, cut.triangles].mean(axis=1))


def edges_of(cells: Index, *, outer: bool = False) -> Index:
    """(2 or 3, edges) nodes of all edges of cells, each once, or of the ``outer`` ones of one cell alone.

    First their ends, then their middle.
    """
    middle = [[3 + number] for number in range(3)] if len(cells) == 6 else [[]] * 3
    edges = np.hstack([cells[[a, b, *inner]] for (a, b), inner in zip(SIDES[3], middle, strict=True)])
    edges[:2] = np.sort(edges[:2], axis=0)
    _, first, times = np.unique(edges[:2], axis=1, return_index=True, return_counts=True)
    return np.asarray(edges[:, first[times == 1] if outer else first])


def along(edges: Index, values: Array, parts: int | None = None) -> Array:
    """(..., edges, parts + 1) values at equal distances along edges, of a field (..., nodes)."""
    parts = ALONG[len(edges)] if parts is None else parts
    s = np.arange(parts + 1) / parts
    order = len(edges) - 1
    weights = functions(order, np.stack([1 - s, s])).T @ to_coefficients(order, 2)
    return np.asarray(np.einsum("...ne,pn->...ep", values[..., edges], weights))
