"""The finite-element space of the displacement: which nodes carry unknowns, and where they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Obstacle, Place, signed_areas
from rmesh_nlp.problem.data import ContactSet

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DisplacementSpace:
    """Continuous displacements that are linear on each triangle (P1).

    A node of the space carries one unknown for each component that is not given. Gaps, weights, fields and
    output ask the space for nodes and never take vertices of the mesh for them. ``number`` (vertices,) is the
    node at each vertex.
    """

    problem: ContactProblem
    number: Index

    @staticmethod
    def of(problem: ContactProblem) -> DisplacementSpace:
        """The space of a problem, its nodes numbered as the vertices are."""
        return DisplacementSpace(problem, np.arange(problem.mesh.p.shape[1]))

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return int(self.number.size)

    @cached_property
    def elements(self) -> Index:
        """(3, elements) the nodes of each triangle."""
        return self.nodes_of(self.problem.triangles)

    def nodes_of(self, cells: Index) -> Index:
        """(nodes per cell, cells) nodes of triangles, edges or points given by their vertices."""
        return np.asarray(self.number[cells])

    def kinds(self, nodes: Index) -> Iterator[tuple[Index, Index, Array]]:
        """Nodes by the vertices that carry them: ``(which, vertices, shares)`` for each kind of node.

        The nodes ``nodes[which]`` are at ``X[:, vertices] @ shares``, with ``vertices`` (per node, nodes).
        """
        yield np.arange(nodes.size), self._vertex[nodes][None], np.ones(1)

    def points(self, X: Array) -> Array:
        """(2, nodes) where the nodes are at vertex positions (2, vertices)."""
        return self.of_linear(X)

    def of_linear(self, values: Array) -> Array:
        """(components, nodes) values of a field that is linear on each triangle, by those at vertices."""
        return np.asarray(values[:, self._vertex])

    def given(self) -> tuple[NDArray[np.bool_], Array]:
        """Where displacement components have no unknown, and their values: (components, nodes) arrays."""
        held, value = self.problem.held()
        held = held.copy()
        held[:, np.setdiff1d(np.arange(held.shape[1]), self.problem.mesh.t)] = True  # on no triangle
        return held[:, self._vertex], self.of_linear(value)

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Those of the problem, their nodes as the space numbers them: one gap for each node and obstacle."""
        return tuple(replace(part, nodes=self.nodes_of(part.nodes)) for part in self.problem.contact_sets)

    @cached_property
    def contact_nodes(self) -> Index:
        """(gaps,) the node of every gap; a node of two obstacles is there twice."""
        return self.nodes_of(self.problem.contact_nodes)

    def weights(self, X: Array) -> Array:
        """omega_i of (5.9) for every gap: the integral of its node's shape function over the boundary.

        Half the length of the contact edges at the node; for an obstacle in the interior a third of the area
        of the triangles there.
        """
        weights: list[Array] = [np.zeros(0)]
        for part in self.contact_sets:
            if part.obstacle.boundary is Place.INTERIOR:
                cells, size = self.problem.triangles, signed_areas(X, self.problem.triangles)
            else:
                cells = contact_edges(self.problem, part.obstacle)
                size = np.linalg.norm(X[:, cells[1]] - X[:, cells[0]], axis=0)
            share = np.tile(size / len(cells), len(cells))
            whole = np.bincount(self.nodes_of(cells).ravel(), share, self.n_nodes)
            weights.append(np.asarray(whole[part.nodes], dtype=float))
        return np.concatenate(weights)

    @cached_property
    def _vertex(self) -> Index:
        """(nodes,) the vertex of each node."""
        return np.argsort(self.number)


def contact_edges(problem: ContactProblem, obstacle: Obstacle) -> Index:
    """(2, edges) vertices of the edges of a contact boundary; none for an obstacle in the interior."""
    if isinstance(obstacle.boundary, Place):
        return np.zeros((2, 0), np.int64)
    facets = np.asarray(problem.mesh.boundaries[obstacle.boundary])
    return np.asarray(problem.mesh.facets[:, facets], dtype=np.int64)


def outward_edges(problem: ContactProblem, boundary: str) -> Index:
    """(2, edges) vertices of the edges of a boundary, the body on their left."""
    facets = np.asarray(problem.mesh.boundaries[boundary])
    edges = np.asarray(problem.mesh.facets[:, facets], dtype=np.int64)
    triangles = problem.triangles[:, problem.mesh.f2t[0, facets]]
    after = (np.argmax(triangles == edges[0], axis=0) + 1) % 3
    forward = triangles[after, np.arange(facets.size)] == edges[1]
    return np.where(forward, edges, edges[::-1])
