"""Fields by their values at nodes, cut into straight pieces for pictures and files.

Cells are triangles with three nodes at their vertices, or six: after those the ones at the middles of their
edges, in the order of ``bernstein.SIDES``. Positions are such a field too: edges along curves are bent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from skfem import MeshTri

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.bernstein import SIDES, functions, to_coefficients

ALONG = {2: 1, 3: 8}
"""Straight pieces in which an edge is drawn, by the number of its nodes."""


class Cut(NamedTuple):
    """Straight triangles in a cell, on which fields are drawn as linear.

    ``shares`` (3, points) are the barycentric coordinates of their vertices, ``triangles`` (3, pieces).
    """

    shares: Array
    triangles: Index

    @property
    def centres(self) -> Array:
        """(3, pieces) barycentric coordinates of their centres."""
        return self.shares[:, self.triangles].mean(axis=1)


def pieces(cells: Index) -> Cut:
    """The pieces of each cell: a triangle with three nodes is its own; one with six is cut into 16."""
    cut = MeshTri.init_refdom().refined(0 if len(cells) == 3 else 2)
    return Cut(np.vstack([1 - cut.p.sum(axis=0), cut.p]), cut.t.astype(np.int64))


def sampled(cells: Index, values: Array, shares: Array) -> Array:
    """(..., cells, points) values of a field (..., nodes) at barycentric coordinates in cells or edges."""
    order = 1 if len(cells) == len(shares) else 2
    weights = functions(order, shares).T @ to_coefficients(order, len(shares))
    return np.einsum("...nc,pn->...cp", values[..., cells], weights)


def edges_of(cells: Index, *, outer: bool = False) -> Index:
    """(2 or 3, edges) nodes of all edges of cells, each once, or of the ``outer`` ones of one cell alone.

    First their ends, then their middle.
    """
    middle = [[3 + number] for number in range(3)] if len(cells) == 6 else [[]] * 3
    edges = np.hstack([cells[[a, b, *inner]] for (a, b), inner in zip(SIDES[3], middle, strict=True)])
    edges[:2] = np.sort(edges[:2], axis=0)
    _, first, times = np.unique(edges[:2], axis=1, return_index=True, return_counts=True)
    return edges[:, first[times == 1] if outer else first]


def along(edges: Index, values: Array, parts: int | None = None) -> Array:
    """(..., edges, parts + 1) values at equal distances along edges, of a field (..., nodes)."""
    parts = ALONG[len(edges)] if parts is None else parts
    s = np.arange(parts + 1) / parts
    return sampled(edges, values, np.stack([1 - s, s]))
