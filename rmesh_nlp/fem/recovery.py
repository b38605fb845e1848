"""Second derivatives of a piecewise linear displacement, by fits of quadratic polynomials around each node.

The polynomial of a node is that of least squares through the nodal values of the triangles around it and
around its neighbours (Z. Zhang, A. Naga, A new finite element gradient recovery method, SIAM J. Sci. Comput.
26 (2005) 1192-1213). Fits never reach across a jump of the material, where second derivatives have one too.
Where they are unbounded, at corners and ends of contact, a fit has their size at the width of its patch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.interpolation_error import errors
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.laws import Law

Index = NDArray[np.int64]

UNKNOWNS = 6
"""Coefficients of a quadratic polynomial of two variables."""

NEARNESS = 2.0
"""Weights of nodes fall like ``exp(-NEARNESS r^2)``, with r in root mean squares of the patch. With weights
like ``1 / (1 + r^2)`` fits smooth too much: errors on adapted meshes are estimated at 0.27 to 1 times the
true ones in place of 0.8 to 1.06 (fifteen meshes of ``scripts/benchmark_mesh.py``)."""

CONDITION = 1e5
"""Largest condition number of the normal equations of a fit; a patch with more is enlarged."""

RINGS = 6
"""Most rings of neighbours that a patch may have. A region without fits has no second derivatives."""

ROUNDING = 1e-10
"""Part of the largest value that is rounding, across a patch: a linear displacement is recovered as one."""

CHUNK = 20_000
"""Nodes that are fitted together, so that the memory does not grow with the mesh."""


@dataclass(frozen=True)
class Recovered:
    """Second derivatives in one region of a mesh.

    Attributes
    ----------
    law : Law
    elements : (m,) int array
    nodes : (k,) int array
        Vertices of the region.
    triangles : (3, m) int array
        The elements by places in ``nodes``.
    second : (components, 3, k) array
        The derivatives xx, xy and yy of each component of the displacement at the nodes.
    """

    law: Law
    elements: Index
    nodes: Index
    triangles: Index
    second: Array

    @property
    def in_elements(self) -> Array:
        """(components, 3, m) means over the vertices of each element."""
        return np.asarray(self.second[:, :, self.triangles].mean(axis=2))


def second_derivatives(problem: ContactProblem, nodes: Array, values: Array) -> tuple[Recovered, ...]:
    """Recover the second derivatives region by region.

    ``nodes`` (2, vertices) are positions, ``values`` (components, vertices) the displacement there.
    """
    found = []
    for law, elements in problem.regions:
        used, flat = np.unique(problem.triangles[:, elements], return_inverse=True)
        triangles = flat.reshape(3, -1)
        second = _fitted(nodes[:, used], triangles, values[:, used])
        found.append(Recovered(law, elements, used, triangles, second))
    return tuple(found)


def interpolation_error(nodes: Array, triangles: Index, regions: Sequence[Recovered]) -> float:
    """Estimated error of the energy of the mesh that second derivatives were recovered on."""
    corners = nodes[:, triangles]
    return float(sum(errors(one.law, corners[:, :, one.elements], one.in_elements).sum() for one in regions))


def _fitted(p: Array, triangles: Index, values: Array) -> Array:
    n = p.shape[1]
    ends = np.hstack([triangles[[0, 1]], triangles[[1, 2]], triangles[[2, 0]]])
    ones = np.ones(ends.shape[1])
    near = sp.csr_array((ones, (ends[0], ends[1])), shape=(n, n))
    near = (near + near.T + sp.eye_array(n)).tocsr()
    found, todo, patch = np.zeros((values.shape[0], 3, n)), np.arange(n), near
    for _ in range(RINGS - 1):
        patch = sp.csr_array(patch @ near)  # of the nodes that are left
        failed = []
        for first in range(0, todo.size, CHUNK):
            here = todo[first : first + CHUNK]
            good, second = _fit(p, values, here, patch[first : first + CHUNK])
            found[:, :, here[good]] = second[:, :, good]
            failed.append(~good)
        rest = np.concatenate(failed)
        todo, patch = todo[rest], patch[np.flatnonzero(rest)]
        if todo.size == 0:
            break
    return found


def _fit(p: Array, values: Array, nodes: Index, patch: sp.csr_array) -> tuple[NDArray[np.bool_], Array]:
    """Whether the polynomials of some nodes are determined, and their second derivatives (c, 3, nodes).

    Each patch is mapped to one of unit second moments first, so that flat ones are as well-conditioned.
    """
    first, of = patch.indptr[:-1], patch.indices
    count = np.diff(patch.indptr)
    row = np.repeat(np.arange(nodes.size), count)

    def total(v: Array) -> Array:
        return np.asarray(np.add.reduceat(v, first, axis=-1))

    dx, dy = p[:, of] - p[:, nodes[row]]
    xx, xy, yy = (total(v) / count for v in (dx**2, dx * dy, dy**2))
    a = np.sqrt(xx)  # the Cholesky factor [[a, 0], [b, c]] of the moments
    b = xy / a
    c = np.sqrt(np.maximum(yy - b**2, 1e-300))
    x = dx / a[row]
    y = (dy - b[row] * x) / c[row]
    near = np.exp(-NEARNESS * (x**2 + y**2))
    terms = np.stack([np.ones_like(x), x, y, x**2 / 2, x * y, y**2 / 2])
    rise = values[:, of] - values[:, nodes[row]]
    matrix = np.empty((nodes.size, UNKNOWNS, UNKNOWNS))
    right = np.empty((nodes.size, UNKNOWNS, len(values)))
    for i, one in enumerate(terms):
        for j in range(i, UNKNOWNS):
            matrix[:, i, j] = matrix[:, j, i] = total(near * one * terms[j])
        right[:, i] = total(near * one * rise).T
    good = (count >= UNKNOWNS) & (np.linalg.cond(matrix) < CONDITION)
    solution = np.zeros_like(right)
    solution[good] = np.linalg.solve(matrix[good], right[good])
    solution[np.abs(solution) <= ROUNDING * np.max(np.abs(values), initial=0.0)] = 0.0
    s, t, u = (solution[:, i].T for i in (3, 4, 5))  # by x and y: back to dx and dy
    f, g, h = 1 / a, -b / (a * c), 1 / c
    return good, np.stack([f**2 * s + 2 * f * g * t + g**2 * u, h * (f * t + g * u), h**2 * u], axis=1)
