"""Fine meshes as images: their elements are smaller than what print resolves, and one by one take minutes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array

FINE = 10_000
"""Triangles above which a mesh is drawn as an image."""

ACROSS = 900
"""Pixels along the longer side of the window: 300 to the inch in a panel of three inches."""

SAMPLES = 2
"""Points per pixel along an edge."""

Window = tuple[tuple[float, float], tuple[float, float]]
"""Limits along x and along y."""


def is_fine(triangles: NDArray[Any]) -> bool:
    """Whether a mesh (3, elements) is drawn as an image."""
    return bool(triangles.shape[1] > FINE)


def field_image(nodes: Array, triangles: NDArray[Any], values: Array) -> tuple[Any, Window]:
    """A field as an image over the window of the nodes, masked outside of the mesh.

    Parameters
    ----------
    nodes : (2, nodes) array
    triangles : (3, elements) array
    values : (nodes,) or (elements,) array
        Interpolated linearly, or constant on every element.
    """
    window, x, y = _grid(nodes)
    mesh = Triangulation(nodes[0], nodes[1], triangles.T)
    X, Y = np.meshgrid(x, y)
    element = np.asarray(mesh.get_trifinder()(X, Y), dtype=np.int64)
    inside = element >= 0
    image = np.zeros(element.shape)
    found = element[inside]
    if values.size == triangles.shape[1]:
        image[inside] = values[found]
    else:
        corner = nodes[:, triangles[:, found]]
        point = np.stack([X[inside], Y[inside]])
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        whole = _cross(b - a, c - a)
        parts = [_cross(b - point, c - point), _cross(c - point, a - point), _cross(a - point, b - point)]
        image[inside] = sum(p / whole * values[v] for p, v in zip(parts, triangles[:, found], strict=True))
    return np.ma.masked_array(image, ~inside), window


def draw_field(axis: Axes, nodes: Array, triangles: NDArray[Any], values: Array, **options: Any) -> Any:
    """Draw a field on a fine mesh; returns the image for a colour bar."""
    image, window = field_image(nodes, triangles, values)
    return _show(axis, image, window, interpolation="nearest", **options)


def draw_edges(axis: Axes, nodes: Array, edges: NDArray[Any], color: str) -> None:
    """Draw the edges (2, edges) of a fine mesh: the more of them meet a pixel, the darker it is."""
    darkness, window = edge_image(nodes, edges)
    image = np.ones((*darkness.shape, 4))
    image[..., :3] = to_rgb(color)
    image[..., 3] = darkness
    _show(axis, image, window, interpolation="antialiased")


def edge_image(nodes: Array, edges: NDArray[Any]) -> tuple[Array, Window]:
    """How much of each pixel edges cover, from 0 to 1, over the window of the nodes."""
    window, x, y = _grid(nodes)
    width = max(x[1] - x[0], y[1] - y[0])
    ends = nodes[:, edges]
    longest = float(np.max(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0), initial=0.0))
    count = max(2, int(np.ceil(SAMPLES * longest / width)))
    share = (np.arange(count) + 0.5) / count
    points = ends[:, 0, :, None] + (ends[:, 1] - ends[:, 0])[..., None] * share
    hits, _, _ = np.histogram2d(
        points[1].ravel(), points[0].ravel(), bins=(y.size, x.size), range=(window[1], window[0])
    )
    # an edge of length l has ``count`` points on l / width pixels
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0)
    per_pixel = count * width / max(float(np.mean(lengths)), 1e-300)
    return np.minimum(0.5 * hits / per_pixel, 1.0), window


def _show(axis: Axes, image: Any, window: Window, **options: Any) -> Any:
    return axis.imshow(image, extent=(*window[0], *window[1]), origin="lower", aspect="equal", **options)


def _grid(nodes: Array) -> tuple[Window, Array, Array]:
    """The window of the nodes, and the centres of its pixels along x and y."""
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    width = float(np.max(high - low)) / ACROSS
    numbers = np.maximum(np.ceil((high - low) / width).astype(int), 2)
    window = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
    x, y = (low[i] + (np.arange(numbers[i]) + 0.5) * (high[i] - low[i]) / numbers[i] for i in range(2))
    return window, x, y


def _cross(u: Array, v: Array) -> Array:
    return np.asarray(u[0] * v[1] - u[1] * v[0])
