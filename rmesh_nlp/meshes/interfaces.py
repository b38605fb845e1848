"""A line inside a mesh that becomes two boundaries."""

from __future__ import annotations

import numpy as np
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Index
from rmesh_nlp.meshes.arrays import named
from rmesh_nlp.meshes.geometry import pieces_of


def opened(mesh: MeshTri, name: str, behind: str, front: Index) -> MeshTri:
    """The mesh with two nodes in the place of each on a named line inside it.

    ``name`` is then the boundary of the elements ``front`` (edges,), ``behind`` that of the others.
    A node is doubled if the line separates the elements around it: the ends of a line within the body stay
    single, those on its boundary do not. Old nodes keep their numbers.
    """
    line = mesh.boundaries[name]
    for edge in line[mesh.f2t[1, line] < 0]:
        a, b = mesh.facets[:, edge]
        raise BadInputError(f"{name!r} has an edge on the boundary, between nodes {a} and {b}, none can open")
    uncut = np.setdiff1d(np.flatnonzero(mesh.f2t[1] >= 0), line)
    number = np.arange(mesh.t.size).reshape(mesh.t.shape)  # of the corners of all elements
    pairs = [
        [number[np.argmax(mesh.t[:, e] == end, axis=0), e] for e in mesh.f2t[:, uncut]]
        for end in mesh.facets[:, uncut]
    ]
    fan = pieces_of(np.hstack(pairs), mesh.t.size)
    old = mesh.t.ravel()[np.unique(fan, return_index=True)[1]]
    new, single = np.array(old), np.unique(old, return_index=True)[1]
    further = np.setdiff1d(np.arange(old.size), single)
    if further.size == 0:
        raise BadInputError(f"{name!r} cannot open: it needs two edges or an end on the boundary")
    new[further] = mesh.p.shape[1] + np.arange(further.size)
    corners = new[fan].reshape(mesh.t.shape)
    cut = MeshTri(np.hstack([mesh.p, mesh.p[:, old[further]]]), corners)

    def edges(facets: Index, elements: Index) -> Index:
        which = [np.argmax(mesh.t[:, elements] == end, axis=0) for end in mesh.facets[:, facets]]
        return corners[np.stack(which), elements].T

    boundaries = {other: edges(facets, mesh.f2t[0, facets]) for other, facets in mesh.boundaries.items()}
    back = np.sum(mesh.f2t[:, line], axis=0) - front
    boundaries |= {name: edges(line, front), behind: edges(line, back)}
    return named(cut, boundaries, mesh.subdomains)
