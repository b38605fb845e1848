"""Signed areas and orientation of triangles, and meshes with moved nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import Place, ProblemError, unknown

NAMELESS = (
    'the mesh names none: name groups in gmsh, such as Physical Curve("left") = {1};, '
    "or give conditions under [boundaries] and [subdomains] in a file"
)
"""What to do with a mesh without names."""

SEVEN_DIGITS = 1e-6
"""Relative distance of nodes that are at one place: files are often written with seven digits."""


def signed_areas(nodes: NDArray, triangles: NDArray) -> NDArray:
    """Signed area of each triangle, positive if counter-clockwise.

    ``nodes`` is (2, nodes), ``triangles`` (3, elements).
    """
    a, b, c = (nodes[:, vertex] for vertex in triangles)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]))


def counter_clockwise(nodes: NDArray, triangles: NDArray) -> NDArray[np.int64]:
    """The triangles (3, elements), clockwise ones turned."""
    t = np.array(triangles, dtype=np.int64)
    clockwise = signed_areas(nodes, t) < 0
    t[1:, clockwise] = t[:0:-1, clockwise]
    return t


def relocated_mesh(mesh: MeshTri, nodes: NDArray) -> MeshTri:
    """The mesh with its nodes at ``nodes`` (2, nodes), names kept."""
    return replace(mesh, doflocs=np.ascontiguousarray(nodes))


def members_of(
    kind: str, name: str, groups: Mapping[str, Any] | None, place: Place = ("mesh",)
) -> NDArray[np.int64]:
    """Numbers of the facets of a boundary, or of the elements of a subdomain, by its name.

    If the mesh has no such name, a ProblemError says so of a place of the problem.
    """
    if not groups or name not in groups:
        raise ProblemError(place, str(unknown(kind, name, groups or {}, NAMELESS)))
    return np.asarray(groups[name])


def nodes_of(mesh: MeshTri, name: str) -> NDArray[np.int64]:
    """Sorted numbers of the nodes on a named boundary; a ProblemError if there is none of this name."""
    return np.unique(mesh.facets[:, members_of("boundary", name, mesh.boundaries)]).astype(np.int64)


def node_at(mesh: MeshTri, place: tuple[float, float]) -> int:
    """The node at a place, to seven digits of the extent of the mesh; else a ValueError names the nearest."""
    distance = np.linalg.norm(mesh.p - np.array(place)[:, None], axis=0)
    node = int(np.argmin(distance))
    if not distance[node] <= SEVEN_DIGITS * float(np.max(np.ptp(mesh.p, axis=1))):
        x, y = mesh.p[:, node]
        raise ValueError(f"no node at {list(place)}; the nearest is node {node} at [{x:.6g}, {y:.6g}]")
    return node
