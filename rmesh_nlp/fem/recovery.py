"""The derivatives that a displacement lacks, by fits of polynomials of one degree more around each vertex.

They are the second ones of linear displacements, the third ones of quadratic displacements. The polynomial
of a vertex is that of least squares through the values at the nodes of the triangles around it and around its
neighbours (Z. Zhang, A. Naga, A new finite element gradient recovery method,
SIAM J. Sci. Comput. 26 (2005) 1192-1213). Fits never reach across a jump of the material, where these
derivatives have one too. Where they are unbounded, at corners and ends of contact, a fit has their size at
the width of its patch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude
from rmesh_nlp.fem.interpolation_error import errors
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.vectorised import CHUNK

NEARNESS = {2: 2.0, 3: 10.0}
"""By degree: weights of nodes fall like ``exp(-NEARNESS r^2)``, with r in root mean squares of the patch.

With weights like ``1 / (1 + r^2)`` fits of degree 2 smooth too much: errors on adapted meshes are estimated
at 0.27 to 1 times the true ones in place of 0.8 to 1.06 (fifteen meshes of ``scripts/benchmark_mesh.py``).
With cubic polynomials through the nodes of the nearest triangles alone, errors of new meshes were estimated
at up to 20 times the true ones; with these weights at 0.5 to 1.2 (Example 6.1, L-shape, Example 6.3,
wedge)."""

CONDITION = {2: 1e5, 3: 1e7}
"""Largest condition number of the normal equations of a fit of a degree; a patch with more is enlarged."""


RINGS = 6
"""Most rings of neighbours that a patch may have. A region without fits has no second derivatives."""


@dataclass(frozen=True)
class Recovered:
    """Derivatives of a degree in one region of a mesh.

    Attributes
    ----------
    law : Law
    elements : (m,) int array
    nodes : (k,) int array
        Vertices of the region.
    triangles : (3, m) int array
        The elements by places in ``nodes``.
    derivatives : (components, degree + 1, k) array
        xx, xy and yy, or xxx, xxy, xyy and yyy, of each component of the displacement at the nodes, times the
        root of the law's measure: errors are quadratic in them, and so have the measure.
    """

    law: Law
    elements: Index
    nodes: Index
    triangles: Index
    derivatives: Array

    @property
    def degree(self) -> int:
        """Of the derivatives."""
        return self.derivatives.shape[1] - 1

    @property
    def in_elements(self) -> Array:
        """(components, degree + 1, m) means over the vertices of each element."""
        return self.derivatives[:, :, self.triangles].mean(axis=2)


def recovered(space: DisplacementSpace, nodes: Array, coefficients: Array) -> tuple[Recovered, ...]:
    """Recover the derivatives of one degree more than the displacement has, region by region.

    ``nodes`` (2, vertices) are positions, ``coefficients`` (components, nodes) the displacement.
    """
    regions, points, values = [], space.points_on_body(nodes), space.values(coefficients)
    for law, elements in space.problem.regions:
        used, flat = np.unique(space.problem.triangles[:, elements], return_inverse=True)
        at_nodes, own = np.unique(space.elements[:, elements], return_inverse=True)
        triangles, own = flat.reshape(3, -1), own.reshape(-1, elements.size)
        centres = own[:3].ravel()[np.unique(triangles, return_index=True)[1]]
        fits = _Fits(points[:, at_nodes], values[:, at_nodes], centres, space.order + 1)
        derivatives = fits.over(triangles, own) * np.sqrt(space.problem.measured(nodes[:, used]))
        regions.append(Recovered(law, elements, used, triangles, derivatives))
    return tuple(regions)


def interpolation_error(nodes: Array, triangles: Index, regions: Sequence[Recovered]) -> float:
    """Estimated error of the energy of the mesh that derivatives were recovered on."""
    corners = nodes[:, triangles]
    return float(
        sum(errors(part.law, corners[:, :, part.elements], part.in_elements).sum() for part in regions)
    )


class _Fits:
    """Polynomials of a degree around some of the points (2, nodes) with values (components, nodes)."""

    def __init__(self, points: Array, values: Array, centres: Index, degree: int) -> None:
        self._points, self._values, self._centres, self._degree = points, values, centres, degree
        self._least = ROUNDING * magnitude(values)

    def over(self, triangles: Index, nodes: Index) -> Array:
        """Derivatives (components, degree + 1, centres), by triangles and their nodes (per triangle, m)."""
        n = self._centres.size
        place = np.repeat(triangles, len(nodes), axis=0).ravel(), np.tile(nodes, (3, 1)).ravel()
        around = sp.csr_array((np.ones(place[0].size), place), shape=(n, self._points.shape[1]))
        around.sum_duplicates()
        near = around[:, self._centres]
        result, todo, reach = np.zeros((self._values.shape[0], self._degree + 1, n)), np.arange(n), near
        for _ in range(RINGS - 1):
            patch, failed = reach @ around, []
            for first in range(0, todo.size, CHUNK):
                chunk = todo[first : first + CHUNK]
                good, derivatives = self._fit(self._centres[chunk], patch[first : first + CHUNK])
                result[:, :, chunk[good]] = derivatives[:, :, good]
                failed.append(~good)
            rest = np.concatenate(failed)
            todo = todo[rest]
            if todo.size == 0:
                break
            reach = reach[np.flatnonzero(rest)] @ near
        return result

    def _fit(self, nodes: Index, patch: sp.csr_array) -> tuple[Mask, Array]:
        """Whether polynomials around nodes are determined, and their derivatives (c, degree + 1, nodes).

        Each patch is mapped to one of unit second moments first, so that flat ones are as well-conditioned.
        """
        p, values, degree = self._points, self._values, self._degree
        first, of = patch.indptr[:-1], patch.indices
        count = np.diff(patch.indptr)
        row = np.repeat(np.arange(nodes.size), count)

        def total(v: Array) -> Array:
            return np.add.reduceat(v, first, axis=-1)

        dx, dy = p[:, of] - p[:, nodes[row]]
        xx, xy, yy = (total(v) / count for v in (dx**2, dx * dy, dy**2))
        a = np.sqrt(xx)  # the Cholesky factor [[a, 0], [b, c]] of the moments
        b = xy / a
        c = np.sqrt(np.maximum(yy - b**2, 1e-300))
        x = dx / a[row]
        y = (dy - b[row] * x) / c[row]
        near = np.exp(-NEARNESS[degree] * (x**2 + y**2))
        powers = [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]
        terms = np.stack([x**i * y**j / (factorial(i) * factorial(j)) for i, j in powers])
        rise, unknowns = values[:, of] - values[:, nodes[row]], len(terms)
        matrix = np.empty((nodes.size, unknowns, unknowns))
        right = np.empty((nodes.size, unknowns, len(values)))
        for i, term in enumerate(terms):
            for j in range(i, unknowns):
                matrix[:, i, j] = matrix[:, j, i] = total(near * term * terms[j])
            right[:, i] = total(near * term * rise).T
        good = (count >= unknowns) & (np.linalg.cond(matrix) < CONDITION[degree])
        solution = np.zeros_like(right)
        solution[good] = np.linalg.solve(matrix[good], right[good])
        solution[np.abs(solution) <= self._least] = 0.0  # a linear displacement is recovered as one
        # by x and y: back to dx and dy
        highest, f, g, h = solution[:, -degree - 1 :].T, 1 / a, -b / (a * c), 1 / c
        derivatives = [
            h**j
            * sum(
                comb(degree - j, k) * f ** (degree - j - k) * g**k * highest[:, j + k]
                for k in range(degree - j + 1)
            )
            for j in range(degree + 1)
        ]
        return good, np.stack(derivatives, axis=1)
