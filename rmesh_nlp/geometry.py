"""Signed areas of triangles."""

from __future__ import annotations

from numpy.typing import NDArray


def signed_areas(nodes: NDArray, triangles: NDArray) -> NDArray:
    """Signed area of each triangle, positive if counter-clockwise.

    ``nodes`` is (2, nodes), ``triangles`` (3, elements).
    """
    a, b, c = (nodes[:, vertex] for vertex in triangles)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]))
