"""The pressure on contact boundaries, recovered from the forces at their nodes.

A nodal force is the integral ``lambda_i = int p phi_i``. At order 2 the errors of forces at vertices and at
edges have opposite signs. Half the force of each edge added to each of its ends leaves ``int p l_v`` at the
vertices, with the barycentric coordinates l_v of order 1. Over their own integral omega_v they are means of
the pressure, at order 2 without these errors. The recovered pressure is linear on edges (triangles), and
exact if the pressure is linear along a boundary.

At a node whose gap is given and closed, contact and support share one reaction. The force of the contact is
there that of a pressure which continues from the nodes beside it.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, largest_side
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.problem.coefficients import Coefficient, at, once
from rmesh_nlp.problem.data import ContactSet

BEYOND = (0.0, 0.0736, 0.2735, 0.567, 0.8828, 1.2), (-1.0, -0.5, 0.0, 0.5, 1.0, 0.5)
"""How far contact reaches beyond its last vertex, in units of the edge before it, by the force of that vertex
over that of the mean pressure of the one before on this edge: of a pressure that falls like the root of the
distance to the end, all force beyond the last vertex in its own. Where it does not fall half an edge."""


class End(NamedTuple):
    """A vertex that contact shares with a support, and what follows it along the contact boundary.

    ``vertices`` are up to five, from the shared one on; ``nodes`` up to three contact nodes: vertices, of
    order 2 edges.
    """

    vertices: list[int]
    nodes: Index

    def force(self, space: DisplacementSpace) -> ca.Function:
        """See :func:`force_at_end`."""
        return force_at_end(space.order, len(self.vertices), self.nodes.size, space.problem.measure)


@lru_cache(maxsize=8)  # it does not depend on where the nodes are
def ends(space: DisplacementSpace, number: int) -> tuple[End, ...]:
    """The ends of a contact boundary, by its number, at which the gap is given and closed."""
    problem, part, found = space.problem, space.contact_sets[number], list[End]()
    vertices, gaps, _ = problem.given_gaps(problem.contact_sets[number])
    shared = vertices[np.abs(gaps) <= ROUNDING * largest_side(problem.mesh.p)].tolist()
    beside = defaultdict[int, list[int]](list)
    for a, b in contact_edges(problem, part.obstacle).T.tolist() if shared else ():
        beside[a].append(b)
        beside[b].append(a)
    for start in shared:
        for second in beside[start]:
            path = [start, second]
            while len(path) < 5 and len(beside[path[-1]]) == 2:
                path.append(sum(beside[path[-1]]) - path[-2])
            along = np.array(path)
            nodes = along[1:] if space.order == 1 else space.nodes_at(along[:-1], along[1:])
            if n_free := np.cumprod(np.isin(nodes[:3], part.nodes)).sum():
                found.append(End(path, nodes[:n_free]))
    return tuple(found)


@once
def force_at_end(order: int, vertices: int, nodes: int, measure: Coefficient) -> ca.Function:
    """``(X, forces) -> force`` of the contact at a shared vertex; a pressure is not to be negative.

    ``X`` (2, vertices) and ``forces`` (nodes,) are those of an :class:`End`. The slope of the stress
    continues linearly too, but between zero and that of the two nodes next to the vertex: a pressure that
    levels off does not overshoot.
    """
    X, forces, n = ca.SX.sym("X", 2, vertices), ca.SX.sym("forces", nodes), range(nodes)
    h = (*(ca.norm_2(X[:, k + 1] - X[:, k]) for k in range(vertices - 1)), 0, 0, 0, 0)
    places = ca.horzsplit(X[:, 1:] if order == 1 else (X[:, 1:] + X[:, :-1]) / 2)
    force = [forces[k] / at(measure, *ca.vertsplit(places[k])) for k in n]
    if order == 1:
        size, first = [(h[k] + h[k + 1]) / 2 for k in n], (h[0] + h[1]) / 3
        apart = [(h[k] + h[k + 1] + h[k + 2]) / 3 for k in n]
    else:
        size, first = [h[k] / 3 for k in n], h[0] / 4
        apart = [(h[k] + h[k + 1]) / 2 for k in n]
    stress = [force[k] / size[k] for k in n]
    slopes = [(stress[k] - stress[k + 1]) / apart[k] for k in n[:-1]] or [0.0]
    last = ca.fmin(2 * slopes[0] - slopes[-1], ca.fmax(slopes[0], 0))
    shared = h[0] / (1 + order) * (stress[0] + first * ca.fmax(last, ca.fmin(slopes[0], 0)))
    shared *= at(measure, *ca.vertsplit(X[:, 0] + (X[:, 1] - X[:, 0]) / (2 + order)))
    return ca.Function("force_at_end", [X, forces], [shared])


def nodal_forces(space: DisplacementSpace, X: Array, part: ContactSet, *of_gaps: Array) -> list[Array]:
    """(nodes,) forces of a contact set and at shared vertices, by the forces of all gaps (gaps,).

    The first are normal ones, others tangential; those that are empty are zero.
    """
    result = []
    for number, force in enumerate(of_gaps):
        forces = np.zeros(space.n_nodes)
        if force.size:
            forces[part.nodes] = force[part.rows]
            for end in ends(space, part.number):
                shared = float(end.force(space)(X[:, end.vertices], forces[end.nodes]))
                forces[end.vertices[0]] += shared if number else max(shared, 0.0)
        result.append(forces)
    return result


@dataclass(frozen=True, eq=False)
class ContactStress:
    """Forces at the nodes of a contact set, and the stress that is recovered from them.

    ``nodal`` (nodes,) has those at shared vertices. ``cells`` (corners, n) are the edges or triangles on
    which a node is free, of ``size`` (n,); ``shares`` (corners, n) are integrals of barycentric coordinates.
    """

    space: DisplacementSpace
    part: ContactSet
    nodal: Array
    cells: Index
    size: Array
    shares: Array

    @cached_property
    def weights(self) -> Array:
        """(vertices,) integrals of the barycentric coordinates."""
        return self._sums(self.shares)

    @cached_property
    def around(self) -> Array:
        """(vertices,) halves of the lengths of the edges beside each."""
        return self._sums(np.tile(self.size / len(self.cells), (len(self.cells), 1)))

    def _sums(self, shares: Array) -> Array:
        sums = np.bincount(self.cells.ravel(), shares.ravel(), self.space.n_vertices)
        return np.asarray(sums, dtype=float)

    @cached_property
    def forces(self) -> Array:
        """(vertices,) integrals of the stress times the barycentric coordinates."""
        at_vertices, at_edges = np.split(self.nodal, [self.space.n_vertices])
        for end in self.space.problem.mesh.facets if at_edges.size else ():
            at_vertices = at_vertices + np.bincount(end, at_edges / 2, at_vertices.size)
        return at_vertices

    @cached_property
    def means(self) -> Array:
        """(vertices,) forces over weights, zero off the contact set: means of the stress."""
        return np.divide(self.forces, self.weights, np.zeros_like(self.forces), where=self.weights > 0)

    @cached_property
    def ends(self) -> Mask:
        """(vertices,) where a contact boundary ends."""
        return np.asarray(np.bincount(self.cells.ravel(), minlength=self.weights.size) == 1)

    @cached_property
    def even_ends(self) -> Mask:
        """(vertices,) where it ends in a plane of symmetry."""
        fixed = self.part.nodes[~may_slip(self.space, self.part.number)]
        return self.ends & np.isin(np.arange(self.ends.size), fixed)

    @cached_property
    def values(self) -> Array:
        """(nodes,) the stress; zero off the contact set.

        Means are those at the centroids of the vertices' weights, from which the stress continues linearly,
        but no pressure below zero. In a plane of symmetry it is even; at order 1 the first two vertices are
        taken together there, since errors of their forces cancel: on a quarter of a ring, 6 edges long, a
        pressure of 5.2 had 6.4 and 5.1 at them.
        """
        means, weights, around, space = self.means, self.weights, self.around, self.space
        result = means.copy()
        if len(self.cells) == 2:
            own, other, size = self._both_ways
            slope = (means[other] - means[own]) / (2 * (around[own] + around[other]) - size)
            is_even = self.even_ends[own]
            step = np.where(is_even, 0.0, 2 / (2 - self.ends[own]) * (size - around[own]) * slope)
            result -= np.bincount(own, step, result.size)
            if space.order == 1:
                own, other = own[is_even], other[is_even]
                result[own] = (self.forces[own] + self.forces[other]) / (weights[own] + weights[other])
        result[np.sign(result) != np.sign(means)] = 0.0
        result = np.append(result, np.zeros(space.n_nodes - means.size))
        if space.order == 2:
            edges = np.unique(space.nodes_of(self.cells)[len(self.cells) :])
            result[edges] = np.mean(result[space.problem.mesh.facets[:, edges - means.size]], axis=0)
        return result

    def length(self, least: float) -> float:
        """Of the boundary where it presses; of an interior obstacle an area.

        Inside of a body the pressure jumps where contact ends: the force of a vertex there, over the largest
        mean beside it, is the area of contact around it. On a boundary contact ends within the edge beyond
        the last vertex with more force than ``least``, or at order 2 in the one before it, where the pressure
        falls to zero like the root of the distance.
        """
        pressing = self.forces > least
        if len(self.cells) == 3:
            most, full = np.zeros(pressing.size), self.weights.copy()
            for corner in self.cells:
                np.maximum.at(most, corner, np.max(self.means[self.cells], axis=0))
            last = np.unique(self.cells[:, ~np.all(pressing[self.cells], axis=0)])
            full[last] = self.forces[last] / np.maximum(most[last], 1e-300)
            return float(np.sum(full[pressing]))
        last, other, size = self._both_ways
        beside = np.bincount(last, self.means[other], pressing.size)  # beyond contact it is zero
        inside = np.sum(size[pressing[last] & pressing[other]]) / 2
        ends = pressing[last] & ~pressing[other]
        last, size = last[ends], size[ends]
        edge = 2 * self.around[last] - size
        reach = np.interp(
            self.means[last] * self.around[last] / np.maximum(edge * beside[last], 1e-300), *BEYOND
        )
        reach = np.maximum(reach, 1 - self.space.order) * np.where(edge > 0, edge, size)
        return float(inside + np.sum(np.minimum(reach, size)))

    @property
    def _both_ways(self) -> tuple[Index, Index, Array]:
        """Of edges, from either end: this vertex, the other one, and the length."""
        return self.cells.ravel(), self.cells[::-1].ravel(), np.tile(self.size, 2)


def recovered(space: DisplacementSpace, X: Array, part: ContactSet, *of_gaps: Array) -> list[ContactStress]:
    """The stresses of forces as of :func:`nodal_forces`, at vertex positions (2, vertices)."""
    cells, size = space.contact_cells(part.obstacle, X)
    is_open = np.any(np.isin(space.nodes_of(cells), part.nodes), axis=0)
    cells, size = cells[:, is_open], size[is_open]
    shares, forces = space.shares(cells, size, X, 1), nodal_forces(space, X, part, *of_gaps)
    return [ContactStress(space, part, each, cells, size, shares) for each in forces]


def contact_stresses(space: DisplacementSpace, X: Array, normal: Array, tangential: Array) -> Array:
    """(2, nodes) pressure and tangential stress of forces (gaps,), of all contact sets together."""
    total = np.zeros((2, space.n_nodes))
    for part in space.contact_sets:
        total += [each.values for each in recovered(space, X, part, normal, tangential)]
    return total


def vertex_pressures(space: DisplacementSpace, X: Array, part: ContactSet, force: Array) -> Array:
    """(vertices of the set,) means of the pressure at vertices without a given gap by forces (gaps,)."""
    means = recovered(space, X, part, force)[0].means
    return means[part.nodes[part.nodes < means.size]]


@lru_cache(maxsize=8)  # it does not depend on where the nodes are
def may_slip(space: DisplacementSpace, number: int) -> Mask:
    """(nodes of a contact set,) whether some displacement along the tangent is free."""
    (given, _), part = space.given(), space.contact_sets[number]
    obstacle = space.problem.first_obstacles[number]
    normals = obstacle.normals(space.points(space.problem.mesh.p)[:, part.nodes])
    return np.any(~given[:, part.nodes] & (np.abs(normals[::-1]) > ROUNDING), axis=0)
