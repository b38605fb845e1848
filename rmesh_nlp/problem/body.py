"""The body that a mesh stands for: triangles, those beside a curve blended to it, and its boundary edges.

Let ``X_i`` be the vertices of a triangle, ``lambda_i`` its barycentric coordinates and ``d(s)`` the vector
from the chord of an edge ab to its arc, ``s`` running from 0 at a to 1 at b. The blended triangle is the
image of

    x(lambda) = sum_i lambda_i X_i + (lambda_a + lambda_b)^k d(lambda_b / (lambda_a + lambda_b))

(W. J. Gordon, C. A. Hall, Transfinite element methods, Numer. Math. 21 (1973) 109-129, with k = 1). A
displacement that is a polynomial in ``lambda`` is then continuous, and a polynomial in ``s`` along the arc:
on the true domain it is as admissible as on the polygon. k is the order of the displacements. With k = 1 the
map has a kink in the apex, which costs quadratic displacements their rate; a parabola with k = 2 is the
usual isoparametric triangle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rmesh_nlp.evaluation import Array, Index, cross
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem.contact_problem import ContactProblem
from rmesh_nlp.problem.obstacle import Obstacle, Place


class BodySides(NamedTuple):
    """Sides of triangles on one curve: ``element`` (n,), ``ends`` (2, n) and ``facet`` (n,).

    The ends are local numbers, 0 to 2, in the order of ``mesh.facets``; facets are numbered on the curve.
    """

    element: Index
    ends: Index
    facet: Index


def sides_on(problem: ContactProblem, facets: Index) -> BodySides:
    """The sides of triangles that are these facets, on both sides of an interface."""
    beside = problem.mesh.f2t[:, facets]
    which, number = np.nonzero(beside >= 0)
    element = beside[which, number]
    nodes = problem.mesh.facets[:, facets[number]]
    ends = np.argmax(problem.triangles[:, None, element] == nodes, axis=0)
    return BodySides(element, ends, number)


@dataclass(frozen=True)
class Arcs:
    """Edges of a mesh that stand for arcs of one curve.

    ``t`` (2, n) are the parameters of the ends of each of the ``facets`` (n,), in the order of
    ``mesh.facets``, without a jump of a whole turn.
    """

    curve: Curve
    facets: Index
    t: Array
    sides: BodySides

    def at(self, rows: Index, s: Array) -> tuple[Array, Array]:
        """Points and derivatives by s, (2, m, k) each, of arcs ``rows`` (m,) at ``s`` (m, k)."""
        t0, t1 = self.t[:, rows, None]
        t = (t0 + s * (t1 - t0)).ravel()
        shape = (2, *s.shape)
        return self.curve.at(t).reshape(shape), self.curve.velocity(t).reshape(shape) * (t1 - t0)


class Body:
    """The domain of a problem by its mesh with nodes at given positions.

    Attributes
    ----------
    nodes : (2, nodes) array
    triangles : (3, elements) int array
    arcs : tuple of Arcs
        The edges on curves of the motion, a curve each.
    is_curved : (elements,) bool array
        Whether an edge of the triangle is an arc.
    apex : (elements,) int array
        The vertex opposite to the arc of a blended triangle; 0 elsewhere. Seen from there such a triangle is
        smooth: ``s`` is the angle, and the rest is linear.
    """

    def __init__(self, problem: ContactProblem, nodes: Array) -> None:
        self.problem, self.nodes = problem, nodes
        self.triangles = problem.triangles
        self.apex = np.zeros(self.triangles.shape[1], dtype=np.int64)
        self.is_curved = np.zeros(self.triangles.shape[1], dtype=bool)
        arcs = []
        for name, curve in problem.motion.curves.items():
            facets = self.edges(name).facets
            a, b = problem.mesh.facets[:, facets]
            start, sides = curve.nearest(self.nodes[:, a]), sides_on(problem, facets)
            arcs.append(Arcs(curve, facets, np.stack([start, curve.near(self.nodes[:, b], start)]), sides))
            self.is_curved[sides.element] = True
            self.apex[sides.element] = 3 - sides.ends.sum(axis=0)
        self.arcs = tuple(arcs)

    def at(self, elements: Index, barycentric: Array) -> tuple[Array, Array]:
        """Points (2, m, k) and the derivatives by barycentric coordinates (2, 3, m, k).

        Parameters
        ----------
        elements : (m,) int array
        barycentric : (3, m, k) array
        """
        corners = self.nodes[:, self.triangles[:, elements]]
        x = np.einsum("dvm,vmk->dmk", corners, barycentric)
        slopes = np.broadcast_to(corners[..., None], (*corners.shape, barycentric.shape[2])).copy()
        for arcs in self.arcs:
            of, side = _matches(arcs.sides.element, elements)
            a, b = arcs.sides.ends[:, side]
            bary_a, bary_b = barycentric[a, of], barycentric[b, of]
            total = bary_a + bary_b
            s = np.divide(bary_b, total, out=np.full_like(bary_b, 0.5), where=total > 0)
            arc, velocity = arcs.at(arcs.sides.facet[side], s)
            X_a, X_b = corners[:, a, of, None], corners[:, b, of, None]
            off = arc - (1 - s) * X_a - s * X_b
            turn, order = velocity - (X_b - X_a), self.problem.order
            lower = total ** (order - 1)
            for i in range(2):  # an element may have two sides on one curve
                np.add.at(x[i], of, (total**order * off)[i])
                np.add.at(slopes[i], (a, of), (lower * (order * off - s * turn))[i])
                np.add.at(slopes[i], (b, of), (lower * (order * off + (1 - s) * turn))[i])
        return x, slopes

    def points(self, elements: Index, barycentric: Array) -> tuple[Array, Array]:
        """Points (2, m, k) and the determinants of the map from the reference triangle, (m, k) or (m, 1)."""
        if np.any(self.is_curved[elements]):
            x, slopes = self.at(elements, barycentric)
            return x, determinants(slopes)
        a, b, c = self.nodes[:, self.triangles[:, elements]].transpose(1, 0, 2)[..., None]
        det = cross(b - a, c - a)
        return a * barycentric[0] + b * barycentric[1] + c * barycentric[2], det

    def is_upright(self) -> bool:
        """Whether no triangle is inverted or flat, and no arc cuts through its triangle."""
        if not np.all(signed_areas(self.nodes, self.triangles) > 0):
            return False
        elements = np.flatnonzero(self.is_curved)
        barycentric = np.empty((3, elements.size, _LOOK.shape[1]))
        for turn, part in enumerate(_LOOK):
            barycentric[(self.apex[elements] + turn) % 3, np.arange(elements.size)] = part
        return bool(np.all(determinants(self.at(elements, barycentric)[1]) > 0))

    def edges(self, name: str) -> Edges:
        """The edges of a named boundary."""
        return Edges(self, self.problem.mesh.boundaries[name])

    def edges_of(self, obstacle: Obstacle) -> Edges:
        """The edges of a contact boundary; all edges for an interior contact set."""
        if isinstance(obstacle.boundary, Place):
            return Edges(self, np.arange(self.problem.mesh.nfacets))
        return self.edges(obstacle.boundary)


_LOOK = np.array([(1 - r, r * (1 - s), r * s) for r in (0.5, 1.0) for s in np.linspace(0, 1, 9)]).T
"""Barycentric coordinates, that of the apex first, at which blended triangles are looked at."""


def determinants(slopes: Array) -> Array:
    """Twice the area per unit of the reference triangle (m, k), from the slopes of :meth:`Body.at`."""
    edges = slopes[:, 1:] - slopes[:, :1]
    return cross(edges[:, 0], edges[:, 1])


def edge_normals(corners: Array) -> Array:
    """(2, 3, ...) outward normals, as long as the edges, of triangles with ``corners`` (2, 3, ...).

    Edge i lies opposite corner i.
    """
    x, y = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    return np.stack([y, -x])


def gradients(slopes: Array) -> Array:
    """Gradients (2, 3, m, k) of the barycentric coordinates, from the slopes of :meth:`Body.at`."""
    return -edge_normals(slopes) / determinants(slopes)


class Edges:
    """Edges of a body, straight ones and arcs, each run through by ``s`` from 0 to 1; ``ends`` (2, n)."""

    def __init__(self, body: Body, facets: Index) -> None:
        self.body, self.facets = body, facets
        self.ends = body.problem.mesh.facets[:, facets]

    @property
    def size(self) -> int:
        """Number of edges."""
        return self.facets.size

    @property
    def are_straight(self) -> bool:
        """Whether none is an arc."""
        return bool(np.all(self.body.problem.curve_of_facet[self.facets] < 0))

    def at(self, rows: Index, s: Array) -> tuple[Array, Array]:
        """Points (2, m, k) and lengths per unit of s (m, k) of edges ``rows`` (m,) at ``s`` (m, k)."""
        a, b = self.body.nodes[:, self.ends[:, rows]].transpose(1, 0, 2)
        x = a[..., None] + s * (b - a)[..., None]
        speed = np.broadcast_to(np.linalg.norm(b - a, axis=0)[:, None], s.shape).copy()
        for arcs in self.body.arcs:
            of, row = _matches(arcs.facets, self.facets[rows])
            x[:, of], velocity = arcs.at(row, s[of])
            speed[of] = np.linalg.norm(velocity, axis=0)
        return x, speed


def _matches(sought: Index, among: Index) -> tuple[Index, Index]:
    """All pairs (i, j) with ``among[i] == sought[j]``."""
    order = np.argsort(sought, kind="stable")
    first, last = (np.searchsorted(sought[order], among, side=side) for side in ("left", "right"))
    before = np.cumsum(last - first) - (last - first)
    i = np.repeat(np.arange(among.size), last - first)
    return i, order[np.arange(i.size) + (first - before)[i]]
