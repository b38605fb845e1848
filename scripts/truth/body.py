"""Energies of continuous piecewise linear displacements on the domain of the true curves.

An element beside a curve is its triangle with the segment between edge and curve added, or taken away where
the curve bends into it; the displacement there is the linear function of the triangle. Segments of neighbours
meet at nodes only, so that the displacement is continuous, and admissible for the continuous problem; strains
stay constant on elements, affine displacements are exact, and areas are known in closed form.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, hstack
from scipy.spatial import cKDTree
from skfem import MeshTri
from skfem.quadrature import get_quadrature_line

from truth.data import Data, values


def composite(parts: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's rule on each of equal parts of [0, 1]: points and weights."""
    s, w = (part.ravel() for part in get_quadrature_line(2 * points - 1))
    return ((np.arange(parts)[:, None] + s) / parts).ravel(), np.tile(w, parts) / parts


class Body:
    """A problem on a mesh. Unknowns are numbered ``components * node + component``."""

    def __init__(self, data: Data, mesh: MeshTri) -> None:
        self.data, self.mesh, self.c = data, mesh, data.components
        self.p, self.t, self.ends = np.asarray(mesh.p), np.asarray(mesh.t), mesh.p[:, mesh.facets]
        one, two, three = (self.p[:, nodes] for nodes in self.t)
        J = np.stack([two - one, three - one], axis=1).transpose(2, 0, 1)
        self.slopes = np.array([[-1.0, 1, 0], [-1, 0, 1]]).T @ np.linalg.inv(J)  # (elements, 3, 2)
        self.polygon = np.abs(np.linalg.det(J)) / 2
        self.area = self.polygon.copy()
        for name, (x, y, radius) in data.circles.items():
            facets = self.facets(name)
            beside, ends = mesh.f2t[0, facets], self.ends[..., facets]
            middle = ends.mean(axis=1)
            outward = np.sum(
                (middle - [[x], [y]]) * (middle - self.p[:, self.t[:, beside]].mean(axis=1)), axis=0
            )
            half = np.arcsin(np.minimum(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0) / (2 * radius), 1))
            segment = radius**2 * (half - np.sin(half) * np.cos(half))
            np.add.at(self.area, beside, np.sign(outward) * segment)
        self.material = np.zeros(self.t.shape[1], dtype=int)
        for number, material in enumerate(data.materials):
            self.material[material.triangles(mesh)] = number
        self.tensor = np.stack([material.tensor for material in data.materials])

    def facets(self, name: str) -> np.ndarray:
        """Edges (n,) of a named boundary."""
        return np.asarray(self.mesh.boundaries[name])

    @property
    def cells(self) -> int:
        """Number of contact edges, or of triangles over an interior obstacle."""
        foundation = self.data.foundation
        return self.t.shape[1] if foundation.kind == "interior" else self.facets(foundation.boundary).size

    @cached_property
    def stiffness(self) -> csr_matrix:
        """K (unknowns, unknowns)."""
        c, C = self.c, self.tensor[self.material] * self.area[:, None, None, None, None]
        local = np.einsum("eai,epiqj,ebj->eapbq", self.slopes, C, self.slopes, optimize=True)
        dofs = (c * self.t.T[:, :, None] + np.arange(c)).reshape(-1, 3 * c)
        rows, columns = np.repeat(dofs, 3 * c, axis=1).ravel(), np.tile(dofs, 3 * c).ravel()
        return coo_matrix((local.ravel(), (rows, columns)), (c * self.p.shape[1],) * 2).tocsr()

    def hats(self, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Hat functions (3, n, m) of elements (n,), continued beyond them, at points (2, n, m)."""
        away = points - self.p[:, self.t[:, elements]].mean(axis=1)[:, :, None]
        hats = 1 / 3 + np.einsum("nai,inm->anm", self.slopes[elements], away)
        return np.where(np.abs(hats) < 1e-12, 0.0, hats)

    def at(self, elements: np.ndarray, points: np.ndarray) -> csr_matrix:
        """The matrix (n * m, nodes) from nodal values to those at points (2, n, m) of elements (n,)."""
        n, m = points.shape[1:]
        nodes = np.broadcast_to(self.t[:, elements][:, :, None], (3, n, m)).ravel()
        rows = np.broadcast_to(np.arange(n * m).reshape(n, m), (3, n, m)).ravel()
        entries = self.hats(elements, points).ravel()
        matrix = coo_matrix((entries, (rows, nodes)), (n * m, self.p.shape[1])).tocsr()
        matrix.eliminate_zeros()
        return matrix

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Triangles of points (2, n); of points beyond the mesh those that they are least outside of."""
        tree = cKDTree(self.p[:, self.t].mean(axis=1).T)
        found, inside = np.zeros(points.shape[1], dtype=int), np.full(points.shape[1], -np.inf)
        for elements in np.atleast_2d(tree.query(points.T, min(40, self.t.shape[1]))[1].T):
            todo = np.flatnonzero(inside < -1e-9)
            least = self.hats(elements[todo], points[:, todo, None]).min(axis=0)[:, 0]
            better = least > inside[todo]
            found[todo[better]], inside[todo[better]] = elements[todo][better], least[better]
        return found

    def trace(self, name: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
        """Points (2, n, m) at parameters t of a boundary's edges or arcs, lengths (n, 1), and :meth:`at`."""
        one, two = self.ends[..., self.facets(name)].transpose(1, 0, 2)[..., None]
        if name in self.data.circles:
            x, y, radius = self.data.circles[name]
            first, last = (np.arctan2(end[1] - y, end[0] - x) for end in (one, two))
            turn = (last - first + np.pi) % (2 * np.pi) - np.pi
            points = np.stack([x + radius * np.cos(first + turn * t), y + radius * np.sin(first + turn * t)])
            length = radius * np.abs(turn)
        else:
            points, length = one * (1 - t) + two * t, np.linalg.norm(two - one, axis=0)
        return points, length, self.at(self.mesh.f2t[0, self.facets(name)], points)

    def loads(self, n: int) -> np.ndarray:
        """Forces (unknowns,) by Gauss's rule with n x n points on elements, n on each of 8 parts of edges."""
        (a, b), (v, w) = (np.meshgrid(*(part,) * 2) for part in composite(1, n))
        X, W = np.stack([a.ravel(), (b * (1 - a)).ravel()]), (v * w * (1 - a)).ravel()  # collapsed square
        corners, every = self.p[:, self.t], np.arange(self.t.shape[1])
        points = corners[:, 0, :, None] + np.einsum("iae,aq->ieq", corners[:, 1:] - corners[:, :1], X)
        hats, F = self.hats(every, points), np.zeros(self.c * self.p.shape[1])
        for number, material in enumerate(self.data.materials):
            weights = 2 * W * (self.polygon * (self.material == number))[:, None]
            for component, text in enumerate(material.loads):
                if text != 0:
                    assert not self.data.circles, "body forces are not integrated over segments"
                    share = np.einsum("aem,em->ae", hats, values(text, points) * weights)
                    np.add.at(F, self.c * self.t + component, share)
        t, w = composite(8, n)
        for name, tractions in self.data.tractions.items():
            points, length, trace = self.trace(name, t)
            for component, text in enumerate(tractions):
                F[component :: self.c] += trace.T @ (values(text, points) * length * w).ravel()
        return F

    @cached_property
    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """Which unknowns are held, and displacements (unknowns,) with their values."""
        held, value = np.zeros((2, self.c * self.p.shape[1]))
        for name, entries in self.data.held.items():
            assert name not in self.data.circles, (
                "displacements given on a curve are not interpolated exactly"
            )
            nodes = np.unique(self.mesh.facets[:, self.facets(name)])
            for component, entry in enumerate(entries):
                if entry is not None:
                    held[self.c * nodes + component], value[self.c * nodes + component] = 1, entry
        return held > 0, value

    def along(self, matrix: csr_matrix, directions: np.ndarray) -> csr_matrix:
        """Rows ``direction . u`` of unknowns, from a matrix of nodal values and directions (c, ...)."""
        parts = [matrix.multiply(part.reshape(-1, 1)).tocsc() for part in directions]
        order = np.arange(self.c * self.p.shape[1]).reshape(self.c, -1).T.ravel()
        return hstack(parts).tocsc()[:, order].tocsr()

    def gradients(self, u: np.ndarray) -> np.ndarray:
        """Displacement gradients (elements, c, 2)."""
        return np.einsum("eai,eap->epi", self.slopes, u.reshape(-1, self.c)[self.t.T])

    def density(self, gradient: np.ndarray) -> np.ndarray:
        """``grad u : C : grad u`` (elements,) for gradients (elements, c, 2)."""
        return np.einsum("epi,epiqj,eqj->e", gradient, self.tensor[self.material], gradient, optimize=True)
