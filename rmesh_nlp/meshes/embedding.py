"""Whether triangles that agree along their edges cover no part of the plane twice.

Triangles that are counter-clockwise and share each edge with at most one neighbour may still overlap: where
they wind twice around a node, where boundary edges cross, where a piece lies within another, or at a
hanging node, whose neighbour across the edge does not know it. Without any of these the mesh is embedded:
turning numbers leave a connected piece with disjoint simple boundary curves one outer curve
only, and then no point is covered twice.

Everything is looked for along the boundary, which has about the square root of the elements. Candidates are
found by trees of edges of like length, so that graded meshes take no longer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.meshes.geometry import counter_clockwise

ON = 1e-6
"""Part of an edge within which a node lies on it: files are often written with seven digits."""

INSIDE = np.array([0.2113, 0.3517, 0.4370])
"""Barycentric coordinates of a point of an element; with these it is hardly ever on an edge of another."""

Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]


def fault(mesh: MeshTri) -> str | None:
    """What keeps a mesh of triangles from being embedded, in words; None if it is.

    Clockwise ones are turned. Edges must have passed :func:`rmesh_nlp.meshes.geometry.overlapping`.
    """
    return _wound(mesh) or _hanging(mesh) or _crossing(mesh) or _covered(mesh)


def _wound(mesh: MeshTri) -> str | None:
    """A node around which the angles of its elements sum to more than a full turn."""
    p, t = mesh.p, mesh.t
    total = np.zeros(p.shape[1])
    for i in range(3):
        a, b = p[:, t[(i + 1) % 3]] - p[:, t[i]], p[:, t[(i + 2) % 3]] - p[:, t[i]]
        angle = np.arctan2(np.abs(a[0] * b[1] - a[1] * b[0]), np.sum(a * b, axis=0))
        total += np.bincount(t[i], angle, total.size)
    node = int(np.argmax(total))
    if total[node] <= 2 * np.pi + 1e-6:
        return None
    elements = np.flatnonzero(np.any(t == node, axis=0))
    return f"elements overlap around node {node}: {_some(elements)} wind around it more than once"


def _hanging(mesh: MeshTri) -> str | None:
    """A boundary node within a boundary edge of which it is no end."""
    ends, element = _boundary(mesh)
    nodes = np.unique(ends)
    a, b = mesh.p[:, ends[0]], mesh.p[:, ends[1]]
    along, length = b - a, np.linalg.norm(b - a, axis=0)
    for edges, chosen in _near(a, b, mesh.p[:, nodes], np.zeros(nodes.size)):
        d = mesh.p[:, nodes[chosen]] - a[:, edges]
        tangent, size = along[:, edges] / length[edges], length[edges]
        position = np.sum(d * tangent, axis=0)
        distance = np.abs(tangent[0] * d[1] - tangent[1] * d[0])
        found = (position > ON * size) & (position < (1 - ON) * size) & (distance <= ON * size)
        if np.any(found):
            which = int(np.flatnonzero(found)[0])
            node, edge = int(nodes[chosen[which]]), int(edges[which])
            return (
                f"node {node} hangs on the edge between nodes {ends[0, edge]} and {ends[1, edge]} of element "
                f"{element[edge]}, of which it is no vertex: the mesh has a crack there; make the meshes of "
                "both sides meet in the same nodes"
            )
    return None


def _crossing(mesh: MeshTri) -> str | None:
    """Two boundary edges that cross."""
    ends, element = _boundary(mesh)
    a, b = mesh.p[:, ends[0]], mesh.p[:, ends[1]]
    length = np.linalg.norm(b - a, axis=0)
    for one, two in _near(a, b, 0.5 * (a + b), 0.5 * length):
        apart = ~np.any((ends[:, None, one] == ends[None, :, two]), axis=(0, 1))
        one, two = one[apart], two[apart]
        far = ROUNDING * np.maximum(length[one], length[two])
        crossed = _sides(a[:, one], b[:, one], a[:, two], b[:, two], far)
        crossed &= _sides(a[:, two], b[:, two], a[:, one], b[:, one], far)
        if np.any(crossed):
            which = int(np.flatnonzero(crossed)[0])
            first, second = sorted((int(element[one[which]]), int(element[two[which]])))
            return f"elements {first} and {second} overlap: their edges cross"
    return None


def _covered(mesh: MeshTri) -> str | None:
    """A piece that lies on another one."""
    number = _pieces(mesh)
    _, first = np.unique(number, return_index=True)
    if first.size == 1:
        return None
    p, t = mesh.p, counter_clockwise(mesh.p, mesh.t)
    points = np.einsum("dkn,k->dn", p[:, t[:, first]], INSIDE)
    corner = p[:, t]
    middle = corner.mean(axis=1)
    reach = np.max(np.linalg.norm(corner - middle[:, None], axis=0), axis=0)
    across = np.vstack([reach, np.zeros(reach.size)])  # the disc of an element as that of a segment
    for elements, chosen in _near(middle - across, middle + across, points, np.zeros(first.size)):
        other = number[elements] != number[first[chosen]]
        elements, chosen = elements[other], chosen[other]
        inside = np.ones(elements.size, dtype=bool)
        for i in range(3):
            u, v = p[:, t[i, elements]], p[:, t[(i + 1) % 3, elements]]
            w = points[:, chosen]
            inside &= (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0]) > 0
        if np.any(inside):
            which = int(np.flatnonzero(inside)[0])
            return f"elements {first[chosen[which]]} and {elements[which]} overlap: a piece lies on another"
    return None


def _boundary(mesh: MeshTri) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ends (2, edges) of the boundary edges, and the element of each."""
    facets = np.flatnonzero(mesh.f2t[1] < 0)
    return np.asarray(mesh.facets[:, facets]), np.asarray(mesh.f2t[0, facets])


def _pieces(mesh: MeshTri) -> NDArray[np.int64]:
    """Number of the piece, connected over edges, of each element."""
    inner = mesh.f2t[:, mesh.f2t[1] >= 0]
    n = mesh.t.shape[1]
    graph = sp.coo_matrix((np.ones(inner.shape[1]), (inner[0], inner[1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _near(a: NDArray, b: NDArray, points: NDArray, radius: NDArray) -> Iterator[Pairs]:
    """Pairs (segment, point) of which the discs meet, those of the segments having them as diameters.

    Segments are taken by classes of length, within a factor of two.
    """
    length = np.linalg.norm(b - a, axis=0)
    middle = 0.5 * (a + b)
    kind = np.floor(np.log2(np.maximum(length, 1e-300))).astype(np.int64)
    for one in np.unique(kind):
        members = np.flatnonzero(kind == one)
        longest = 0.5 * np.max(length[members])
        # discs that are larger than these look for them when their own class is asked
        small = np.flatnonzero(radius <= (1 + ROUNDING) * longest)
        tree = cKDTree(middle[:, members].T)
        found = tree.query_ball_point(points[:, small].T, (1 + 1e-6) * (radius[small] + longest))
        count = np.fromiter(map(len, found), np.int64, small.size)
        if count.sum():
            yield members[np.concatenate(found).astype(np.int64)], np.repeat(small, count)


def _sides(a: NDArray, b: NDArray, c: NDArray, d: NDArray, far: NDArray) -> NDArray[np.bool_]:
    """Whether c and d lie on different sides of the lines through a and b, farther than ``far`` from them."""
    tangent = (b - a) / np.linalg.norm(b - a, axis=0)
    one, two = (tangent[0] * (x - a)[1] - tangent[1] * (x - a)[0] for x in (c, d))
    return np.asarray((one * two < 0) & (np.minimum(np.abs(one), np.abs(two)) > far))


def _some(numbers: NDArray[np.int64]) -> str:
    return ", ".join(str(n) for n in numbers[:4]) + (", ..." if numbers.size > 4 else "")
