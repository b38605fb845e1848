"""Whether triangles that agree along their edges cover no part of the plane twice.

Triangles that are counter-clockwise and share each edge with at most one neighbour may still overlap: where
boundary edges cross, also where they wind twice around a node, where a piece lies within another, or at a
hanging node, whose neighbour across the edge does not know it. Without any of these the mesh is embedded:
turning numbers leave a connected piece with disjoint simple boundary curves one outer curve only, and then no
point is covered twice.

Everything is looked for along the boundary, which has about the square root of the elements. Candidates are
found by trees of edges of like length, so that graded meshes take no longer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, cross, largest_side
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, counter_clockwise, lengths, pieces_of, sides, signed_areas

INSIDE = np.array([0.2113, 0.3517, 0.4370])
"""Barycentric coordinates of a point of an element; with these it is hardly ever on an edge of another."""


def fault(mesh: MeshTri) -> str | None:
    """What keeps a mesh of triangles, turned counter-clockwise, from being embedded; None if nothing does."""
    return _flat(mesh) or _folded(mesh) or _hanging(mesh) or _crossing(mesh) or _covered(mesh)


def _flat(mesh: MeshTri) -> str | None:
    """An element as flat as the distance at which nodes count as one."""
    corner = mesh.p[:, mesh.t]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=0).max(axis=0)
    areas = np.abs(signed_areas(mesh.p, mesh.t))
    flat = np.flatnonzero(~(areas > ROUNDING * longest * largest_side(mesh.p)))
    return f"element {flat[0]} has no area" if flat.size else None


def _folded(mesh: MeshTri) -> str | None:
    """An edge that two counter-clockwise elements run along in the same direction."""
    t = counter_clockwise(mesh.p, mesh.t)
    edges = sides(t)
    _, first, count = np.unique(edges[0] * (t.max() + 1) + edges[1], return_index=True, return_counts=True)
    for a, b in edges[:, first[count > 1]].T:
        return f"elements overlap at the edge between nodes {a} and {b}"
    return None


def _hanging(mesh: MeshTri) -> str | None:
    """A boundary node within a boundary edge of which it is no end."""
    ends, element = _boundary(mesh)
    nodes = np.unique(ends)
    a, b = (mesh.p[:, end] for end in ends)
    length = lengths(mesh.p, ends)
    tangent = (b - a) / length
    for edges, chosen in _near(a, b, mesh.p[:, nodes], np.zeros(nodes.size)):
        d, size = mesh.p[:, nodes[chosen]] - a[:, edges], length[edges]
        position = np.sum(d * tangent[:, edges], axis=0)
        on_line = np.abs(cross(tangent[:, edges], d)) <= SEVEN_DIGITS * size
        for which in np.flatnonzero(
            on_line & (position > SEVEN_DIGITS * size) & (position < (1 - SEVEN_DIGITS) * size)
        ):
            edge = edges[which]
            return (
                f"node {nodes[chosen[which]]} hangs on the edge between nodes {ends[0, edge]} and "
                f"{ends[1, edge]} of element {element[edge]}, of which it is no vertex: the mesh has a crack "
                "there; make the meshes of both sides meet in the same nodes"
            )
    return None


def _crossing(mesh: MeshTri) -> str | None:
    """Two boundary edges that cross."""
    ends, element = _boundary(mesh)
    a, b = (mesh.p[:, end] for end in ends)
    length = lengths(mesh.p, ends)
    for edge, other in _near(a, b, 0.5 * (a + b), 0.5 * length):
        apart = ~np.any(ends[:, None, edge] == ends[None, :, other], axis=(0, 1))
        edge, other = edge[apart], other[apart]
        far = ROUNDING * np.maximum(length[edge], length[other])
        crossed = _separated(a[:, edge], b[:, edge], a[:, other], b[:, other], far)
        crossed &= _separated(a[:, other], b[:, other], a[:, edge], b[:, edge], far)
        for which in np.flatnonzero(crossed):
            first, second = sorted((int(element[edge[which]]), int(element[other[which]])))
            return f"elements {first} and {second} overlap: their edges cross"
    return None


def _covered(mesh: MeshTri) -> str | None:
    """A piece, connected over edges, that lies on another one."""
    piece = pieces_of(mesh.f2t[:, mesh.f2t[1] >= 0], mesh.nelements)
    corner = mesh.p[:, counter_clockwise(mesh.p, mesh.t)]
    for element in np.unique(piece, return_index=True)[1]:
        off = (corner[:, :, element] @ INSIDE)[:, None, None] - corner
        inside = np.all(cross(np.roll(corner, -1, axis=1) - corner, off) > 0, axis=0)
        for other in np.flatnonzero(inside & (piece != piece[element])):
            return f"elements {element} and {other} overlap: a piece lies on another"
    return None


def _boundary(mesh: MeshTri) -> tuple[Index, Index]:
    """Ends (2, edges) of the boundary edges, and the element of each."""
    facets = np.flatnonzero(mesh.f2t[1] < 0)
    return mesh.facets[:, facets], mesh.f2t[0, facets]


def _near(a: Array, b: Array, points: Array, radius: Array) -> Iterator[tuple[Index, Index]]:
    """Pairs (segment, point) of which the discs meet, those of the segments having them as diameters.

    Segments are taken by classes of length, within a factor of two.
    """
    length, middle = np.linalg.norm(b - a, axis=0), 0.5 * (a + b)
    kind = np.floor(np.log2(np.maximum(length, 1e-300))).astype(np.int64)
    for level in np.unique(kind):
        members = np.flatnonzero(kind == level)
        longest = 0.5 * np.max(length[members])
        # discs that are larger than these look for them when their own class is asked
        small = np.flatnonzero(radius <= (1 + ROUNDING) * longest)
        tree = cKDTree(middle[:, members].T)
        neighbours = tree.query_ball_point(points[:, small].T, (1 + 1e-6) * (radius[small] + longest))
        count = np.fromiter(map(len, neighbours), np.int64, small.size)
        if count.sum():
            yield members[np.concatenate(neighbours).astype(np.int64)], np.repeat(small, count)


def _separated(a: Array, b: Array, c: Array, d: Array, far: Array) -> Mask:
    """Whether c and d lie on different sides of the lines through a and b, farther than ``far`` from them."""
    tangent = (b - a) / np.linalg.norm(b - a, axis=0)
    first, second = cross(tangent, c - a), cross(tangent, d - a)
    return (first * second < 0) & (np.minimum(np.abs(first), np.abs(second)) > far)
