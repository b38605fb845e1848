"""Strain energy, work and friction energy of a displacement that is linear on blended triangles.

Numbering: component i of node k is entry ``components * k + i`` of a nodal vector.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.integrals import EdgePoints, over_edges, over_triangles
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body, Edges, Index, gradients
from rmesh_nlp.problem.coefficients import Coefficient, is_nonzero, on_points, polynomial_degree
from rmesh_nlp.problem.laws import Laplace, Law
from rmesh_nlp.problem.obstacle import Obstacle

STIFFNESS_POINTS = 6
"""Gauss points per direction of a blended triangle."""


def stiffness(body: Body, space: DisplacementSpace) -> sp.csc_array:
    """The matrix K of ``1/2 u K u``, the strain energy."""
    problem = body.problem
    n = problem.components * space.n_nodes
    matrix = sp.csc_array((n, n))
    for law, region in problem.regions:
        curved = body.is_curved[region]
        for elements, points in ((region[~curved], 1), (region[curved], STIFFNESS_POINTS)):

            def integrand(which: Index, barycentric: Array, _: Array, law: Law = law) -> Array:
                gradient = gradients(body.at(which, barycentric)[1])[0]
                return _density(law, gradient).reshape(-1, *gradient.shape[2:])

            if elements.size:
                local = over_triangles(body, elements, integrand, points)[0]
                nodes = problem.components * space.elements[:, None, elements]
                dofs = (nodes + np.arange(problem.components)[:, None]).reshape(-1, elements.size)
                place = np.repeat(dofs, len(dofs), axis=0).ravel(), np.tile(dofs, (len(dofs), 1)).ravel()
                matrix += sp.csc_array(sp.coo_array((local.ravel(), place), shape=(n, n)))
    return matrix


def _density(law: Law, gradient: Array) -> Array:
    """Integrand (3 components, 3 components, m, k) of the stiffness for gradients (3, 2, m, k)."""
    inner = np.einsum("aimk,bimk->abmk", gradient, gradient)
    if isinstance(law, Laplace):
        return law.conductivity * inner
    lam, mu = law.in_plane_lambda, law.lame_mu
    full = lam * np.einsum("aimk,bjmk->aibjmk", gradient, gradient)
    full += mu * np.einsum("ajmk,bimk->aibjmk", gradient, gradient)
    for i in range(2):
        full[:, i, :, i] += mu * inner
    return full.reshape(6, 6, *gradient.shape[2:])


def load_vector(body: Body, space: DisplacementSpace) -> tuple[Array, Array]:
    """F of the work ``F u`` of all loads: sources or body forces, tractions, point loads; and its doubt."""
    problem = body.problem
    load, doubt = np.zeros((2, space.n_nodes, problem.components))

    def add(i: int, nodes: Index, found: tuple[Array, Array]) -> None:
        for target, shares in zip((load, doubt), found, strict=True):
            np.add.at(target[:, i], nodes, shares)

    for law, elements in problem.regions:
        for i, coefficient in enumerate(law.load):
            if is_nonzero(coefficient) and elements.size:
                add(i, space.elements[:, elements], _body_load(body, coefficient, elements))
    for traction in problem.tractions:
        edges = body.edges(traction.boundary)
        for i, coefficient in enumerate(traction.value):
            if is_nonzero(coefficient):
                add(i, space.nodes_of(edges.ends), hat_integrals(edges.at, edges.size, coefficient))
    for point in problem.point_loads:
        load[space.number[point.node]] += point.force
    return load.ravel(), doubt.ravel()


def _body_load(body: Body, coefficient: Coefficient, elements: Index) -> tuple[Array, Array]:
    degree = polynomial_degree(coefficient)
    straight = not np.any(body.is_curved[elements])
    points = None if degree is None or not straight else degree // 2 + 2

    def integrand(_: Index, barycentric: Array, where: Array) -> Array:
        return barycentric * _values(coefficient, where)

    return over_triangles(body, elements, integrand, points)


def hat_integrals(at: EdgePoints, size: int, coefficient: Coefficient) -> tuple[Array, Array]:
    """Integrals (2, edges) of a coefficient times ``1 - s`` and ``s`` along edges, and their doubts."""

    def integrand(_: Index, s: Array, where: Array) -> Array:
        return np.stack([1 - s, s]) * _values(coefficient, where)

    return over_edges(at, size, integrand)


def _values(coefficient: Coefficient, where: Array) -> Array:
    """Values (m, k) at points (2, m, k)."""
    return on_points(coefficient, where.reshape(2, -1), "a load").reshape(where.shape[1:])


STEPS = 3
"""Steps to the point of an edge at which the slip changes sign; one is exact on a straight foundation."""


def friction_energy(edges: Edges, obstacle: Obstacle, ends: Array) -> tuple[Array, Array]:
    """(edges,) integrals of the friction bound times the size of the slip, and what they may be wrong by.

    The displacement has the values ``ends`` (2, 2 ends, edges). Edges are split where the slip changes sign.
    """

    def slip(rows: Index, s: Array, where: Array) -> Array:
        normals = obstacle.normals(where.reshape(2, -1)).reshape(where.shape)
        u = ends[:, 0, rows, None] * (1 - s) + ends[:, 1, rows, None] * s
        return np.asarray(normals[1] * u[0] - normals[0] * u[1])

    split = _zeros(lambda rows, s: slip(rows, s, edges.at(rows, s)[0]), edges.size)
    # each edge twice: before and behind the point where the slip changes sign
    low = np.concatenate([np.zeros(edges.size), split])
    width = np.concatenate([split, 1 - split])

    def at(part: Index, s: Array) -> tuple[Array, Array]:
        where, speed = edges.at(part % edges.size, low[part, None] + width[part, None] * s)
        return where, speed * width[part, None]

    def integrand(part: Index, s: Array, where: Array) -> Array:
        along = low[part, None] + width[part, None] * s
        bound = on_points(obstacle.friction, where.reshape(2, -1), "the friction bound")
        return (bound.reshape(s.shape) * np.abs(slip(part % edges.size, along, where)))[None]

    total, doubt = over_edges(at, 2 * edges.size, integrand)
    return total.reshape(2, -1).sum(axis=0), doubt.reshape(2, -1).sum(axis=0)


def _zeros(slip: Callable[[Index, Array], Array], size: int) -> Array:
    """(edges,) where the slip changes sign, by the regula falsi; the middle where it does not."""
    rows = np.arange(size)
    low, high = np.zeros(size), np.ones(size)
    at_low, at_high = (slip(rows, s[:, None])[:, 0] for s in (low, high))
    changes = at_low * at_high < 0
    middle = np.full(size, 0.5)
    for _ in range(STEPS):
        slope = np.where(changes, at_high - at_low, 1.0)
        middle = np.where(changes, low - at_low * (high - low) / slope, 0.5)
        here = slip(rows, middle[:, None])[:, 0]
        same = here * at_low > 0
        low, at_low = np.where(same, middle, low), np.where(same, here, at_low)
        high, at_high = np.where(same, high, middle), np.where(same, at_high, here)
        changes = changes & (here != 0)
    return middle
