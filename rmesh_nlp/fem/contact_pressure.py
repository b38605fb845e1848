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
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Expression, Index, Mask, largest_side
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.meshes.geometry import lengths, signed_areas
from rmesh_nlp.problem import Place
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


def ends(space: DisplacementSpace, part: ContactSet) -> Iterator[End]:
    """The ends of a contact boundary at which the gap is given and closed."""
    problem, beside = space.problem, defaultdict[int, list[int]](list)
    vertices, gaps, _ = problem.given_gaps(problem.contact_sets[part.number])
    shared = vertices[np.abs(gaps) <= ROUNDING * largest_side(problem.mesh.p)].tolist()
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
            n_free = np.cumprod(np.isin(nodes[:3], part.nodes)).sum()
            if n_free:
                yield End(path, nodes[:n_free])


def force_at_end(order: int, length: Sequence[Expression], force: Sequence[Expression]) -> Expression:
    """The contact force at a shared vertex; a pressure is not to be negative.

    The slope of the stress continues linearly too, but between zero and that of the two nodes next to the
    vertex: a pressure that levels off does not overshoot.

    Parameters
    ----------
    order : int
    length : sequence
        Of up to four edges from there on.
    force : sequence
        Of up to three contact nodes beside it, as in :class:`End`.
    """
    h, n = (*length, 0, 0, 0, 0), range(len(force))
    if order == 1:
        size, first = [(h[k] + h[k + 1]) / 2 for k in n], (h[0] + h[1]) / 3
        apart = [(h[k] + h[k + 1] + h[k + 2]) / 3 for k in n]
    else:
        size, first = [h[k] / 3 for k in n], h[0] / 4
        apart = [(h[k] + h[k + 1]) / 2 for k in n]
    stress = [force[k] / size[k] for k in n]
    slopes = [(stress[k] - stress[k + 1]) / apart[k] for k in n[:-1]] or [0.0]
    last = ca.fmin(2 * slopes[0] - slopes[-1], ca.fmax(slopes[0], 0))
    return h[0] / (1 + order) * (stress[0] + first * ca.fmax(last, ca.fmin(slopes[0], 0)))


def nodal_forces(space: DisplacementSpace, X: Array, part: ContactSet, *of_gaps: Array) -> list[Array]:
    """(nodes,) forces of a contact set and at shared vertices, by the forces of all gaps (gaps,).

    The first are normal ones, others tangential; those that are empty are zero.
    """
    result = []
    for number, force in enumerate(of_gaps):
        forces = np.zeros(space.n_nodes)
        if force.size:
            forces[part.nodes] = force[part.rows]
            for end in ends(space, part):
                along = lengths(X, np.stack([end.vertices[:-1], end.vertices[1:]])).tolist()
                shared = force_at_end(space.order, along, forces[end.nodes].tolist())
                forces[end.vertices[0]] += float(shared) if number else max(float(shared), 0.0)
        result.append(forces)
    return result


class OnVertices(NamedTuple):
    """The cells of a contact set on which a node is free, and the forces of its nodes on their vertices.

    ``cells`` (corners, n) are edges or triangles of ``size`` (n,); ``weights`` (vertices,) are the integrals
    of the barycentric coordinates, ``forces`` (vertices,) those of the pressure times these.
    """

    cells: Index
    size: Array
    weights: Array
    forces: Array

    @property
    def means(self) -> Array:
        """(vertices,) forces over weights, zero off the contact set: means of the pressure."""
        return np.divide(self.forces, self.weights, np.zeros_like(self.forces), where=self.weights > 0)

    @property
    def ends(self) -> Mask:
        """(vertices,) where a contact boundary ends."""
        return np.bincount(self.cells.ravel(), minlength=self.weights.size) == 1

    def length(self, order: int, least: float) -> float:
        """Of the boundary where it presses; of an interior obstacle an area.

        Contact ends within the edge beyond the last vertex with more force than ``least``, or at order 2 in
        the one before it, where the pressure falls to zero like the root of the distance.
        """
        pressing = self.forces > least
        if len(self.cells) == 3:
            return float(np.sum(self.weights[pressing]))
        both, before = np.all(pressing[self.cells], axis=0), np.zeros((2, pressing.size))
        total, means = float(np.sum(self.size[both])), self.means
        for last, other in (self.cells, self.cells[::-1]):
            np.add.at(before[0], last[both], self.size[both])
            np.add.at(before[1], last[both], (self.size * means[other])[both])
        for last, other in (self.cells, self.cells[::-1]):
            at = pressing[last] & ~pressing[other]
            edge, force = before[:, last[at]]
            reach = np.interp(self.forces[last[at]] / np.maximum(force, 1e-300), *BEYOND)
            edge = np.where(edge > 0, edge, self.size[at])
            total += float(np.sum(np.minimum(np.maximum(reach, 1 - order) * edge, self.size[at])))
        return total


def on_vertices(space: DisplacementSpace, X: Array, part: ContactSet, force: Array) -> OnVertices:
    """Forces at nodes (nodes,) on the vertices of a contact set, at vertex positions (2, vertices)."""
    n, problem = space.n_vertices, space.problem
    if part.obstacle.boundary is Place.INTERIOR:
        cells, size = problem.triangles, signed_areas(X, problem.triangles)
    else:
        cells = contact_edges(problem, part.obstacle)
        size = lengths(X, cells)
    is_open = np.any(np.isin(space.nodes_of(cells), part.nodes), axis=0)
    cells, size = cells[:, is_open], size[is_open]
    weights, forces = np.zeros(n), force[:n].copy()
    for corner in cells:
        np.add.at(weights, corner, size / len(cells))
    for end in problem.mesh.facets if space.order == 2 else ():
        np.add.at(forces, end, force[n:] / 2)
    return OnVertices(cells, size, weights, forces)


def recovered(space: DisplacementSpace, part: ContactSet, on: OnVertices) -> Array:
    """(nodes,) the stress that is recovered from forces on vertices; zero off the contact set.

    Means are those at the centroids of the vertices' weights, from which the stress continues linearly, but
    no pressure below zero. In a plane of symmetry it is even; at order 1 the first two vertices are taken
    together there, since errors of their forces cancel: on a quarter of a ring, 6 edges long, a pressure of
    5.2 had 6.4 and 5.1 at them.
    """
    means, weights = on.means, on.weights
    result = np.append(means, np.zeros(space.n_nodes - means.size))
    if len(on.cells) == 2:
        even, is_end = is_even(space, part), on.ends
        for own, other in (on.cells, on.cells[::-1]):
            apart = 2 * (weights[own] + weights[other]) - on.size
            step = 2 / (2 - is_end[own]) * (on.size - weights[own]) * (means[other] - means[own]) / apart
            pair = even[own] & is_end[own]
            np.subtract.at(result, own, np.where(pair, 0.0, step))
            if space.order == 1:
                own, other = own[pair], other[pair]
                result[own] = (on.forces[own] + on.forces[other]) / (weights[own] + weights[other])
        result[: means.size][np.sign(result[: means.size]) != np.sign(means)] = 0.0
    if space.order == 2:
        edges = np.unique(space.nodes_of(on.cells)[len(on.cells) :])
        result[edges] = np.mean(result[space.problem.mesh.facets[:, edges - means.size]], axis=0)
    return result


def contact_stresses(
    space: DisplacementSpace, X: Array, normal: Array, tangential: Array
) -> tuple[Array, Array]:
    """(nodes,) pressure and tangential stress of forces (gaps,), of all contact sets together."""
    pressure, along = np.zeros((2, space.n_nodes))
    for part in space.contact_sets:
        for stress, force in zip(
            (pressure, along), nodal_forces(space, X, part, normal, tangential), strict=True
        ):
            stress += recovered(space, part, on_vertices(space, X, part, force))
    return pressure, along


def vertex_pressures(space: DisplacementSpace, X: Array, part: ContactSet, force: Array) -> Array:
    """(vertices of the set,) means of the pressure at vertices without a given gap by forces (gaps,)."""
    means = on_vertices(space, X, part, *nodal_forces(space, X, part, force)).means
    return means[part.nodes[part.nodes < means.size]]


def is_even(space: DisplacementSpace, part: ContactSet) -> Mask:
    """(nodes,) whether a contact boundary that ends here ends in a plane of symmetry."""
    even = np.zeros(space.n_nodes, dtype=bool)
    even[part.nodes] = ~may_slip(space, part)
    return even


def may_slip(space: DisplacementSpace, part: ContactSet) -> Mask:
    """(nodes of the set,) whether some displacement along the tangent is free."""
    given, _ = space.given()
    obstacle = space.problem.first_obstacles[part.number]
    normals = obstacle.normals(space.points(space.problem.mesh.p)[:, part.nodes])
    return np.any(~given[:, part.nodes] & (np.abs(normals[::-1]) > ROUNDING), axis=0)
