"""The finite-element space of the displacement: which nodes carry unknowns, and where they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmesh_nlp.evaluation import Array, Index, Mask, numbers_of
from rmesh_nlp.fem.bernstein import SIDES, functions
from rmesh_nlp.fem.cells import measured_rule
from rmesh_nlp.meshes.geometry import edge_keys, edges_on, lengths, members_of
from rmesh_nlp.problem import ContactProblem, Obstacle, Place, signed_areas
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import Coefficient, on_points
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.rigid import rigid_motions


@dataclass(frozen=True, eq=False)
class DisplacementSpace:
    """Continuous displacements that are linear (P1) or quadratic (P2) on each triangle.

    A node of the space carries one unknown for each component that is not given: a coefficient of Bernstein's
    polynomials (:mod:`rmesh_nlp.fem.bernstein`). There is one node at each vertex and, of order 2, one at
    each edge; they are numbered as the vertices of the mesh are, then as its edges are.
    """

    problem: ContactProblem

    @property
    def order(self) -> int:
        """Degree of the displacements on a triangle."""
        return self.problem.order

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self.n_vertices + (self.problem.mesh.facets.shape[1] if self.order == 2 else 0)

    @property
    def n_displaced(self) -> int:
        """Number of nodes with a displacement: those of the body, then one for each tool."""
        return self.n_nodes + len(self.problem.tools)

    @property
    def forces(self) -> list[tuple[int, tuple[float, ...]]]:
        """Nodes at which a force acts, and the force: those of point loads, and tools."""
        tools = [self.problem.obstacles[number].force or () for number in self.problem.tools]
        return [
            *((load.node, load.force) for load in self.problem.point_loads),
            *enumerate(tools, self.n_nodes),
        ]

    @property
    def n_vertices(self) -> int:
        """Number of vertices of the mesh."""
        return self.problem.n_vertices

    @cached_property
    def elements(self) -> Index:
        """(3 or 6, elements) the nodes of each triangle, as the shape functions are numbered."""
        return self.nodes_of(self.problem.triangles)

    def nodes_of(self, cells: Index) -> Index:
        """(nodes per cell, cells) nodes of triangles, edges or points given by their vertices.

        Those at the vertices, and of order 2 those at the edges, in the order of ``bernstein.SIDES``.
        """
        sides = SIDES[len(cells)] if self.order == 2 else ()
        return np.vstack([cells, *(self.nodes_at(cells[a], cells[b])[None] for a, b in sides)])

    def nodes_at(self, first: Index, second: Index) -> Index:
        """Nodes (n,) at the edges between vertices (n,), of order 2."""
        names, order = self._edge_names
        place = np.searchsorted(names, edge_keys(np.stack([first, second]), self.n_vertices), sorter=order)
        return self.n_vertices + order[place]

    def kinds(self, nodes: Index) -> Iterator[tuple[Index, Index, Array]]:
        """Nodes by the vertices that carry them: ``(which, vertices, shares)`` for each kind of node.

        The nodes ``nodes[which]`` are at ``X[:, vertices] @ shares``, with ``vertices`` (per node, nodes).
        """
        at_vertex = nodes < self.n_vertices
        yield np.flatnonzero(at_vertex), nodes[at_vertex][None], np.ones(1)
        if not np.all(at_vertex):
            facets = self.problem.mesh.facets[:, nodes[~at_vertex] - self.n_vertices]
            yield np.flatnonzero(~at_vertex), facets, np.full(2, 0.5)

    def places(self, obstacle: Obstacle, nodes: Index, vertices: Index) -> Index:
        """(1 or 3, n) nodes on whose displacements the gaps at nodes (n,) of one of the :meth:`kinds` depend.

        The node itself, and where normals turn the ends of its edge.
        """
        return np.vstack([nodes, vertices]) if obstacle.level and len(vertices) == 2 else nodes[None]

    def normals(self, obstacle: Obstacle, X: Array, places: Index) -> Array:
        """(components, 1 or 3, n) what multiplies these: :func:`edge_gaps.directions` at vertices (2, n)."""
        vectors = obstacle.normals(self.points(X)[:, places])
        vectors[:, 1:] = (vectors[:, :1] - vectors[:, 1:]) / 2
        return vectors

    def carriers(self, part: ContactSet, which: Index, vertices: Index) -> Index:
        """(nodes, n) the :meth:`places` of the gaps ``which`` (n,), then what each meets, if that moves."""
        places = self.places(part.obstacle, part.nodes[which], vertices)
        return part.carriers(places).reshape(-1, which.size)

    def points(self, X: Array) -> Array:
        """(2, nodes) where the nodes are at vertex positions (2, vertices).

        Of any field that is linear on each triangle, by its values at vertices: values and coefficients.
        """
        if self.order == 1:
            return X
        a, b = self.problem.mesh.facets
        return np.hstack([X, (X[:, a] + X[:, b]) / 2])

    def points_on_body(self, X: Array) -> Array:
        """(2, nodes) where the nodes are on the body with its vertices at X (2, vertices).

        Middles of edges on curves are on the curve, unlike those of :meth:`points`.
        """
        points = np.array(self.points(X))
        for arcs in Body(self.problem, X).arcs if self.order == 2 else ():
            middle = np.full((arcs.facets.size, 1), 0.5)
            points[:, self.n_vertices + arcs.facets] = arcs.at(np.arange(middle.size), middle)[0][..., 0]
        return points

    def values(self, coefficients: Array) -> Array:
        """(components, nodes) values at the nodes' points of the field with coefficients at the nodes.

        Tools, whose displacements come last, are left out.
        """
        return self._with_edges(coefficients, 0.25, 0.5)

    def tools(self, coefficients: Array) -> dict[int, list[float]]:
        """How far tools have moved, by the number of their obstacle."""
        return dict(zip(self.problem.tools, coefficients[:, self.n_nodes :].T.tolist(), strict=True))

    def interpolant(self, coefficient: Coefficient, X: Array) -> Array:
        """(1, nodes) coefficients of a function of position, vertices at X (2, vertices)."""
        return self.coefficients(on_points(coefficient, self.points(X))[None])

    def coefficients(self, values: Array) -> Array:
        """(components, nodes) coefficients of the field with values at the nodes' points."""
        return self._with_edges(values, -0.5, 2.0)

    def _with_edges(self, given: Array, of_ends: float, of_own: float) -> Array:
        result = np.array(given[:, : self.n_nodes], dtype=float)
        if self.order == 2:
            a, b = self.problem.mesh.facets
            result[:, self.n_vertices :] *= of_own
            result[:, self.n_vertices :] += of_ends * (given[:, a] + given[:, b])
        return result

    def given(self) -> tuple[Mask, Array]:
        """Where displacement components have no unknown, and their coefficients.

        Both (components, nodes), tools after the nodes of the body.
        """
        held, value = self.problem.held
        held = held.copy()
        held[:, np.setdiff1d(np.arange(held.shape[1]), self.problem.mesh.t)] = True  # on no triangle
        if self.order == 2:
            of_edges = self._given_at_edges(value)
            held, value = map(np.hstack, zip((held, value), of_edges, strict=True))
        tools = self.problem.tools_held
        return np.hstack([held, tools]), np.hstack([value, np.zeros(tools.shape)])

    def _given_at_edges(self, at_vertices: Array) -> tuple[Mask, Array]:
        """The same at edges, by the values at vertices."""
        problem, shape = self.problem, (self.problem.components, self.problem.mesh.facets.shape[1])
        held, value = np.zeros(shape, dtype=bool), np.zeros(shape)
        if problem.components == 2:
            held[0] = np.all(problem.on_axis[problem.mesh.facets], axis=0)
        middles = self.points_on_body(problem.mesh.p)[:, self.n_vertices :]
        for support in problem.supports:
            facets = members_of("boundary", support.boundary, problem.mesh.boundaries)
            ends, middle = problem.mesh.facets[:, facets], middles[:, facets]
            for i, coefficient in enumerate(support.value):
                if coefficient is None:
                    continue
                given = on_points(coefficient, middle, f"the displacement given on {support.boundary!r}")
                held[i, facets] = True
                value[i, facets] = 2 * given - np.sum(at_vertices[i, ends], axis=0) / 2
        return held, value

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Per obstacle the nodes whose gap depends on an unknown, and the rows of their gaps among all."""
        problem, parts = self.problem, self.problem.contact_sets
        if self.order == 1:
            return parts
        nodes = [np.append(part.nodes, self._at_edges(part.obstacle)) for part in parts]
        partners = [self._with_edge_partners(part) for part in parts]
        return problem.sets_among(nodes, partners, self.points(problem.mesh.p), self.given()[0])

    def _at_edges(self, obstacle: Obstacle) -> Index:
        """Nodes at the edges of a contact set."""
        mesh = self.problem.mesh
        if isinstance(obstacle.boundary, Place):
            return self.n_vertices + np.arange(mesh.facets.shape[1])
        return self.n_vertices + np.unique(mesh.boundaries[obstacle.boundary])

    def _with_edge_partners(self, part: ContactSet) -> Index | None:
        """(nodes,) the partners of a contact set, those at edges included."""
        if part.partner is None:
            return None
        if not part.obstacle.other:  # a tool, which comes after the nodes
            return np.full(self.n_nodes, part.partner[0] + self.n_nodes - self.n_vertices)
        at_edges, result = self._at_edges(part.obstacle), np.full(self.n_nodes, -1)
        ends = self.problem.mesh.facets[:, at_edges - self.n_vertices]
        result[: self.n_vertices], result[at_edges] = part.partner, self.nodes_at(*part.partner[ends])
        return result

    @cached_property
    def contact_nodes(self) -> Index:
        """(gaps,) the node of every gap; a node of two obstacles is there twice."""
        return numbers_of(part.nodes for part in self.contact_sets)

    @cached_property
    def frictional(self) -> Mask:
        """(gaps,) whether friction may act."""
        each = (np.full(part.nodes.size, bool(part.obstacle.friction_law)) for part in self.contact_sets)
        return np.concatenate([np.zeros(0, dtype=bool), *each])

    def rigid_motions(self, X: Array) -> list[Array]:
        """Coefficients (components, nodes and tools) of each of the rigid motions at X (2, vertices)."""
        n = self.n_vertices
        return [
            np.hstack([self.points(motion[:, :n]), motion[:, n:]])
            for motion in rigid_motions(self.problem, X)
        ]

    def weights(self, X: Array) -> Array:
        """omega_i of (5.9) for every gap: the integral of its node's shape function over the boundary.

        Half the length of the contact edges at the node, of order 2 a third; for an obstacle in the interior
        a third of the area of the triangles there, of order 2 a sixth.
        """
        weights: list[Array] = [np.zeros(0)]
        for part in self.contact_sets:
            cells, size = self.contact_cells(part.obstacle, X)
            shares = self.shares(cells, size, X, self.order)
            whole = np.bincount(self.nodes_of(cells).ravel(), shares.ravel(), self.n_nodes)
            weights.append(np.asarray(whole[part.nodes], dtype=float))
        return np.concatenate(weights)

    def shares(self, cells: Index, size: Array, X: Array, order: int) -> Array:
        """(functions, n) integrals of the shape functions of an order over straight cells of a size (n,)."""
        points, weights = measured_rule(len(cells), order, self.problem.measure)
        at = self.problem.measured(np.einsum("xcn,cp->xpn", X[:, cells], points))
        return functions(order, points) * weights @ (at * size * np.ones((weights.size, 1)))

    def extent(self, edges: Index) -> float:
        """Of edges (2, n) of the mesh: their length, or that times the measure of the law."""
        X = self.problem.mesh.p
        return float(self.shares(edges, lengths(X, edges), X, 1).sum())

    def contact_cells(self, obstacle: Obstacle, X: Array) -> tuple[Index, Array]:
        """(2 or 3, n) vertices of contact edges, or of all triangles for an obstacle in the interior.

        And their lengths or areas (n,) at vertex positions (2, vertices).
        """
        if obstacle.boundary is Place.INTERIOR:
            return self.problem.triangles, signed_areas(X, self.problem.triangles)
        edges = contact_edges(self.problem, obstacle)
        return edges, lengths(X, edges)

    @cached_property
    def _edge_names(self) -> tuple[Index, Index]:
        facets = self.problem.mesh.facets
        names = edge_keys(facets, self.n_vertices)
        return names, np.argsort(names)


def contact_edges(problem: ContactProblem, obstacle: Obstacle) -> Index:
    """(2, edges) vertices of the edges of a contact boundary; none for an obstacle in the interior."""
    if isinstance(obstacle.boundary, Place):
        return np.zeros((2, 0), np.int64)
    return edges_on(problem.mesh, obstacle.boundary)


def outward_edges(problem: ContactProblem, boundary: str) -> Index:
    """(2, edges) vertices of the edges of a boundary, the body on their left."""
    facets = members_of("boundary", boundary, problem.mesh.boundaries)
    edges = problem.mesh.facets[:, facets]
    triangles = problem.triangles[:, problem.mesh.f2t[0, facets]]
    after = (np.argmax(triangles == edges[0], axis=0) + 1) % 3
    forward = triangles[after, np.arange(facets.size)] == edges[1]
    return np.where(forward, edges, edges[::-1])
