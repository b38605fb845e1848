"""The edges of a triangulation, and which element lies on which side of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rmesh_nlp.certificate.polynomials import raised
from rmesh_nlp.evaluation import PROVED, Array, Index, magnitude
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import lengths, signed_areas
from rmesh_nlp.problem import ContactProblem, Motion, Place
from rmesh_nlp.problem.body import Body, edge_normals, gradients

AFTER = np.array([[1, 2], [2, 0], [0, 1]])
"""Vertices of edge i of a triangle, the one opposite vertex i, counter-clockwise."""

CORNERS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Vertices (2, 3) of the reference triangle."""


@dataclass(frozen=True)
class Skeleton:
    """A mesh at given node positions, seen edge by edge.

    Edges have the numbers of the facets of the scikit-fem mesh. Edge i of an element lies
    opposite its vertex i and runs counter-clockwise from vertex i + 1 to vertex i + 2.
    """

    body: Body  # without curves

    @property
    def nodes(self) -> Array:
        """(2, nodes) positions."""
        return self.body.nodes

    @property
    def triangles(self) -> Index:
        """(3, elements) vertices of each element, counter-clockwise."""
        return self.body.triangles

    @cached_property
    def space(self) -> DisplacementSpace:
        """Of the displacements on it."""
        return DisplacementSpace(self.body.problem)

    @cached_property
    def ends(self) -> Index:
        """(2, edges) ends of each edge."""
        return np.asarray(self.body.problem.mesh.facets, dtype=np.int64)

    @cached_property
    def edges(self) -> Index:
        """(3, elements) the edges of each element."""
        beside = self.body.problem.mesh.t2f
        has = np.any(self.ends[:, None, beside] == self.triangles[None, :, None], axis=0)
        return np.take_along_axis(beside, np.argmin(has, axis=1), axis=0)  # of has: (vertex, edge, element)

    @cached_property
    def place(self) -> Index:
        """(3, 2, elements) where the ends of an element's edge stand in ``ends``: 0 or 1."""
        tail_is_second = self.ends[0, self.edges] != self.triangles[AFTER[:, 0]]
        return np.stack([tail_is_second, ~tail_is_second], axis=1).astype(np.int64)

    @cached_property
    def areas(self) -> Array:
        """(elements,) areas."""
        return signed_areas(self.nodes, self.triangles)

    @cached_property
    def lengths(self) -> Array:
        """(edges,) lengths."""
        return lengths(self.nodes, self.ends)

    @cached_property
    def corners(self) -> Array:
        """(2, 3, elements) positions of the vertices."""
        return self.nodes[:, self.triangles]

    @cached_property
    def normals(self) -> Array:
        """(2, 3, elements) outward normals of the edges of each element, as long as the edges."""
        return edge_normals(self.corners)

    @cached_property
    def jacobian(self) -> Array:
        """(elements, 2, 2) Jacobians of the maps from the reference triangle."""
        return np.ascontiguousarray((self.corners[:, 1:] - self.corners[:, :1]).transpose(2, 0, 1))

    @cached_property
    def diameters(self) -> Array:
        """(elements,) longest edges."""
        return np.max(self.lengths[self.edges], axis=0)

    @property
    def owner(self) -> Index:
        """(edges,) one element of each edge, whichever comes last."""
        return np.max(self.body.problem.mesh.f2t, axis=0)

    @cached_property
    def along(self) -> Index:
        """(2 or 3, edges) nodes of the displacements along each edge."""
        return self.space.nodes_of(self.ends)

    def traces(self, components: int, k: int) -> Index:
        """(elements, 3 k components) numbers of the traces of each element.

        Edge by edge, all have k moments of each component, those of the ends first.
        """
        added = np.broadcast_to(np.arange(2, k)[:, None], (3, k - 2, self.areas.size))
        along = k * self.edges[:, None] + np.concatenate([self.place, added], axis=1)
        numbers = components * along[:, :, None] + np.arange(components)[:, None]
        return np.ascontiguousarray(numbers.reshape(3 * k * components, -1).T)

    def gradients(self, displacement: Array) -> Array:
        """(components, 2, 1 or 3, elements) gradients of a displacement, by coefficients (components, nodes).

        They are constant on an element, or linear with these values at its vertices.
        """
        order, nodes = self.space.order, self.space.elements
        derived = order * displacement[:, nodes[raised(order, 3)]]
        return np.einsum("cvie,die->cdve", derived, gradients(self.corners))


def skeleton_of(problem: ContactProblem, nodes: Array) -> Skeleton:
    """The mesh of a problem with its nodes at ``nodes`` (2, nodes), its edges straight."""
    straight = replace(problem, motion=Motion(None)) if problem.motion.curves else problem
    return Skeleton(Body(straight, nodes))


def same_domain(problem: ContactProblem, nodes: Array) -> bool:
    """Whether regions and named boundaries in use have the same measures and moments as on the given mesh.

    Nodes that slide along straight pieces, and interior nodes, change none of them. A node that
    moves off its piece, or the end of a part that slides, changes its length, its area or a moment.
    """
    given, moved = (_moments(problem, skeleton_of(problem, x)) for x in (problem.mesh.p, nodes))
    return all(
        magnitude(a - b) <= PROVED * max(magnitude(a), 1e-300) for a, b in zip(given, moved, strict=True)
    )


def _moments(problem: ContactProblem, skeleton: Skeleton) -> list[Array]:
    """Measure and first moments of each region and each named boundary in use."""
    corner = skeleton.nodes.min(axis=1, keepdims=True)
    centres, middles = (
        skeleton.nodes[:, cells].mean(axis=1) - corner for cells in (skeleton.triangles, skeleton.ends)
    )
    used = {
        *(obstacle.boundary for obstacle in problem.obstacles),
        *(load.boundary for load in problem.tractions),
        *(support.boundary for support in problem.supports),
    }
    parts = [(skeleton.areas, centres, elements) for _, elements in problem.regions]
    parts += [
        (skeleton.lengths, middles, np.unique(problem.mesh.boundaries[name]))
        for name in used
        if not isinstance(name, Place)
    ]
    return [np.array([size[some].sum(), *(centre[:, some] @ size[some])]) for size, centre, some in parts]
