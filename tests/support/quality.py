"""The quality of triangles, and sizes of the parts of a mesh."""

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.meshes.geometry import signed_areas


def shape_quality(nodes: NDArray, triangles: NDArray) -> NDArray:
    """``4 sqrt(3) area / (sum of squared edges)``: 1 if equilateral, negative if inverted."""
    corner = nodes[:, triangles]
    edges = np.sum((corner - np.roll(corner, 1, axis=1)) ** 2, axis=(0, 1))
    return np.asarray(4 * np.sqrt(3) * signed_areas(nodes, triangles) / np.maximum(edges, 1e-300))


def sizes(mesh: MeshTri) -> dict[str, float]:
    """Lengths of named boundaries, areas of named subdomains, and the whole area."""
    found = {"": float(np.abs(signed_areas(mesh.p, mesh.t)).sum())}
    for name, facets in (mesh.boundaries or {}).items():
        a, b = mesh.facets[:, facets]
        found[name] = float(np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0).sum())
    for name, elements in (mesh.subdomains or {}).items():
        found[name] = float(np.abs(signed_areas(mesh.p, mesh.t))[elements].sum())
    return found
