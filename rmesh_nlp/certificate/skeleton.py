"""The edges of a triangulation, and which element lies on which side of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem import ContactProblem, Place

Index = NDArray[np.int64]

AFTER = np.array([[1, 2], [2, 0], [0, 1]])
"""Vertices of edge i of a triangle, the one opposite vertex i, counter-clockwise."""


@dataclass(frozen=True)
class Skeleton:
    """A mesh at given node positions, seen edge by edge.

    Edges have the numbers of the facets of the scikit-fem mesh. Edge i of an element lies
    opposite its vertex i and runs counter-clockwise from vertex i + 1 to vertex i + 2.

    Attributes
    ----------
    nodes : (2, nodes) array
    triangles : (3, elements) int array
        Counter-clockwise.
    ends : (2, edges) int array
    edges : (3, elements) int array
        The edges of each element.
    place : (3, 2, elements) int array
        Where the ends of an element's edge, counter-clockwise, stand in ``ends``: 0 or 1.
    """

    nodes: Array
    triangles: Index
    ends: Index
    edges: Index
    place: Index

    @cached_property
    def areas(self) -> Array:
        """(elements,) areas."""
        return np.asarray(signed_areas(self.nodes, self.triangles))

    @cached_property
    def lengths(self) -> Array:
        """(edges,) lengths."""
        a, b = self.nodes[:, self.ends[0]], self.nodes[:, self.ends[1]]
        return np.asarray(np.linalg.norm(b - a, axis=0))

    @cached_property
    def normals(self) -> Array:
        """(2, 3, elements) outward normals of the edges of each element, as long as the edges."""
        corners = self.nodes[:, self.triangles]
        along = corners[:, AFTER[:, 1]] - corners[:, AFTER[:, 0]]
        return np.stack([along[1], -along[0]])

    @cached_property
    def centres(self) -> Array:
        """(2, elements) barycentres."""
        return np.asarray(self.nodes[:, self.triangles].mean(axis=1))

    @cached_property
    def diameters(self) -> Array:
        """(elements,) longest edges."""
        return np.asarray(np.sqrt(np.max(np.sum(self.normals**2, axis=0), axis=0)))


def skeleton_of(problem: ContactProblem, nodes: Array) -> Skeleton:
    """The mesh of a problem with its nodes at ``nodes`` (2, nodes)."""
    triangles = problem.triangles
    ends = np.asarray(problem.mesh.facets, dtype=np.int64)
    count = nodes.shape[1]
    key = np.min(ends, axis=0) * count + np.max(ends, axis=0)
    order = np.argsort(key)
    tails, heads = triangles[AFTER[:, 0]], triangles[AFTER[:, 1]]
    wanted = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    edges = order[np.searchsorted(key, wanted, sorter=order)]
    tail_is_first = ends[0, edges] == tails
    place = np.stack([np.where(tail_is_first, 0, 1), np.where(tail_is_first, 1, 0)], axis=1)
    return Skeleton(np.asarray(nodes, dtype=float), triangles, ends, edges, place)


SAME = 1e-10
"""Relative difference of areas, lengths and first moments up to which they are the same."""


def same_domain(problem: ContactProblem, nodes: Array) -> bool:
    """Whether regions and named boundaries in use have the same measures and moments as on the given mesh.

    Nodes that slide along straight pieces, and interior nodes, change none of them. A node that
    moves off its piece, or the end of a part that slides, changes its length, its area or a moment.
    """
    given, moved = (_moments(problem, skeleton_of(problem, x)) for x in (problem.mesh.p, nodes))
    return all(
        np.max(np.abs(a - b)) <= SAME * max(float(np.max(np.abs(a))), 1e-300)
        for a, b in zip(given, moved, strict=True)
    )


def _moments(problem: ContactProblem, skeleton: Skeleton) -> list[Array]:
    corner = skeleton.nodes.min(axis=1, keepdims=True)
    areas, centres = skeleton.areas, skeleton.centres - corner
    result = [np.array([areas[part].sum(), *(centres[:, part] @ areas[part])]) for _, part in problem.regions]
    names = {load.boundary for load in problem.tractions} | {s.boundary for s in problem.supports}
    names |= {o.boundary for o in problem.obstacles if not isinstance(o.boundary, Place)}
    middle = skeleton.nodes[:, skeleton.ends].mean(axis=1) - corner
    lengths = skeleton.lengths
    for name in sorted(names):
        edges = np.unique(problem.mesh.boundaries[name])
        result.append(np.array([lengths[edges].sum(), *(middle[:, edges] @ lengths[edges])]))
    return result


def gradients(displacement: Array, skeleton: Skeleton) -> Array:
    """(components, 2, elements) gradients of a piecewise linear displacement."""
    local = displacement[:, skeleton.triangles]
    return np.asarray(-np.einsum("cie,die->cde", local, skeleton.normals) / (2 * skeleton.areas))


def end_values(nodal: Array, skeleton: Skeleton, edges: NDArray[np.int64]) -> Array:
    """(2, edges) values of a nodal field at the ends of some edges."""
    return np.asarray(nodal[skeleton.ends[:, edges]])
