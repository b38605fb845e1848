"""Energies of continuous, piecewise linear or quadratic displacements on the domain of the true curves.

An element beside a curve is its triangle with the segment between edge and curve added, or taken away where
the curve bends into it; the displacement there is the polynomial of the triangle. Segments of neighbours
meet at vertices only, so that the displacement is continuous, and admissible for the continuous problem;
affine displacements are exact, and areas are known in closed form. Unknowns are values at nodes: the vertices
and, of order 2, the middles of edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, hstack
from skfem import DiscreteField, ElementTriP1, ElementTriP2, MeshTri
from skfem.quadrature import get_quadrature_line

from truth.data import Data, values

SIDES = ((0, 1), (1, 2), (0, 2))
"""Local vertices of a triangle's edges, as scikit-fem numbers them."""


def composite(parts: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's rule on each of equal parts of [0, 1]: points and weights."""
    s, w = (part.ravel() for part in get_quadrature_line(2 * points - 1))
    return ((np.arange(parts)[:, None] + s) / parts).ravel(), np.tile(w, parts) / parts


class Body:
    """A problem on a mesh. Unknowns are numbered ``components * node + component``."""

    def __init__(self, data: Data, mesh: MeshTri) -> None:
        self.data, self.mesh, self.c = data, mesh, data.components
        self.p, self.t, self.ends = np.asarray(mesh.p), np.asarray(mesh.t), mesh.p[:, mesh.facets]
        quadratic = data.order == 2
        self.nodes = np.vstack([self.t, self.p.shape[1] + mesh.t2f]) if quadratic else self.t
        self.places = np.hstack([self.p, self.ends.mean(axis=1)]) if quadratic else self.p
        self.mapping, self.element = mesh.mapping(), ElementTriP2() if quadratic else ElementTriP1()
        self.polygon = np.abs(self.mapping.detA) / 2
        self.area = self.polygon.copy()
        for name, (_, _, radius) in data.circles.items():
            ends = self.ends[..., self.facets(name)]
            half = np.arcsin(np.minimum(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0) / (2 * radius), 1))
            segment = radius**2 * (half - np.sin(half) * np.cos(half))
            np.add.at(self.area, mesh.f2t[0, self.facets(name)], self.outward(name) * segment)
        self.material = np.zeros(self.t.shape[1], dtype=int)
        for number, material in enumerate(data.materials):
            self.material[material.triangles(mesh)] = number
        self.tensor = np.stack([material.tensor for material in data.materials])

    def facets(self, name: str) -> np.ndarray:
        """Edges (n,) of a named boundary."""
        return np.asarray(self.mesh.boundaries[name])

    def outward(self, name: str) -> np.ndarray:
        """1 for edges (n,) whose arc is beyond their triangle, -1 where it bends into it."""
        (x, y, _), facets = self.data.circles[name], self.facets(name)
        middle = self.ends[..., facets].mean(axis=1)
        away = middle - self.p[:, self.t[:, self.mesh.f2t[0, facets]]].mean(axis=1)
        return np.sign(np.sum((middle - [[x], [y]]) * away, axis=0))

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.places.shape[1]

    @property
    def cells(self) -> int:
        """Number of contact edges, or of triangles over an interior obstacle."""
        foundation = self.data.foundation
        return self.t.shape[1] if foundation.kind == "interior" else self.facets(foundation.boundary).size

    @cached_property
    def stiffness(self) -> csr_matrix:
        """K (unknowns, unknowns)."""
        c, total = self.c, csr_matrix((self.c * self.size,) * 2)
        for elements, points, weights in self.pieces():
            G, C = self.slopes(elements, points), self.tensor[self.material[elements]]
            local = np.einsum("em,emai,epiqj,embj->eapbq", weights, G, C, G, optimize=True)
            dofs = (c * self.nodes[:, elements].T[:, :, None] + np.arange(c)).reshape(elements.size, -1)
            rows, columns = np.repeat(dofs, dofs.shape[1], axis=1), np.tile(dofs, dofs.shape[1])
            total = total + coo_matrix((local.ravel(), (rows.ravel(), columns.ravel())), total.shape)
        return total.tocsr()

    def pieces(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Rules for squares of strains: elements (n,), points (2, n, m), weights (n, m)."""
        every, corners = np.arange(self.t.shape[1]), self.p[:, self.t]
        if self.data.order == 1:
            yield every, corners.mean(axis=1)[:, :, None], self.area[:, None]
            return
        middles = np.stack([corners[:, [a, b]].mean(axis=1) for a, b in SIDES], axis=2)
        yield every, middles, np.repeat(self.polygon[:, None] / 3, 3, axis=1)
        (s, w), (r, v) = composite(1, 8), composite(1, 4)
        for name, (x, y, radius) in self.data.circles.items():
            first, second = self.ends[..., self.facets(name)].transpose(1, 0, 2)[..., None]
            length, away = np.linalg.norm(second - first, axis=0), (first + second) / 2 - [[[x]], [[y]]]
            high = np.sqrt(radius**2 - ((s - 0.5) * length) ** 2) - np.sqrt(radius**2 - length**2 / 4)
            up = np.multiply.outer(high, r) * (away / np.linalg.norm(away, axis=0))[..., None]
            points = (first * (1 - s) + second * s)[..., None] + up
            weights = np.multiply.outer(self.outward(name)[:, None] * length * high * w, v)
            n = length.size
            yield self.mesh.f2t[0, self.facets(name)], points.reshape(2, n, -1), weights.reshape(n, -1)

    def hats(self, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Hat functions (3, n, m) of elements (n,), continued beyond them, at points (2, n, m)."""
        x, y = self.mapping.invF(points, tind=elements)
        return np.stack([1 - x - y, x, y])

    def shapes(self, elements: np.ndarray, points: np.ndarray) -> list[DiscreteField]:
        """Shape functions of nodes, with values (n, m), of elements (n,), continued beyond them."""
        hats = self.hats(elements, points)
        local = np.where(np.abs(hats) < 1e-12, 0.0, hats)[1:]
        every = range(len(self.nodes))
        return [self.element.gbasis(self.mapping, local, k, elements)[0] for k in every]

    def values(self, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Values (nodes, n, m) of shape functions."""
        return np.stack([np.asarray(shape) for shape in self.shapes(elements, points)])

    def slopes(self, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Their gradients (n, m, nodes, 2)."""
        return np.stack([shape.grad for shape in self.shapes(elements, points)]).transpose(2, 3, 0, 1)

    def at(self, elements: np.ndarray, points: np.ndarray) -> csr_matrix:
        """The matrix (n * m, nodes) from nodal values to those at points (2, n, m) of elements (n,)."""
        n, m = points.shape[1:]
        shape = len(self.nodes), n, m
        nodes = np.broadcast_to(self.nodes[:, elements][:, :, None], shape).ravel()
        rows = np.broadcast_to(np.arange(n * m).reshape(n, m), shape).ravel()
        entries = self.values(elements, points).ravel()
        matrix = coo_matrix((entries, (rows, nodes)), (n * m, self.size)).tocsr()
        matrix.eliminate_zeros()
        return matrix

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Triangles of points (2, n); of points beyond the mesh those that they are least outside of."""
        every = np.arange(self.t.shape[1])
        parts = np.array_split(points[:, None], 1 + every.size * points.shape[1] // 1_000_000, axis=2)
        return np.concatenate([self.hats(every, part).min(axis=0).argmax(axis=0) for part in parts])

    def trace(self, name: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
        """Points (2, n, m) at parameters t of a boundary's edges or arcs, lengths (n, 1), and :meth:`at`."""
        first, second = self.ends[..., self.facets(name)].transpose(1, 0, 2)[..., None]
        if name in self.data.circles:
            x, y, radius = self.data.circles[name]
            first, last = (np.arctan2(end[1] - y, end[0] - x) for end in (first, second))
            turn = (last - first + np.pi) % (2 * np.pi) - np.pi
            points = np.stack([x + radius * np.cos(first + turn * t), y + radius * np.sin(first + turn * t)])
            length = radius * np.abs(turn)
        else:
            points, length = first * (1 - t) + second * t, np.linalg.norm(second - first, axis=0)
        return points, length, self.at(self.mesh.f2t[0, self.facets(name)], points)

    def loads(self, n: int) -> np.ndarray:
        """Forces (unknowns,) by Gauss's rule with n x n points on elements, n on each of 8 parts of edges.

        Elements and edges are cut where loads jump.
        """
        (a, b), (v, w) = (np.meshgrid(*(part,) * 2) for part in composite(1, n))
        X, W = np.stack([a.ravel(), (b * (1 - a)).ravel()]), (v * w * (1 - a)).ravel()  # collapsed square
        every, corners = self.cut()
        points = corners[:, 0, :, None] + np.einsum("iae,aq->ieq", corners[:, 1:] - corners[:, :1], X)
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area, material_of = np.abs(first[0] * second[1] - first[1] * second[0]) / 2, self.material[every]
        shapes, F = self.values(every, points), np.zeros(self.c * self.size)
        for number, material in enumerate(self.data.materials):
            weights = 2 * W * (area * (material_of == number))[:, None]
            for component, text in enumerate(material.loads):
                if text != 0:
                    assert not self.data.circles, "body forces are not integrated over segments"
                    share = np.einsum("aem,em->ae", shapes, values(text, points) * weights)
                    np.add.at(F, self.c * self.nodes[:, every] + component, share)
        t, w = composite(8, n)
        for name, tractions in self.data.tractions.items():
            ends = self.breaks(name)
            for low, high in zip(ends[:-1, :, None], ends[1:, :, None], strict=True):
                points, length, trace = self.trace(name, low + (high - low) * t)
                for component, text in enumerate(tractions):
                    weights = length * (high - low) * w
                    F[component :: self.c] += trace.T @ (values(text, points) * weights).ravel()
        return F

    def breaks(self, name: str) -> np.ndarray:
        """(k, edges) parameters of the ends of edges and of jumps on them, in ascending order."""
        (first, last), _ = self.ends[..., self.facets(name)]
        rise = np.where(first == last, 1.0, last - first)
        inner = [np.clip(np.where(first == last, 0.0, (at - first) / rise), 0, 1) for at in self.data.jumps]
        return np.sort(np.stack([np.zeros(first.size), np.ones(first.size), *inner]), axis=0)

    def cut(self) -> tuple[np.ndarray, np.ndarray]:
        """Triangles (n,) and corners (2, 3, n) of their parts between the jumps of loads."""
        every, corners = np.arange(self.t.shape[1]), self.p[:, self.t]
        for at in self.data.jumps:
            low, high = corners[0].min(axis=0) < at - 1e-12, corners[0].max(axis=0) > at + 1e-12
            crossed = np.flatnonzero(low & high)
            parts = [(k, part) for k in crossed for part in _halves(corners[:, :, k], at)]
            kept = ~(low & high)
            every = np.append(every[kept], [every[k] for k, _ in parts]).astype(int)
            new = np.stack([part for _, part in parts], axis=2) if parts else corners[:, :, :0]
            corners = np.concatenate([corners[:, :, kept], new], axis=2)
        return every, corners

    @cached_property
    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """Which unknowns are held, and displacements (unknowns,) with their values."""
        held, value = np.zeros((2, self.c * self.size))
        for name, entries in self.data.held.items():
            assert name not in self.data.circles, (
                "displacements given on a curve are not interpolated exactly"
            )
            nodes = self.nodes_on(name)
            for component, entry in enumerate(entries):
                if entry is not None:
                    held[self.c * nodes + component], value[self.c * nodes + component] = 1, entry
        return held > 0, value

    def along(self, matrix: csr_matrix, directions: np.ndarray) -> csr_matrix:
        """Rows ``direction . u`` of unknowns, from a matrix of nodal values and directions (c, ...)."""
        parts = [matrix.multiply(part.reshape(-1, 1)).tocsc() for part in directions]
        order = np.arange(self.c * self.size).reshape(self.c, -1).T.ravel()
        return hstack(parts).tocsc()[:, order].tocsr()

    def from_arcs(self, u: np.ndarray) -> np.ndarray:
        """Displacements by values at nodes, those of edges on curves at the middles of their arcs.

        There an isoparametric element has its node, and the polynomial that is continued beyond its triangle
        is to have the same value.
        """
        u = np.array(u).reshape(-1, self.c)
        for name in self.data.circles if self.data.order == 2 else ():
            beside, own = self.mesh.f2t[0, self.facets(name)], self.p.shape[1] + self.facets(name)
            middle = self.trace(name, np.array([0.5]))[0]
            shapes, nodes = self.values(beside, middle)[..., 0], self.nodes[:, beside]
            others = np.where(nodes == own, 0.0, shapes)
            rest = u[own] - np.einsum("an,anc->nc", others, u[nodes])
            u[own] = rest / np.sum(shapes - others, axis=0)[:, None]
        return u.ravel()

    def nodes_on(self, name: str) -> np.ndarray:
        """Nodes of a named boundary."""
        facets = self.facets(name)
        middles = self.p.shape[1] + facets if self.data.order == 2 else facets[:0]
        return np.append(np.unique(self.mesh.facets[:, facets]), middles)

    def gradients(self, u: np.ndarray, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Displacement gradients (n, m, c, 2) of elements (n,) at points (2, n, m)."""
        nodal = u.reshape(-1, self.c)[self.nodes[:, elements]]
        return np.einsum("emai,aep->empi", self.slopes(elements, points), nodal)

    def density(self, gradient: np.ndarray) -> np.ndarray:
        """``grad u : C : grad u`` (elements,) for gradients (elements, c, 2)."""
        return np.einsum("epi,epiqj,eqj->e", gradient, self.tensor[self.material], gradient, optimize=True)


def _halves(corners: np.ndarray, at: float) -> Iterator[np.ndarray]:
    """Triangles (2, 3) left and right of the line x = at, of one that it crosses."""
    for side in (-1.0, 1.0):
        polygon = []
        for k in range(3):
            a, b = corners[:, k], corners[:, (k + 1) % 3]
            off_a, off_b = side * (a[0] - at), side * (b[0] - at)
            if off_a >= 0:
                polygon.append(a)
            if off_a * off_b < 0:
                polygon.append(a + off_a / (off_a - off_b) * (b - a))
        for b, c in pairwise(polygon[1:]):
            yield np.stack([polygon[0], b, c], axis=1)
