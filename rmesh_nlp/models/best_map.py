"""The best mesh of the same connectivity by the interpolation error alone: what relocation can reach.

The derivatives are frozen functions of position, so that no contact problem is solved. A small weight of
the distortion keeps triangles upright, as in relocation itself. A mesh of more than a few hundred nodes is
coarsened: the best positions are a map of the domain, and a coarse one gains less than a fine one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.element import affine
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.fem.interpolation_error import errors
from rmesh_nlp.fem.recovery import Recovered
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.models.levels import coarsened, located
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.vectorised import columnwise

NODES = 300
"""Largest number of nodes of the mesh that is looked at."""

WEIGHTS = (1.0, 0.1, 0.01, 0.003)
"""Of the distortion in turn, in parts of the error on the given mesh: those of the cascade."""

ITERATIONS, PAIRS = 100, 20
"""Of the search with each weight."""

FIRST, ENOUGH = 0.1, 1e-5
"""Length of the first step, in shortest edges; part of the error in a step below which the search ends."""


def best_map(problem: ContactProblem, nodes: Array, regions: Sequence[Recovered]) -> float:
    """Factor by which moving the nodes alone can lower the interpolation error.

    Parameters
    ----------
    problem : ContactProblem
    nodes : (2, vertices) array
        Vertices of the mesh of ``regions``, which has the same domain and may be finer.
    regions : sequence of Recovered
    """
    while problem.mesh.p.shape[1] > NODES and (coarse := coarsened(problem, 0)) is not None:
        problem = coarse
    X0, mesh_map = np.asarray(problem.mesh.p), MeshMap.of(problem)
    positions, triangles = mesh_map.positions, problem.triangles
    moving, areas = positions.index != CONSTANT, signed_areas(X0, triangles)
    parts = [
        _Part(region, nodes, X0, triangles[:, elements])
        for region, (_, elements) in zip(regions, problem.regions, strict=True)
    ]
    given = sum(part(X0, 0.0)[0] for part in parts)
    if mesh_map.n == 0 or not given > 0:
        return 1.0

    def value(q: Array, unit: float) -> tuple[float, Array]:
        X = positions.values(q)
        if not np.min(signed_areas(X, triangles)) > 0:
            return np.inf, q
        results = [part(X, unit) for part in parts]
        slope = (np.sum([result[2] for result in results], axis=0) * positions.slopes(q))[moving]
        whole = sum(result[1] for result in results)
        return whole / given, np.bincount(positions.index[moving], slope, q.size) / given

    q = np.zeros(mesh_map.n)
    for weight in WEIGHTS:
        q = _minimiser(partial(value, unit=weight * given / (2 * float(areas.sum()))), q)
    X = positions.values(q)
    return max(1.0, given / sum(part(X, 0.0)[0] for part in parts))


def _minimiser(value: Callable[[Array], tuple[float, Array]], x: Array) -> Array:
    """Where L-BFGS ends (J. Nocedal, Math. Comp. 35 (1980) 773-782), within the domain of a finite value."""
    f, g = value(x)
    pairs: deque[tuple[Array, Array]] = deque(maxlen=PAIRS)
    for _ in range(ITERATIONS):
        d, parts = g.copy(), []
        for s, y in reversed(pairs):
            parts.append(float(s @ d) / float(s @ y))
            d -= parts[-1] * y
        s, y = pairs[-1] if pairs else (FIRST * g / max(float(np.linalg.norm(g)), 1e-300), g)
        d *= float(s @ y) / max(float(y @ y), 1e-300)
        for (s, y), part in zip(pairs, reversed(parts), strict=True):
            d += (part - float(y @ d) / float(s @ y)) * s
        step, (trial, slope) = 1.0, value(x - d)
        while not trial <= f - 1e-4 * step * float(g @ d):
            step /= 2
            if step < 1e-6:
                return x
            trial, slope = value(x - step * d)
        if float(d @ (g - slope)) > 0:
            pairs.append((-step * d, slope - g))
        x, g, fall, f = x - step * d, slope, f - trial, trial
        if fall < ENOUGH * f:
            break
    return x


class _Part:
    """The interpolation error of one region as a function of the positions of all vertices."""

    def __init__(self, region: Recovered, nodes: Array, X0: Array, triangles: NDArray[np.int64]) -> None:
        self._triangles, self._region, self._nodes = triangles, region, nodes[:, region.nodes]
        self._given = _columns(X0, triangles)
        X, X_0, H, unit = (
            *(ca.SX.sym(name, 2, 3) for name in ("X", "X0")),
            ca.SX.sym("H", region.degree + 1, len(region.derivatives)),
            ca.SX.sym("unit"),
        )
        corners = [[X[i, k] for k in range(3)] for i in range(2)]
        error = errors(region.law, corners, [ca.vertsplit(H[:, k]) for k in range(H.shape[1])])
        det, scaled = affine(X_0, X)
        A = scaled / det
        whole = error + unit * det * DISTORTIONS["shape-size"](ca.sumsqr(A), ca.det(A))
        results = [error, whole, ca.gradient(whole, ca.vec(X)), ca.gradient(whole, ca.vec(H))]
        function = ca.Function("interpolation", [ca.vec(X), ca.vec(H), ca.vec(X_0), unit], results)
        self._evaluate = columnwise(function, triangles.shape[1])

    def __call__(self, X: Array, unit: float) -> tuple[float, float, Array]:
        """The error, with the distortion, and the derivatives (2, vertices) of that."""
        t, second = self._triangles, self._region.derivatives
        centres = X[:, t].mean(axis=1)
        vertices, weights = located(self._nodes, self._region.triangles, centres)
        H = second[:, :, vertices].reshape(-1, *vertices.shape)  # (entries, 3, elements)
        at_centres, units = np.einsum("hvk,vk->hk", H, weights), np.full((1, t.shape[1]), unit)
        error, whole, by_corners, by_second = self._evaluate([_columns(X, t), at_centres, self._given, units])
        (a, b), (c, d) = (self._nodes[:, vertices[i]] - self._nodes[:, vertices[0]] for i in (1, 2))
        along_1, along_2 = H[:, 1] - H[:, 0], H[:, 2] - H[:, 0]
        slope = np.stack([d * along_1 - b * along_2, a * along_2 - c * along_1]) / (a * d - b * c)
        by_corner = by_corners.reshape(3, 2, -1).transpose(1, 0, 2)
        by_corner = by_corner + np.einsum("xhk,hk->xk", slope, by_second)[:, None] / 3
        slopes = [np.bincount(t.ravel(), part.ravel(), X.shape[1]) for part in by_corner]
        return float(error.sum()), float(whole.sum()), np.stack(slopes)


def _columns(X: Array, triangles: NDArray[np.int64]) -> Array:
    """(6, elements) vertices of triangles, x and y in turn."""
    return np.asarray(X[:, triangles].transpose(1, 0, 2).reshape(6, -1))
