"""Nested dissection: the order in which the unknowns of a large mesh are eliminated.

A. George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10 (1973) 345-363. The
nodes are halved by a line across their longer extent; those that have neighbours on the other side come last,
each half is treated in the same way. On gmsh's meshes the fill is that of minimum degree, but the order is
found once per mesh, and the factorisation of a plate of 24,000 nodes takes 0.42 s in place of 0.99 s.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT, Index

LARGE = 5000
"""Nodes above which it is used: smaller meshes are factorised fast enough in any order."""

LEAF = 64
"""Nodes that are not halved any more."""


def elimination_order(points: Array, edges: NDArray[np.integer], index: Index) -> NDArray[np.int64]:
    """The unknowns of a nodal field in the order of their elimination.

    Parameters
    ----------
    points : (2, nodes) array
    edges : (2, edges) array
    index : (components, nodes) array
        Number of the unknown behind each component, or ``CONSTANT``.
    """
    unknowns = index[:, dissected(points, edges)].T.ravel()
    unknowns = unknowns[unknowns != CONSTANT]
    _, first = np.unique(unknowns, return_index=True)  # tied nodes have one unknown
    return np.asarray(unknowns[np.sort(first)], dtype=np.int64)


def dissected(points: Array, edges: NDArray[np.integer]) -> NDArray[np.int64]:
    """The nodes, separators after the halves that they separate."""
    n = points.shape[1]
    ends = np.hstack([edges, edges[::-1]])
    adjacent = sp.csr_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(n, n))
    beyond = np.zeros(n)
    parts: list[NDArray[np.int64]] = []  # from the last one to be eliminated to the first
    waiting = [np.arange(n)]
    while waiting:
        nodes = waiting.pop()
        if nodes.size > LEAF:
            here = points[:, nodes]
            along = here[int(np.argmax(np.ptp(here, axis=1)))]
            low = along <= np.median(along)
            if not np.all(low):
                beyond[nodes[~low]] = 1.0
                separates = adjacent[nodes[low]] @ beyond > 0
                beyond[nodes[~low]] = 0.0
                parts.append(nodes[low][separates])
                waiting += [nodes[low][~separates], nodes[~low]]
                continue
        parts.append(nodes)
    return np.concatenate(parts[::-1])
