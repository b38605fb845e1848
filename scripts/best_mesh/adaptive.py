"""Written first by anyone who has scikit-fem: h-adaptive linear elements, quadratic ones on a given mesh.

``-Laplace(u) = f``, u given on a part of the boundary and perhaps ``u >= 0`` elsewhere. Nothing of
`rmesh_nlp` is used. The adaptive loop is the usual one: solve, estimate by residuals and jumps (R. Verfürth,
A posteriori error estimation techniques, OUP 2013, section 1.4), mark half of the sum (W. Dörfler, SIAM J.
Numer. Anal. 33 (1996) 1106-1124), refine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, Element, ElementTriP1, ElementTriP2, LinearForm, MeshTri
from skfem.helpers import dot, grad

BULK, RULE, FINE = 0.5, 6, 10
"""Dörfler's share; degrees of the rules for the load and for errors."""

OnPoints = Callable[[NDArray], NDArray]
stiffness = BilinearForm(lambda u, v, _: dot(grad(u), grad(v)))


@dataclass(frozen=True)
class Laplacian:
    """A problem by functions of points (2, ...).

    Attributes
    ----------
    source : callable
    held : callable
        Which points of the boundary have u given.
    above : callable, optional
        Which points have u >= 0, none of them by default.
    given : callable, optional
        The values of u where it is held; 0 by default.
    slope : callable, optional
        Gradients (2, ...) of the exact solution. Errors are then half squares of that in the energy norm, and
        else those of the energy, against ``exact``.
    """

    source: OnPoints
    held: OnPoints
    above: OnPoints | None = None
    given: OnPoints | None = None
    slope: OnPoints | None = None
    exact: float = float("nan")


@dataclass(frozen=True)
class Solved:
    """Values (unknowns,), nodes in contact, their forces, the energy, and the processor time so far."""

    basis: Basis
    u: NDArray
    active: NDArray
    energy: float
    seconds: float

    @property
    def mesh(self) -> MeshTri:
        """Of the basis."""
        return self.basis.mesh


def solve(problem: Laplacian, mesh: MeshTri, element: Element, active: NDArray, spent: float = 0.0) -> Solved:
    """Solve on a mesh by a primal-dual active set that starts from the points ``active`` (2, n)."""
    began = time.process_time()
    basis = Basis(mesh, element, intorder=RULE)
    matrix = stiffness.assemble(basis).tocsr()
    load = LinearForm(lambda v, w: problem.source(w.x) * v).assemble(basis)
    rim = basis.get_dofs().all()
    held = rim[problem.held(basis.doflocs[:, rim])]
    value, contact = np.zeros(basis.N), np.zeros(0, dtype=int)
    if problem.given is not None:
        value[held] = problem.given(basis.doflocs[:, held])
    if problem.above is not None:
        contact = np.setdiff1d(np.flatnonzero(problem.above(basis.doflocs)), held)
    touching = _among(basis.doflocs[:, contact], active)
    while True:
        free = np.ones(basis.N, dtype=bool)
        free[held] = free[contact[touching]] = False
        u = value.copy()
        u[free] = splu(
            matrix[free][:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).solve((load - matrix @ value)[free])
        force = (matrix @ u - load)[contact]
        new = np.where(touching, force > 0, u[contact] < 0)
        if np.array_equal(new, touching):
            energy = float(u @ (matrix @ u) / 2 - load @ u)
            spent += time.process_time() - began
            return Solved(basis, u, basis.doflocs[:, contact[touching]], energy, spent)
        touching = new


def error(problem: Laplacian, solved: Solved) -> float:
    """Of the energy, or half its square in the energy norm."""
    if problem.slope is None:
        return solved.energy - problem.exact
    fine = Basis(solved.mesh, solved.basis.elem, intorder=FINE)
    away = fine.interpolate(solved.u).grad - problem.slope(np.asarray(fine.global_coordinates()))
    return float(((away**2).sum(axis=0) * fine.dx).sum() / 2)


def indicators(problem: Laplacian, solved: Solved) -> NDArray:
    """(elements,) ``h^2 |f|^2 + 1/2 sum_E h_E |jump of du/dn|^2`` over interior edges E.

    Where all vertices touch, the obstacle bears the source.
    """
    mesh, basis = solved.mesh, solved.basis
    dx = basis.dx
    f = problem.source(np.asarray(basis.global_coordinates()))
    corners = mesh.p[:, mesh.t]
    h2 = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=0).max(axis=0)
    touching = _among(mesh.p, solved.active)[mesh.t].all(axis=0)
    result = np.where(touching, 0.0, h2 * (f**2 * dx).sum(axis=1))
    slope = basis.interpolate(solved.u).grad[..., 0]
    inside = np.flatnonzero(mesh.f2t[1] >= 0)
    a, b = mesh.p[:, mesh.facets[:, inside]].transpose(1, 0, 2)
    one, two = mesh.f2t[:, inside]
    jump = slope[:, one] - slope[:, two]
    # the edge's length times that of the normal, both in the cross product
    size = ((b[1] - a[1]) * jump[0] - (b[0] - a[0]) * jump[1]) ** 2 / 2
    return result + np.bincount(mesh.f2t[:, inside].ravel(), np.tile(size, 2), mesh.t.shape[1])


def adaptive(problem: Laplacian, mesh: MeshTri, most: int) -> Iterator[Solved]:
    """Linear elements on meshes refined by the estimator, up to a number of nodes."""
    active, spent = np.zeros((2, 0)), 0.0
    while mesh.p.shape[1] <= most:
        solved = solve(problem, mesh, ElementTriP1(), active, spent)
        yield solved
        began = time.process_time()
        errors = indicators(problem, solved)
        order = np.argsort(-errors)
        share = np.searchsorted(np.cumsum(errors[order]), BULK * errors.sum())
        mesh, active = mesh.refined(order[: 1 + share]), solved.active
        spent = solved.seconds + time.process_time() - began


def quadratic(problem: Laplacian, mesh: MeshTri) -> Solved:
    """Quadratic elements on a mesh, with u >= 0 at nodes and midpoints of the contact edges."""
    return solve(problem, mesh, ElementTriP2(), np.zeros((2, 0)))


def _among(points: NDArray, active: NDArray) -> NDArray:
    """Which points are active ones."""
    if not points.size or not active.size:
        return np.zeros(points.shape[1], dtype=bool)
    return np.asarray(cKDTree(active.T).query(points.T)[0] < 1e-8)
