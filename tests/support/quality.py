"""The quality of triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.meshes.geometry import signed_areas


def shape_quality(nodes: NDArray, triangles: NDArray) -> NDArray:
    """``4 sqrt(3) area / (sum of squared edges)``: 1 if equilateral, negative if inverted."""
    corner = nodes[:, triangles]
    edges = np.sum((corner - np.roll(corner, 1, axis=1)) ** 2, axis=(0, 1))
    return np.asarray(4 * np.sqrt(3) * signed_areas(nodes, triangles) / np.maximum(edges, 1e-300))
