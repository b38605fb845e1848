"""Signed areas and orientation of triangles, and meshes with moved nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.spatial.distance import directed_hausdorff
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, Place, ProblemError, unknown
from rmesh_nlp.evaluation import Array, Index, cross, largest_side
from rmesh_nlp.settings import ByName, Values

NAMELESS = (
    'the mesh names none: name groups in gmsh, such as Physical Curve("left") = {1};, '
    "or give conditions under [boundaries] and [subdomains] in a file"
)
"""What to do with a mesh without names."""

EPSILON = float(np.finfo(float).eps)

SEVEN_DIGITS = 1e-6
"""Relative distance of nodes that are at one place: files are often written with seven digits."""


def mismatch(p: Array, nodes: Sequence[Index], names: tuple[str, str]) -> str:
    """What to say of nodes of two boundaries that are not at the same places; empty if they are."""
    a, b = (p[:, each].T for each in nodes)
    far = max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0])
    if far <= SEVEN_DIGITS * largest_side(p):
        return ""
    return (
        f"nodes of {names[0]!r} and {names[1]!r} do not coincide: the largest distance is {far:.3g}; "
        "give both boundaries nodes at the same places"
    )


def last_digit(nodes: NDArray) -> float:
    """Spacing of the coordinates that can be written with as many decimals and digits as those of ``nodes``.

    The larger one of the last decimal and of the last significant digit of the largest coordinate; numbers
    of single precision have seven digits.
    """
    x = np.abs(nodes[nodes != 0])
    exponent = np.floor(np.log10(x))
    digit = 10.0 ** (np.max(exponent) - _decimals(x / 10.0**exponent))
    single = np.spacing(np.max(x).astype(np.float32)) if np.all(x.astype(np.float32) == x) else 0.0
    return float(max(10.0 ** -_decimals(x), digit, single))


def _decimals(x: NDArray) -> int:
    """The least number with which all numbers can be written."""
    scaled = (x * 10.0**k for k in range(20))
    return next((k for k, s in enumerate(scaled) if np.all(np.abs(s - np.rint(s)) <= 8 * EPSILON * s)), 20)


def signed_areas(nodes: NDArray, triangles: NDArray) -> NDArray:
    """Signed area of each triangle, positive if counter-clockwise.

    ``nodes`` is (2, nodes), ``triangles`` (3, elements).
    """
    a, b, c = (nodes[:, vertex] for vertex in triangles)
    return 0.5 * cross(b - a, c - a)


def angles(nodes: NDArray, triangles: NDArray) -> NDArray:
    """(3, triangles) angles at the vertices, in radians."""
    p = nodes[:, triangles]
    a, b = (np.roll(p, turn, axis=1) - p for turn in (1, 2))
    return np.arctan2(np.abs(cross(a, b)), np.sum(a * b, axis=0))


def counter_clockwise(nodes: NDArray, triangles: NDArray) -> Index:
    """The triangles (3, elements), clockwise ones turned."""
    t = np.array(triangles, dtype=np.int64)
    clockwise = signed_areas(nodes, t) < 0
    t[1:, clockwise] = t[:0:-1, clockwise]
    return t


def relocated_mesh(mesh: MeshTri, nodes: NDArray) -> MeshTri:
    """The mesh with its nodes at ``nodes`` (2, nodes), names kept."""
    return replace(mesh, doflocs=np.ascontiguousarray(nodes))


def members_of(kind: str, name: str, groups: ByName | None, place: Place = ("mesh",)) -> Index:
    """Numbers of the facets of a boundary, or of the elements of a subdomain, by its name.

    If the mesh has no such name, a ProblemError says so of a place of the problem.
    """
    if not groups:
        raise ProblemError(place, f"unknown {kind} {name!r}: {NAMELESS}")
    if name not in groups:
        raise ProblemError(place, str(unknown(kind, name, groups)))
    return np.asarray(groups[name])


def edges_on(mesh: MeshTri, name: str) -> Index:
    """(2, edges) ends of the edges of a named boundary."""
    return mesh.facets[:, members_of("boundary", name, mesh.boundaries)]


def nodes_of(mesh: MeshTri, name: str) -> Index:
    """Sorted numbers of the nodes on a named boundary; a ProblemError if there is none of this name."""
    return np.unique(edges_on(mesh, name)).astype(np.int64)


def node_at(mesh: MeshTri, place: tuple[float, float]) -> int:
    """The node at a place, to seven digits of the extent of the mesh; else a ValueError names the nearest."""
    distance = np.linalg.norm(mesh.p - np.array(place)[:, None], axis=0)
    node = int(np.argmin(distance))
    if not distance[node] <= SEVEN_DIGITS * largest_side(mesh.p):
        x, y = mesh.p[:, node]
        raise BadInputError(f"no node at {list(place)}; the nearest is node {node} at [{x:.6g}, {y:.6g}]")
    return node


def have_same_mesh(a: MeshTri, b: MeshTri) -> bool:
    """Whether they have the same nodes and triangles."""
    return a is b or (np.array_equal(a.p, b.p) and np.array_equal(a.t, b.t))


def lengths(nodes: NDArray, edges: NDArray) -> NDArray:
    """Of edges, numbers (2, m) of their ends."""
    return np.linalg.norm(nodes[:, edges[1]] - nodes[:, edges[0]], axis=0)


def edge_keys(edges: NDArray, n: int) -> Index:
    """A number for each edge (2, m) between n nodes, whichever end is first."""
    # scikit-fem's numbers of nodes are 32 bits wide, their products are not
    return np.min(edges, axis=0) * np.int64(n) + np.max(edges, axis=0)


def pieces_of(pairs: NDArray, n: int) -> Index:
    """(n,) number of the piece that each of n things is in, which ``pairs`` (2, m) of them connect."""
    graph = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])


def sides(triangles: NDArray) -> NDArray:
    """The three edges of each triangle, (2, 3 m)."""
    return np.hstack([triangles[[i, (i + 1) % 3]] for i in range(3)])


def named_by_user(groups: ByName | None) -> Values:
    """Boundaries or subdomains without those that gmsh makes of itself."""
    return {name: part for name, part in (groups or {}).items() if not name.startswith("gmsh:")}


def lines_of(edges: Index, points: Array) -> list[Index]:
    """Numbers (k,) of points (2, n) along each of the lines that edges (2, m) between them form.

    A line begins at its end at the left; a closed one ends where it begins. Where lines meet, one goes on.
    """
    edges = np.unique(np.sort(edges, axis=0), axis=1)
    times = np.bincount(edges.ravel(), minlength=points.shape[1])
    joined = csr_matrix((np.ones(edges.shape[1]), edges), shape=(times.size, times.size))
    lines, seen = list[Index](), times == 0
    for start in np.lexsort((*points[::-1], times != 1)).tolist():  # ends come first
        if not seen[start]:
            line = depth_first_order(joined, start, directed=False, return_predecessors=False)
            seen[line] = True
            lines.append(np.append(line, line[: int(times[start] > 1)]).astype(np.int64))
    return lines
