"""Strain energy, work and friction energy of a displacement on the triangles, straight or blended, of a body.

Numbering: component i of node k is entry ``components * k + i`` of a nodal vector.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.integrals import Integral, over_edges, over_triangles
from rmesh_nlp.evaluation import Array, Index, cross
from rmesh_nlp.fem.bernstein import functions, slopes
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body, Edges, gradients
from rmesh_nlp.problem.coefficients import Coefficient, is_nonzero, on_points
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.obstacle import Obstacle
from rmesh_nlp.problem.switches import polynomial_degree


def stiffness(body: Body, space: DisplacementSpace) -> sp.csc_array:
    """The matrix K of ``1/2 u K u``, the strain energy."""
    problem = body.problem
    n = problem.components * space.n_nodes
    matrix = sp.csc_array((n, n))
    for law, region in problem.regions:
        curved = body.is_curved[region]
        for elements, points in ((region[~curved], space.order), (region[curved], None)):

            def integrand(which: Index, barycentric: Array, _: Array, law: Law = law) -> Array:
                coordinates = gradients(body.at(which, barycentric)[1])[0]
                gradient = np.einsum("avmk,vimk->aimk", slopes(space.order, barycentric), coordinates)
                return _density(law, gradient).reshape(-1, *gradient.shape[2:])

            if elements.size:
                local = over_triangles(body, elements, integrand, points).value
                nodes = problem.components * space.elements[:, None, elements]
                dofs = (nodes + np.arange(problem.components)[:, None]).reshape(-1, elements.size)
                place = np.repeat(dofs, len(dofs), axis=0).ravel(), np.tile(dofs, (len(dofs), 1)).ravel()
                matrix += sp.csc_array((local.ravel(), place), shape=(n, n))
    return matrix


def _density(law: Law, gradient: Array) -> Array:
    """Integrand (n components, n components, m, k) of the stiffness for gradients (n, 2, m, k)."""
    each = np.einsum("akmp,ikjl->aijlmp", gradient, law.moduli, optimize=True)
    full = np.einsum("aijlmp,blmp->aibjmp", each, gradient, optimize=True)
    n = len(gradient) * law.components
    return full.reshape(n, n, *gradient.shape[2:])


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
                integral = shape_integrals(edges, coefficient, space.order)
                add(i, space.nodes_of(edges.ends), integral)
    for point in problem.point_loads:
        load[point.node] += point.force
    return load.ravel(), doubt.ravel()


def _body_load(body: Body, order: int, coefficient: Coefficient, elements: Index) -> Integral:
    degree = polynomial_degree(coefficient)
    straight = not np.any(body.is_curved[elements])
    points = None if degree is None or not straight else (degree + order + 3) // 2

    def integrand(_: Index, barycentric: Array, where: Array) -> Array:
        return functions(order, barycentric) * on_points(coefficient, where, "a load")

    return over_triangles(body, elements, integrand, points, (coefficient,))


def shape_integrals(edges: Edges, coefficient: Coefficient, order: int = 1) -> Integral:
    """Integrals (nodes per edge, edges) of a coefficient times shape functions along edges."""

    def integrand(_: Index, s: Array, where: Array) -> Array:
        return functions(order, np.stack([1 - s, s])) * on_points(coefficient, where, "a load")

    return over_edges(edges, integrand, (coefficient,))


def friction_energy(edges: Edges, obstacle: Obstacle, displacement: Array) -> tuple[Array, Array]:
    """(edges,) integrals of the friction bound times the size of the slip, and what they may be wrong by.

    The displacement has the coefficients (2, 2 or 3 nodes, edges). Edges are split where the slip changes
    sign.
    """
    order = displacement.shape[1] - 1

    def slip(rows: Index, s: Array, where: Array) -> Array:
        normals = obstacle.normals(where)
        shares = functions(order, np.stack([1 - s, s]))
        u = sum(displacement[:, i, rows, None] * share for i, share in enumerate(shares))
        return cross(u, normals)

    def integrand(rows: Index, s: Array, where: Array) -> Array:
        bound = on_points(obstacle.friction, where, "the friction bound")
        return (bound * np.abs(slip(rows, s, where)))[None]

    along = (lambda rows, s: slip(rows, s, edges.at(rows, s)[0])), order if obstacle.level is None else None
    total = over_edges(edges, integrand, (obstacle.friction,), [along])
    return total.value[0], total.doubt[0]
