"""The metric of the best mesh: how many triangles where, how long in which direction.

In the metric every triangle is equilateral with edges of length one. Their shapes are those of least
interpolation error in the energy (:mod:`rmesh_nlp.fem.interpolation_error`), their number per area is
such that all triangles have the same error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.interpolation_error import LARGEST_ASPECT, best_shapes
from rmesh_nlp.fem.recovery import Recovered
from rmesh_nlp.meshes.geometry import signed_areas

EQUILATERAL = np.sqrt(3) / 4
"""Area of the triangle with edges of length one."""

FLOOR = 0.05
"""Least number of triangles per area, in parts of its mean: a linear displacement would need none.
Between 0.02 and 0.2 it hardly matters (L-shape, Example 6.3, free boundary, Signorini)."""


@dataclass(frozen=True)
class Metric:
    """A metric at the nodes of a mesh.

    Attributes
    ----------
    logarithm : (3, nodes) array
        Entries xx, xy and yy of the logarithm of the metric scaled to determinant one.
    density : (nodes,) array
        Triangles per area.
    weights : (nodes,) array
        Areas of the nodes, so that ``weights @ density`` is the number of triangles.
    """

    logarithm: Array
    density: Array
    weights: Array

    @property
    def triangles(self) -> float:
        """How many it asks for."""
        return float(self.weights @ self.density)

    def with_triangles(self, number: float) -> Metric:
        """The same for another number of triangles."""
        return Metric(self.logarithm, self.density * (number / self.triangles), self.weights)

    def evened(self, part: float) -> Metric:
        """With this part of the differences in shape and, in logarithms, in density."""
        return Metric(part * self.logarithm, self.density**part, self.weights)

    @property
    def tensors(self) -> Array:
        """(3, nodes) entries xx, xy and yy in one over length squared."""
        a, b, c = self.logarithm
        size = np.hypot(a, b)  # c is -a
        rate = np.divide(np.sinh(size), size, out=np.ones_like(size), where=size > 0)
        unit = np.stack([np.cosh(size) + rate * a, rate * b, np.cosh(size) + rate * c])
        return unit * (EQUILATERAL * self.density)


def best_metric(nodes: Array, regions: Sequence[Recovered], largest_aspect: float = LARGEST_ASPECT) -> Metric:
    """The metric for derivatives at nodes (2, nodes), with so many triangles as have error one each.

    At a node of several regions it is the mean over them. Without any derivatives it is uniform.
    """
    n = nodes.shape[1]
    logarithm, density, weights = np.zeros((3, n)), np.zeros(n), np.zeros(n)
    for region in regions:
        stretch, angle, phi = best_shapes(region.law, region.derivatives, largest_aspect)
        share = nodal_areas(nodes[:, region.nodes], region.triangles)
        rate = -2 * stretch  # short edges count more
        entries = np.stack([rate * np.cos(2 * angle), rate * np.sin(2 * angle), -rate * np.cos(2 * angle)])
        logarithm[:, region.nodes] += share * entries
        density[region.nodes] += share * phi ** (1 / region.degree)
        weights[region.nodes] += share
    total = np.where(weights > 0, weights, 1.0)  # a node may be of no triangle
    density /= total
    mean = float(weights @ density) / float(weights.sum())
    return Metric(logarithm / total, density + (FLOOR * mean or 1.0), weights)


def nodal_areas(nodes: Array, triangles: Index) -> Array:
    """(nodes,) a third of the area of the triangles at each node."""
    share = np.tile(signed_areas(nodes, triangles) / 3, 3)
    return np.asarray(np.bincount(triangles.ravel(), share, nodes.shape[1]), dtype=float)
