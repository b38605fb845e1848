"""Strain energy, work and friction energy of a displacement on the triangles, straight or blended, of a body.

Numbering: component i of node k is entry ``components * k + i`` of a nodal vector.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.integrals import RINGS, Integral, Integrand, over_edges, over_triangles
from rmesh_nlp.evaluation import Array, Index, cross
from rmesh_nlp.fem.bernstein import functions, slopes
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body, Edges, gradients
from rmesh_nlp.problem.coefficients import Coefficient, is_nonzero, on_points, product
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
        exact = RINGS if law.varies else (space.order,)
        for elements, points in ((region[~curved], exact), (region[curved], ())):

            def sums(which: Index, barycentric: Array, where: Array, weights: Array, law: Law = law) -> Array:
                coordinates = gradients(body.at(which, barycentric)[1])
                gradient = np.einsum("avmk,ivmk->aimk", slopes(space.order, barycentric), coordinates)
                unit = (counts | (not law.varies))[:, space.elements[:, which]]
                unit = np.einsum("ci,iam->caim", np.eye(len(counts)), unit)
                slope = np.einsum("caim,akmp->ckaimp", unit, gradient)
                u = np.einsum("caim,amp->caimp", unit, functions(space.order, barycentric))
                fields = law.extended(slope, u, where)
                fields = fields.reshape(-1, len(gradient) * len(counts), *weights.shape)
                moduli = law.moduli.reshape(len(fields), -1)
                stresses = np.tensordot(moduli, fields * weights, 1)
                left, right = (
                    each.transpose(2, 1, 0, 3).reshape(*fields.shape[2:0:-1], -1)
                    for each in (fields, stresses)
                )
                return (left @ right.transpose(0, 2, 1)).reshape(len(which), -1).T

            if elements.size:
                local = over_triangles(body, elements, sums, points)
                nodes = problem.components * space.elements[:, None, elements]
                dofs = (nodes + np.arange(problem.components)[:, None]).reshape(-1, elements.size)
                place = np.repeat(dofs, len(dofs), axis=0).ravel(), np.tile(dofs, (len(dofs), 1)).ravel()
                matrix += sp.csc_array((local.value.ravel(), place), shape=(n, n))
                if len(points) != 1:
                    doubt += sp.csc_array((local.doubt.ravel(), place), shape=(n, n))
    return matrix, doubt


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
                degree = polynomial_degree(product(problem.measure, coefficient))
                is_curved = np.any(body.is_curved[elements])
                points = () if degree is None or is_curved else ((degree + space.order + 3) // 2,)
                tested = _tested(space.order, coefficient)
                integral = over_triangles(body, elements, tested, points, (coefficient,))
                add(i, space.elements[:, elements], integral)
    for traction in problem.tractions:
        edges = body.edges(traction.boundary)
        for i, coefficient in enumerate(traction.value):
            if is_nonzero(coefficient):
                integral = shape_integrals(edges, coefficient, space.order)
                add(i, space.nodes_of(edges.ends), integral)
    for node, force in space.forces:
        load[node] += force
    return load.ravel(), doubt.ravel()


def shape_integrals(edges: Edges, coefficient: Coefficient, order: int = 1) -> Integral:
    """Integrals (nodes per edge, edges) of a coefficient times shape functions along edges."""
    return over_edges(edges, _tested(order, coefficient), (coefficient,))


def _tested(order: int, coefficient: Coefficient) -> Integrand:
    def sums(_: Index, shares: Array, where: Array, weights: Array) -> Array:
        values = on_points(coefficient, where, "a load") * weights
        return np.sum(functions(order, shares) * values, axis=2)

    return sums


def friction_energy(edges: Edges, obstacle: Obstacle, displacement: Array) -> tuple[Array, Array]:
    """(edges,) integrals of the friction bound times the size of the slip, and what they may be wrong by.

    The displacement has the coefficients (2, 2 or 3 nodes, edges). Edges are split where the slip changes
    sign.
    """
    order = displacement.shape[1] - 1

    def slip(rows: Index, shares: Array, where: Array) -> Array:
        u = np.einsum("cvm,vmk->cmk", displacement[:, :, rows], functions(order, shares))
        return cross(u, obstacle.normals(where))

    def sums(rows: Index, shares: Array, where: Array, weights: Array) -> Array:
        bound = on_points(obstacle.friction_law.given, where, "the friction bound")
        return np.sum(bound * np.abs(slip(rows, shares, where)) * weights, axis=1)[None]

    def along(rows: Index, s: Array) -> Array:
        return slip(rows, np.stack([1 - s, s]), edges.at(rows, s)[0])

    others = [(along, order if obstacle.level is None else None)]
    total = over_edges(edges, sums, (obstacle.friction_law.given,), others)
    return total.value[0], total.doubt[0]
