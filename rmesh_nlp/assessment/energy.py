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


def stiffness(body: Body, space: DisplacementSpace) -> tuple[sp.csc_array, sp.csc_array]:
    """The matrix K of ``1/2 u K u``, the strain energy, and its doubt."""
    problem = body.problem
    n = problem.components * space.n_displaced
    matrix, doubt = sp.csc_array((n, n)), sp.csc_array((n, n))
    held, given = space.given()
    counts = ~held | (given != 0)  # u_r / r has no finite energy for functions that do not vanish at r = 0
    for law, region in problem.regions:
        curved = body.is_curved[region]
        exact = None if law.varies else space.order
        for elements, points in ((region[~curved], exact), (region[curved], None)):

            def integrand(which: Index, barycentric: Array, where: Array, law: Law = law) -> Array:
                coordinates = gradients(body.at(which, barycentric)[1])
                gradient = np.einsum("avmk,vimk->aimk", slopes(space.order, barycentric), coordinates)
                if not law.varies:
                    return _density(law, gradient).reshape(-1, *gradient.shape[2:])
                unit = np.einsum("ci,iam->caim", np.eye(len(counts)), counts[:, space.elements[:, which]])
                slope = np.einsum("caim,akmp->ckaimp", unit, gradient)
                u = np.einsum("caim,amp->caimp", unit, functions(space.order, barycentric))
                fields = law.extended(slope, u, where)
                fields = fields.reshape(fields.shape[0] * fields.shape[1], -1, *gradient.shape[2:])
                moduli = law.moduli.reshape(len(fields), -1)
                stresses = np.einsum("kl,lamp->kamp", moduli, fields)
                products = np.einsum("kamp,kbmp->abmp", fields, stresses)
                return products.reshape(-1, *gradient.shape[2:])

            if elements.size:
                local = over_triangles(body, elements, integrand, points)
                nodes = problem.components * space.elements[:, None, elements]
                dofs = (nodes + np.arange(problem.components)[:, None]).reshape(-1, elements.size)
                place = np.repeat(dofs, len(dofs), axis=0).ravel(), np.tile(dofs, (len(dofs), 1)).ravel()
                matrix += sp.csc_array((local.value.ravel(), place), shape=(n, n))
                if points is None:
                    doubt += sp.csc_array((local.doubt.ravel(), place), shape=(n, n))
    return matrix, doubt


def _density(law: Law, gradient: Array) -> Array:
    """Integrand (n components, n components, m, k) of the stiffness for gradients (n, 2, m, k)."""
    each = np.einsum("akmp,ikjl->aijlmp", gradient, law.moduli, optimize=True)
    full = np.einsum("aijlmp,blmp->aibjmp", each, gradient, optimize=True)
    n = len(gradient) * law.components
    return full.reshape(n, n, *gradient.shape[2:])


def load_vector(body: Body, space: DisplacementSpace) -> tuple[Array, Array]:
    """F of the work ``F u`` of all loads: sources or body forces, tractions, point loads; and its doubt."""
    problem = body.problem
    load, doubt = np.zeros((2, space.n_displaced, problem.components))

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
    for node, force in space.forces:
        load[node] += force
    return load.ravel(), doubt.ravel()


def _body_load(body: Body, order: int, coefficient: Coefficient, elements: Index) -> Integral:
    degree = polynomial_degree(coefficient)
    straight = not np.any(body.is_curved[elements])
    more = polynomial_degree(body.problem.measure)
    points = None if degree is None or more is None or not straight else (degree + more + order + 3) // 2

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
        bound = on_points(obstacle.friction_law.given, where, "the friction bound")
        return (bound * np.abs(slip(rows, s, where)))[None]

    along = (lambda rows, s: slip(rows, s, edges.at(rows, s)[0])), order if obstacle.level is None else None
    total = over_edges(edges, integrand, (obstacle.friction_law.given,), [along])
    return total.value[0], total.doubt[0]
