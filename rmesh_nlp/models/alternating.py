"""Starts from which the patterns of a fine mesh grow in step.

On a fine mesh the best positions are patterns of neighbouring nodes at opposite ends of their move limits. A
pattern and its mirror image are equally good, so a descent from the initial mesh grows domains of
both, with faults between them. A small alternating displacement decides for one of the two.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
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
    """``q`` with alternating steps of ``length`` move limits added, in the direction that goes downhill.

    They are halved until the mesh is valid, as it must be at ``q``.
    """
    free, alternate = relocation.mesh_map, alternating(relocation)
    step = -length * np.sign(gradient @ alternate) * alternate
    while not is_valid(free.clipped(q + step)):
        step = step / 2
    return np.asarray(free.clipped(q + step))


def alternating(relocation: Relocation) -> Array:
    """Steps (n_q,) of one move limit, to opposite sides at neighbouring nodes as far as the mesh allows it.

    Two nodes are neighbours if the Laplace stiffness couples them. From the first node of each connected part
    the sign changes with each edge of the shortest way: red and black on a structured grid, where a right
    angle does not couple, and rings on others. So the patterns that grow from it are in step all over the
    mesh.
    """
    coupling = coo_array(-laplace.assemble(Basis(relocation.problem.mesh, ElementTriP1())))
    strong = (coupling.row != coupling.col) & (coupling.data > STRONG * coupling.data.max())
    graph = coo_array((np.ones(strong.sum()), (coupling.row[strong], coupling.col[strong])), coupling.shape)
    _, part = csgraph.connected_components(graph.tocsr(), directed=False)
    first = np.unique(part, return_index=True)[1]
    steps = csgraph.dijkstra(graph.tocsr(), directed=False, indices=first, unweighted=True, min_only=True)
    index = relocation.mesh_map.positions.index
    q = np.zeros(relocation.n_q)
    for component in index:
        used = component != CONSTANT
        q[component[used]] = np.where(steps[used] % 2 == 0, 1.0, -1.0)
    return q
