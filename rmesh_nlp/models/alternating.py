"""Starts from which the patterns of a fine mesh grow in step.

On a fine mesh the best positions are patterns of neighbouring nodes at opposite ends of their move limits. A
pattern and its mirror image are equally good, so a descent from the initial mesh grows domains of
both, with faults between them. A small alternating displacement decides for one of the two.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csgraph
from skfem import Basis, ElementTriP1
from skfem.models.poisson import laplace

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.models.energy_nlp import Relocation

STRONG = 0.1
"""Least coupling of two nodes, relative to the strongest of the mesh, that makes them neighbours."""


def alternated(
    relocation: Relocation, q: Array, gradient: Array, length: float, is_valid: Callable[[Array], bool]
) -> Array:
    """``q`` with alternating moves added, in the direction of the two that goes downhill.

    Parameters
    ----------
    relocation : Relocation
    q, gradient : (n_q,) arrays
    length : float
        Of the moves that are added, in move limits; halved until the mesh is valid, as ``q`` must be.
    is_valid : callable
    """
    bound = relocation.mesh_map.bound
    alternate = alternating(relocation)
    step = -length * np.sign(gradient @ alternate) * alternate
    while not is_valid(np.clip(q + step, -bound, bound)):
        step = step / 2
    return np.asarray(np.clip(q + step, -bound, bound))


def alternating(relocation: Relocation) -> Array:
    """Moves of one limit, to opposite sides at neighbouring nodes as far as the mesh allows it.

    Two nodes are neighbours if the Laplace stiffness couples them. From one node the sign
    changes with each edge of the shortest way: red and black on a structured grid, where a right
    angle does not couple, and rings on others. So the patterns that grow from it are in step
    all over the mesh.
    """
    rel = relocation
    mesh = rel.problem.mesh
    coupling = coo_array(-laplace.assemble(Basis(mesh, ElementTriP1())))
    strong = (coupling.row != coupling.col) & (coupling.data > STRONG * coupling.data.max())
    graph = coo_array((np.ones(strong.sum()), (coupling.row[strong], coupling.col[strong])), coupling.shape)
    steps = _steps_from_first(graph.tocsr())
    sign = np.where(steps % 2 == 0, 1.0, -1.0)
    index = rel.mesh_map.positions.index
    q = np.zeros(rel.n_q)
    for component in index:
        used = component != CONSTANT
        q[component[used]] = sign[used]
    return q


def _steps_from_first(graph: object) -> NDArray[np.int64]:
    """Edges on the shortest way from the first node of each connected part."""
    _, part = csgraph.connected_components(graph, directed=False)
    first = np.unique(part, return_index=True)[1]
    distance = csgraph.dijkstra(graph, directed=False, indices=first, unweighted=True, min_only=True)
    return np.asarray(distance, dtype=np.int64)
