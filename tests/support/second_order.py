"""Contact solutions of order 2 by scikit-fem alone: its P2 elements and assembly, and a dual program.

Nothing of the package's discretisation is used. Unknowns are values at vertices and middles of edges. Gaps
and slips are rows in Bernstein's coefficients of these values,

    c_a = u(a),    c_m = 2 u(m) - (u(a) + u(b)) / 2,

and the least energy with ``N u + d >= 0`` and friction ``sum_i g_i |(S u)_i|`` is found by its dual: contact
forces ``z = (lambda, tau)``, ``lambda >= 0`` and ``|tau| <= g``, of

    max  J(u(z)) - d . lambda,    K u(z) = f + N^T lambda - S^T tau,

a bounded least-squares problem, solved by scipy's active set (bvls).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementTriP2, ElementVector, FacetBasis, LinearForm
from skfem.helpers import dot, grad
from skfem.models.elasticity import linear_elasticity

from rmesh_nlp.problem import ContactProblem, Laplace, Obstacle, PlaneStress

DEGREE = 16
"""Of all rules: above it the integrals of the random problems change by less than 1e-12."""


def at(coefficient: Any, x: np.ndarray) -> np.ndarray:
    """Values of a number or a function of position at points (2, ...)."""
    if not callable(coefficient):
        return np.full(x.shape[1:], float(coefficient))
    symbols = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function("coefficient", list(symbols), [coefficient(*symbols)])
    return np.asarray(function(x[0].reshape(1, -1), x[1].reshape(1, -1))).reshape(x.shape[1:])


class SecondOrder:
    """The quadratic program of a problem on its mesh, in values at vertices and at middles of edges."""

    def __init__(self, problem: ContactProblem) -> None:
        self.problem, self.mesh = problem, problem.mesh
        element = ElementTriP2() if problem.components == 1 else ElementVector(ElementTriP2())
        self.basis = Basis(self.mesh, element, intorder=DEGREE)
        parts = [self.basis.nodal_dofs, self.basis.facet_dofs]
        self.dofs = np.hstack(parts)  # (components, nodes)
        self.K, self.f = self._bulk(element)
        for traction in problem.tractions:
            self.f += self._on(traction.boundary, traction.value)
        for load in problem.point_loads:
            self.f[self.dofs[:, load.node]] += load.force

    def points(self) -> np.ndarray:
        """(2, nodes) vertices and middles of edges."""
        return np.hstack([self.mesh.p, self.mesh.p[:, self.mesh.facets].mean(axis=1)])

    def solve(self) -> tuple[np.ndarray, float]:
        """Values (components, nodes) and the energy."""
        u, free = self._given()
        N, d, S, bound = self._rows(free)
        rows, bound_of = np.vstack([N, S]), np.concatenate([np.full(len(N), np.inf), bound])
        factors = splu(self.K[free][:, free].tocsc())
        load = self.f[free] - self.K[free] @ u
        base, response = factors.solve(load), factors.solve(rows[:, free].T)
        # minimise z.A z / 2 + b.z over the bounds of the forces z, those of friction with their sign turned
        A, b = rows[:, free] @ response, rows @ u + rows[:, free] @ base
        b[: len(N)] += d
        z = np.zeros(len(rows))
        if z.size:
            L = cholesky(A, lower=True)
            lower = np.where(np.isinf(bound_of), 0.0, -bound_of)
            held = np.flatnonzero(bound_of == 0)  # bvls asks for room
            lower[held], bound_of[held] = -1e-300, 1e-300
            z = lsq_linear(L.T, -solve_triangular(L, b, lower=True), (lower, bound_of), "bvls", 1e-15).x
        u[free] = base + response @ z
        energy = u @ (self.K @ u) / 2 - self.f @ u + bound @ np.abs(S @ u)
        return u[self.dofs], float(energy)

    def _bulk(self, element: Any) -> tuple[Any, np.ndarray]:
        K, f = 0, np.zeros(self.basis.N)
        for law, elements in self.problem.regions:
            basis = Basis(self.mesh, element, elements=elements, intorder=DEGREE)
            if isinstance(law, Laplace):
                form = BilinearForm(lambda u, v, _, k=law.conductivity: k * dot(grad(u), grad(v)))
            else:
                lame, mu = law.lame_lambda, law.lame_mu
                if isinstance(law, PlaneStress):  # plane strain of another material
                    lame = 2 * lame * mu / (lame + 2 * mu)
                form = linear_elasticity(lame, mu)
            K = K + form.assemble(basis)
            f += self._load(law.load).assemble(basis)
        return K.tocsr(), f

    def _load(self, value: Any) -> LinearForm:
        def form(v: Any, w: Any) -> Any:
            load = np.stack([at(component, np.asarray(w.x)) for component in value])
            return load[0] * v if self.problem.components == 1 else dot(load, v)

        return LinearForm(form)

    def _on(self, boundary: str, value: Any) -> np.ndarray:
        facets = self.mesh.boundaries[boundary]
        basis = FacetBasis(self.mesh, self.basis.elem, facets=facets, intorder=DEGREE)
        return self._load(value).assemble(basis)

    def _given(self) -> tuple[np.ndarray, np.ndarray]:
        """Given values, zero elsewhere, and the numbers of the unknowns that are free."""
        u, held, x = np.zeros(self.basis.N), np.zeros(self.basis.N, dtype=bool), self.points()
        for support in self.problem.supports:
            nodes = self._nodes_on(support.boundary)
            for i, value in enumerate(support.value):
                if value is not None:
                    u[self.dofs[i, nodes]], held[self.dofs[i, nodes]] = at(value, x[:, nodes]), True
        return u, np.flatnonzero(~held)

    def _nodes_on(self, boundary: Any) -> np.ndarray:
        if not isinstance(boundary, str):
            return np.arange(self.dofs.shape[1])
        facets = np.asarray(self.mesh.boundaries[boundary])
        return np.append(np.unique(self.mesh.facets[:, facets]), self.mesh.p.shape[1] + np.unique(facets))

    def _rows(self, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Gaps ``N u + d`` and slips ``S u`` (dense) with their bounds, where they are free."""
        x, T = self.points(), self._to_bernstein()
        empty = np.zeros((0, self.basis.N))
        normal, offset, slip, bound = [empty], [np.zeros(0)], [empty], [np.zeros(0)]
        for obstacle in self.problem.obstacles:
            nodes, n = self._nodes_on(obstacle.boundary), obstacle.normals(x)
            rows, moves = self._along(n, T, nodes, free)
            normal.append(rows[moves])
            offset.append((T @ obstacle.distances(x))[nodes][moves])
            if obstacle.frictional:
                rows, moves = self._along(np.array([n[1], -n[0]]), T, nodes, free)
                slip.append(rows[moves])
                bound.append(self._friction_bound(obstacle, T)[nodes][moves])
        return np.vstack(normal), np.hstack(offset), np.vstack(slip), np.hstack(bound)

    def _to_bernstein(self) -> np.ndarray:
        """(nodes, nodes) coefficients of values."""
        n, (a, b) = self.mesh.p.shape[1], self.mesh.facets
        T, middle = np.eye(self.dofs.shape[1]), n + np.arange(a.size)
        T[middle, middle] = 2
        T[middle, a] = T[middle, b] = -1 / 2
        return T

    def _along(
        self, ways: np.ndarray, T: np.ndarray, nodes: np.ndarray, free: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the components of the coefficients at nodes, and which of them are not given."""
        rows, is_free = np.zeros((nodes.size, self.basis.N)), np.isin(self.dofs, free)
        for dofs, way in zip(self.dofs, ways[:, nodes], strict=True):
            rows[:, dofs] = way[:, None] * T[nodes]
        return rows, np.any(is_free[:, nodes] & (np.abs(ways[:, nodes]) > 1e-9), axis=0)

    def _friction_bound(self, obstacle: Obstacle, T: np.ndarray) -> np.ndarray:
        """(nodes,) integrals of the bound times Bernstein's polynomials; scikit-fem's are T^T times these."""
        facets = np.asarray(self.mesh.boundaries[str(obstacle.boundary)])
        basis = FacetBasis(self.mesh, ElementTriP2(), facets=facets, intorder=DEGREE)
        form = LinearForm(lambda v, w: at(obstacle.friction, np.asarray(w.x)) * v)
        return np.linalg.solve(T.T, form.assemble(basis)[np.append(basis.nodal_dofs[0], basis.facet_dofs[0])])
