"""Strain energy, work and friction energy of a displacement on the triangles, straight or blended, of a body.

Numbering: component i of node k is entry ``components * k + i`` of a nodal vector.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.integrals import Integral, over_edges, over_triangles
from rmesh_nlp.assessment.parts import EdgePoints
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions, slopes
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
        for elements, points in ((region[~curved], space.order), (region[curved], STIFFNESS_POINTS)):

            def integrand(which: Index, barycentric: Array, _: Array, law: Law = law) -> Array:
                coordinates = gradients(body.at(which, barycentric)[1])[0]
                gradient = np.einsum("avmk,vimk->aimk", slopes(space.order, barycentric), coordinates)
                return _density(law, gradient).reshape(-1, *gradient.shape[2:])

            if elements.size:
                local = over_triangles(body, elements, integrand, points).value
                nodes = problem.components * space.elements[:, None, elements]
                dofs = (nodes + np.arange(problem.components)[:, None]).reshape(-1, elements.size)
                place = np.repeat(dofs, len(dofs), axis=0).ravel(), np.tile(dofs, (len(dofs), 1)).ravel()
                matrix += sp.csc_array(sp.coo_array((local.ravel(), place), shape=(n, n)))
    return matrix


def _density(law: Law, gradient: Array) -> Array:
    """Integrand (n components, n components, m, k) of the stiffness for gradients (n, 2, m, k)."""
    inner = np.einsum("aimk,bimk->abmk", gradient, gradient)
    if isinstance(law, Laplace):
        return law.conductivity * inner
    lam, mu = law.in_plane_lambda, law.lame_mu
    full = lam * np.einsum("aimk,bjmk->aibjmk", gradient, gradient)
    full += mu * np.einsum("ajmk,bimk->aibjmk", gradient, gradient)
    for i in range(2):
        full[:, i, :, i] += mu * inner
    return full.reshape(2 * len(gradient), 2 * len(gradient), *gradient.shape[2:])


def load_vector(body: Body, space: DisplacementSpace) -> tuple[Array, Array]:
    """F of the work ``F u`` of all loads: sources or body forces, tractions, point loads; and its doubt."""
    problem = body.problem
    load, doubt = np.zeros((2, space.n_nodes, problem.components))

    def add(i: int, nodes: Index, integral: Integral) -> None:
        for target, shares in ((load, integral.value), (doubt, integral.doubt)):
            np.add.at(target[:, i], nodes, shares)

    for law, elements in problem.regions:
        for i, coefficient in enumerate(law.load):
            if is_nonzero(coefficient) and elements.size:
                add(i, space.elements[:, elements], _body_load(body, space.order, coefficient, elements))
    for traction in problem.tractions:
        edges = body.edges(traction.boundary)
        for i, coefficient in enumerate(traction.value):
            if is_nonzero(coefficient):
                integral = shape_integrals(edges.at, edges.size, coefficient, space.order)
                add(i, space.nodes_of(edges.ends), integral)
    for point in problem.point_loads:
        load[space.number[point.node]] += point.force
    return load.ravel(), doubt.ravel()


def _body_load(body: Body, order: int, coefficient: Coefficient, elements: Index) -> Integral:
    degree = polynomial_degree(coefficient)
    straight = not np.any(body.is_curved[elements])
    points = None if degree is None or not straight else (degree + order + 3) // 2

    def integrand(_: Index, barycentric: Array, where: Array) -> Array:
        return functions(order, barycentric) * _values(coefficient, where)

    return over_triangles(body, elements, integrand, points, (coefficient,))


def shape_integrals(at: EdgePoints, size: int, coefficient: Coefficient, order: int = 1) -> Integral:
    """Integrals (nodes per edge, edges) of a coefficient times shape functions along edges."""

    def integrand(_: Index, s: Array, where: Array) -> Array:
        return functions(order, np.stack([1 - s, s])) * _values(coefficient, where)

    return over_edges(at, size, integrand, (coefficient,))


def _values(coefficient: Coefficient, where: Array) -> Array:
    """Values (m, k) at points (2, m, k)."""
    return on_points(coefficient, where.reshape(2, -1), "a load").reshape(where.shape[1:])


STEPS = 8
"""Steps to a point of an edge at which the slip changes sign; one is exact on a straight foundation. A disc
as large as an edge needs eight: rules do not see what is left behind the end of a part."""


def friction_energy(edges: Edges, obstacle: Obstacle, displacement: Array) -> tuple[Array, Array]:
    """(edges,) integrals of the friction bound times the size of the slip, and what they may be wrong by.

    The displacement has the coefficients (2, 2 or 3 nodes, edges). Edges are split where the slip changes
    sign, a parabola at its vertex first.
    """
    order = displacement.shape[1] - 1

    def slip(rows: Index, s: Array, where: Array) -> Array:
        normals = obstacle.normals(where.reshape(2, -1)).reshape(where.shape)
        shares = functions(order, np.stack([1 - s, s]))
        u = sum(displacement[:, i, rows, None] * share for i, share in enumerate(shares))
        return np.asarray(normals[1] * u[0] - normals[0] * u[1])

    def slip_at(s: Array) -> Array:
        rows = np.arange(s.size) % edges.size
        return slip(rows, s[:, None], edges.at(rows, s[:, None])[0])[:, 0]

    ends, bend = np.array([np.zeros(edges.size), np.ones(edges.size)]), np.zeros(edges.size)
    if order == 2:
        first, middle, last = (slip_at(np.full(edges.size, s)) for s in (0.0, 0.5, 1.0))
        bend = 4 * (first - 2 * middle + last)
        top = np.divide(first - last, bend, out=np.zeros(edges.size), where=bend != 0) + 0.5
        ends = np.insert(ends, 1, np.clip(top, 0.0, 1.0), axis=0)
    begin, end = ends[:-1].ravel(), ends[1:].ravel()
    split = _zeros(slip_at, begin, end, np.tile(bend, order))
    # each part twice: before and behind the point where the slip changes sign
    low = np.concatenate([begin, split])
    width = np.concatenate([split - begin, end - split])

    def at(part: Index, s: Array) -> tuple[Array, Array]:
        where, speed = edges.at(part % edges.size, low[part, None] + width[part, None] * s)
        return where, speed * width[part, None]

    def integrand(part: Index, s: Array, where: Array) -> Array:
        along = low[part, None] + width[part, None] * s
        bound = on_points(obstacle.friction, where.reshape(2, -1), "the friction bound")
        return (bound.reshape(s.shape) * np.abs(slip(part % edges.size, along, where)))[None]

    total, doubt, _ = over_edges(at, low.size, integrand, (obstacle.friction,))
    return total.reshape(2 * order, -1).sum(axis=0), doubt.reshape(2 * order, -1).sum(axis=0)


def _zeros(slip: Callable[[Array], Array], begin: Array, end: Array, bend: Array) -> Array:
    """(parts,) where the slip changes sign between ``begin`` and ``end``; the middle where it does not.

    In the regula falsi a parabola with the second derivative ``bend`` (parts,) takes the place of a line.
    """
    low, high = begin, end
    at_low, at_high = slip(low), slip(high)
    changes = at_low * at_high < 0
    middle = (low + high) / 2
    for _ in range(STEPS):
        rise, width = np.where(changes, at_high - at_low, 1.0), high - low
        curved = np.where(changes, bend * width**2 / 2, 0.0)
        slope = rise - curved  # at the lower end
        inner = np.copysign(np.sqrt(np.maximum(slope**2 - 4 * curved * at_low, 0.0)), rise)
        middle = np.where(changes, np.clip(low - 2 * at_low * width / (slope + inner), low, high), middle)
        at_middle = slip(middle)
        is_low = at_middle * at_low > 0
        low, at_low = np.where(is_low, middle, low), np.where(is_low, at_middle, at_low)
        high, at_high = np.where(is_low, high, middle), np.where(is_low, at_high, at_middle)
        changes = changes & (at_middle != 0)
    return middle
