"""A mesh as its file has it, and the triangles of a plane that are made of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import EllipsisType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.meshes.arrays import from_arrays, repaired
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, lengths, sides

TITLES = ("point", "boundary", "subdomain")
"""What groups of dimension 0, 1, 2 are called without a name: this and their number."""

USABLE = "only points, lines, triangles and quadrilaterals can be used: mesh the plane section"
"""What a file with other cells is told."""


class Block(NamedTuple):
    """Cells of one kind.

    Attributes
    ----------
    corners : int
        1 for points, 2 for lines, 3 for triangles, 4 for quadrilaterals.
    nodes : integers (cells, nodes per cell)
        The corners in their order, then of higher orders further nodes.
    groups : mapping
        Names, and the cells of this block that have them: a mask, or ``...`` for all.
    """

    corners: int
    nodes: Index
    groups: Mapping[str, NDArray | EllipsisType]


class FileMesh(NamedTuple):
    """Points (n, 2 or 3), blocks of cells, sets of nodes by name, and further names that the file has."""

    points: Array
    blocks: Sequence[Block]
    node_sets: Mapping[str, Index] = {}
    names: Iterable[str] = ()


def positions(tags: NDArray) -> Callable[[NDArray], Index]:
    """The function from numbers of nodes in a file to their positions among ``tags``."""
    order = np.argsort(tags, kind="stable")

    def found(wanted: NDArray) -> Index:
        for missing in wanted[~np.isin(wanted, tags)][:1]:
            raise BadInputError(f"the node {missing} of an element is missing in it")
        return order[np.searchsorted(tags, wanted, sorter=order)]

    return found


def triangulated(file: FileMesh, pairs: Collection[tuple[str, str]] = ()) -> MeshTri:
    """The triangles of a plane mesh, with its groups of edges and of faces as names.

    Quadrilaterals are cut, of higher orders the corners taken, planes other than x-y turned; a
    :class:`MeshRepairWarning` says so. A set of nodes names the outer edges between them. Nodes of the
    two boundaries of ``pairs`` stay apart.

    Raises
    ------
    ValueError
        If there are no triangles or quadrilaterals, or they lie in no plane of two axes.
    """
    faces = [block.nodes[:, : block.corners].ravel() for block in file.blocks if block.corners > 2]
    if not faces:
        raise BadInputError(
            "has no triangles or quadrilaterals: export the surface too; gmsh saves only what is in a "
            'physical group once there is one, so add Physical Surface("body") = {1};'
        )
    p, said = _plane(file.points, np.concatenate(faces))
    triangles, count, quads = list[Index](), 0, 0
    edges, parts = defaultdict[str, list[NDArray]](list), defaultdict[str, list[NDArray]](list)
    for block in file.blocks:
        cut, owner = _cut(p, block)
        for name, members in block.groups.items():
            if block.corners == 2:
                edges[name].append(block.nodes[members, :2])
            elif block.corners > 2:
                has_name = np.isin(owner, np.arange(len(block.nodes))[members])
                parts[name].append(count + np.flatnonzero(has_name))
        count, quads = count + len(cut), quads + len(block.nodes) * (block.corners == 4)
        triangles.append(cut)
    t = np.vstack(triangles)
    a, b, c = np.sort(t).T
    # a cell of several groups may be there once for each
    _, first, same = np.unique((a * len(p) + b) * len(p) + c, return_index=True, return_inverse=True)
    kept = np.sort(first)
    new = np.searchsorted(kept, first)[same]
    boundaries = _outer_edges(t[kept], file.node_sets) | {
        name: np.vstack(found) for name, found in edges.items()
    }
    subdomains = {name: np.unique(new[np.concatenate(found)]) for name, found in parts.items()}
    if quads:
        said.append(f"cut {quads} quadrilaterals into triangles")
    if any(block.nodes.shape[1] > block.corners for block in file.blocks):
        said.append("took of elements of higher order the corners (give the curves of boundaries that bend)")
    names = {*file.names, *file.node_sets, *(name for block in file.blocks for name in block.groups)}
    if useless := sorted(names - {*boundaries, *subdomains}):
        said.append(f"left out what names no edge or triangle: {', '.join(useless)}")
    if said:
        repaired("; ".join(said))
    return from_arrays(p, t[kept], boundaries, subdomains, pairs)


def _plane(points: Array, corners: Index) -> tuple[Array, list[str]]:
    """Coordinates (n, 2) in the plane of two axes in which the corners lie, and what was turned."""
    extent = np.ptp(np.nan_to_num(points[corners]), axis=0)
    flat = np.flatnonzero(extent <= SEVEN_DIGITS * np.max(extent))
    if len(extent) == 2:
        return points, []
    if flat.size == 0:
        z = points[corners, 2]
        raise BadInputError(f"is not plane: z runs from {z.min()} to {z.max()}; turn it into the x-y plane")
    points, plane = np.delete(points, flat[-1], axis=1), "-".join(np.delete(list("xyz"), flat[-1]))
    return points, [] if flat[-1] == 2 else [f"its {plane} plane is taken as the x-y plane"]


def _cut(p: Array, block: Block) -> tuple[Index, Index]:
    """Triangles (m, 3) of a block of faces, and the cell whose part each is; none of points and lines.

    Quadrilaterals are cut along the shorter diagonal.
    """
    number = np.arange(len(block.nodes))
    if block.corners != 4:
        return block.nodes[:, :3] if block.corners == 3 else np.zeros((0, 3), int), number
    quads = block.nodes[:, :4]
    across = lengths(p.T, quads[:, [0, 2]].T) > (1 + SEVEN_DIGITS) * lengths(p.T, quads[:, [1, 3]].T)
    quads = np.where(across[:, None], np.roll(quads, 1, axis=1), quads)
    return np.vstack([quads[:, :3], quads[:, [0, 2, 3]]]), np.tile(number, 2)


def _outer_edges(triangles: Index, sets: Mapping[str, Index]) -> dict[str, NDArray]:
    """The outer edges between the nodes of each set, as pairs of nodes; sets without any are left out."""
    edges = sides(triangles.T).T
    outer = edges[~repeated(edges)] if sets else edges
    named = {name: outer[np.all(np.isin(outer, nodes), axis=1)] for name, nodes in sets.items()}
    return {name: edges for name, edges in named.items() if len(edges)}


def repeated(edges: NDArray) -> NDArray:
    """Which of the pairs of nodes (m, 2) are there more than once, in either order."""
    a, b = np.sort(edges, axis=1).T
    _, same, counts = np.unique(a + 1j * b, return_inverse=True, return_counts=True)
    return np.asarray(counts[same] > 1)
