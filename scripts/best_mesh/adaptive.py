"""Written first by anyone who has scikit-fem: elements of order 1 or 2 in contact, on h-adaptive meshes.

``-div sigma(grad u) = f``; u is given on a part of the boundary, ``u + offset >= 0`` elsewhere (the last
component), with Tresca friction of the first component. Nothing of `rmesh_nlp` is used. At order 2 contact
and friction are those of Bernstein's coefficients, so that no parabola enters the foundation.
The adaptive loop is the usual one: solve by a primal-dual active set, estimate by residuals and jumps
(R. Verfürth, A posteriori error estimation techniques, OUP 2013, section 1.4), mark half of the sum
(W. Dörfler, SIAM J. Numer. Anal. 33 (1996) 1106-1124), refine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from skfem import (
    Basis,
    BilinearForm,
    ElementTriP1,
    ElementTriP2,
    ElementVector,
    FacetBasis,
    Functional,
    InteriorFacetBasis,
    LinearForm,
    MeshTri,
)
from skfem.helpers import grad
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

BULK, RULE, FINE, EDGES, MOST = 0.5, 6, 10, 3, 100
"""Dörfler's share; degrees of the rules for the load, for errors and jumps; most steps of an active set."""

DOUBT, DEPTH = 1e-4, 12
"""Part of the error by which rules may differ on an element; times that it is else cut at its corners."""

ELEMENTS = {1: ElementTriP1(), 2: ElementTriP2()}
"""By order."""

OnPoints = Callable[[NDArray], NDArray]


def nothing(x: NDArray) -> NDArray:
    """Zero at points (2, ...)."""
    return np.zeros(x.shape[1:])


@dataclass(frozen=True)
class Equations:
    """A problem by functions of points (2, ...), whose values (...) may have a first axis of components.

    ``held`` says which points of the boundary have u ``given``, ``above`` which are contact nodes; ``slope``
    has gradients (2, ...) of the exact solution; the stress is one of gradients (components, 2, ...);
    ``offset`` is linear on edges, and ``friction`` the bound of the friction stress.
    """

    source: OnPoints
    held: OnPoints
    above: OnPoints = nothing
    given: OnPoints = nothing
    slope: OnPoints | None = None
    components: int = 1
    stress: Callable[[NDArray], NDArray] = lambda gradient: gradient
    traction: OnPoints = nothing
    offset: OnPoints = nothing
    friction: OnPoints | None = None


@dataclass(frozen=True)
class Solved:
    """Values u (unknowns,) whose numbers are ``dofs`` (components, nodes), and the processor time so far.

    ``touching`` and ``slip`` (nodes,) are the state of contact: 1 and -1 are directions, 0 is stick.
    """

    basis: Basis
    dofs: NDArray
    u: NDArray
    contact: NDArray
    touching: NDArray
    slip: NDArray
    energy: float
    seconds: float

    @property
    def nodes(self) -> int:
        """Their number."""
        return int(self.dofs.shape[1])

    @property
    def points(self) -> NDArray:
        """(2, nodes)."""
        return self.basis.doflocs[:, self.dofs[0]]


def solve(
    problem: Equations, mesh: MeshTri, order: int, before: Solved | None = None, spent: float = 0.0
) -> Solved:
    """Solve on a mesh by a primal-dual active set that starts from the state of another mesh."""
    began = time.process_time()
    element = ELEMENTS[order]
    basis = Basis(mesh, element if problem.components == 1 else ElementVector(element), intorder=RULE)
    dofs = np.hstack([basis.nodal_dofs, basis.facet_dofs][:order])
    x, n, nodes = basis.doflocs[:, dofs[0]], mesh.p.shape[1], dofs.shape[1]
    rim = np.isin(dofs[0], basis.get_dofs().flatten())
    held = rim & np.broadcast_to(problem.held(x) > 0, dofs.shape)
    above = (problem.above(x) > 0) & ~held[-1]
    matrix = BilinearForm(lambda u, v, _: _dot(problem.stress(grad(u)), grad(v))).assemble(basis)
    load = LinearForm(lambda v, w: _dot(problem.source(w.x), v)).assemble(basis)
    load += LinearForm(lambda v, w: _dot(problem.traction(w.x), v)).assemble(basis.boundary())
    # values from Bernstein's coefficients, at contact edges
    to_values = sp.identity(basis.N, format="csr")
    if order == 2:
        edges = np.flatnonzero(above[n:])
        middle, ends = dofs[:, n + edges], dofs[:, mesh.facets[:, edges]]
        shares = [(middle, middle, -0.5), (middle, ends[:, 0], 0.25), (middle, ends[:, 1], 0.25)]
        for row, column, share in shares:
            parts = np.full(row.size, share), (row.ravel(), column.ravel())
            to_values = to_values + sp.csr_matrix(parts, shape=matrix.shape)
    matrix, load = (to_values.T @ matrix @ to_values).tocsr(), to_values.T @ load
    bound = np.zeros(nodes)
    if problem.friction is not None:
        on = LinearForm(lambda v, w: _dot(np.stack([problem.friction(w.x), 0 * w.x[1]]), v))
        facets = mesh.facets_satisfying(lambda x: problem.above(x) > 0, boundaries_only=True)
        bound = (to_values.T @ on.assemble(basis.boundary(facets)))[dofs[0]]
    rough = bound > 0
    c, offset = np.zeros(dofs.shape), problem.offset(x)
    c[held] = np.broadcast_to(problem.given(x), dofs.shape)[held]
    touching, slip = np.zeros(nodes, dtype=bool), np.zeros(nodes)
    if before is not None and np.any(above):
        near = before.contact[cKDTree(before.points[:, before.contact].T).query(x[:, above].T)[1]]
        touching[above], slip[above] = before.touching[near], before.slip[near]
    for _ in range(MOST):
        fixed = held.copy()
        fixed[-1] |= touching
        fixed[0] |= rough & (slip == 0)
        c[-1, touching], c[0, rough & (slip == 0) & ~held[0]] = -offset[touching], 0.0
        u, free, push = np.zeros(basis.N), np.ones(basis.N, dtype=bool), load.copy()
        free[dofs[fixed]], u[dofs[fixed]] = False, c[fixed]
        push[dofs[0]] -= slip * bound
        u[free] = splu(
            matrix[free][:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).solve((push - matrix @ u)[free])
        c, force = u[dofs], (matrix @ u - load)[dofs]
        slid = np.where(slip == 0, -np.sign(force[0]) * (abs(force[0]) > bound), slip * (slip * c[0] > 0))
        now = above & np.where(touching, force[-1] > 0, c[-1] + offset < 0), rough * ~held[0] * slid
        if np.array_equal(now, (touching, slip)):
            break
        touching, slip = now
    energy = float(u @ (matrix @ u) / 2 - load @ u + bound @ abs(c[0]))
    spent += time.process_time() - began
    return Solved(basis, dofs, to_values @ u, np.flatnonzero(above), touching, slip, energy, spent)


def half_square(basis: Basis, u: NDArray, slope: OnPoints) -> float:
    """Half the square of the error in the energy norm, for the gradient of the exact solution."""
    density = Functional(lambda w: ((w["u"].grad - slope(np.asarray(w.x))) ** 2).sum(axis=0) / 2)

    def integrals(elements: NDArray | None, **rule: Any) -> NDArray:
        fine = Basis(basis.mesh, basis.elem, elements=elements, **rule)
        return np.asarray(density.elemental(fine, u=fine.interpolate(u)))

    result = integrals(None, intorder=FINE)
    doubtful = np.flatnonzero(abs(result - integrals(None, intorder=RULE)) > DOUBT * result.sum())
    if doubtful.size:
        result[doubtful] = integrals(doubtful, quadrature=_towards_corners())
    return float(result.sum())


def _towards_corners() -> tuple[NDArray, NDArray]:
    """A rule on the reference triangle for singularities at corners, by ever smaller triangles."""
    eye, half = np.eye(3), (np.ones((3, 3)) - np.eye(3)) / 2
    cells = [half]
    for c, a, b in (np.roll(eye, k, axis=0) for k in range(3)):
        for s in 0.5 ** np.arange(1, DEPTH):
            m, ha, hb = (a + b) / 2, (a + c) / 2, (b + c) / 2
            cells += [c + s * (np.stack(one) - c) for one in ((a, m, ha), (m, b, hb), (m, hb, ha))]
        cells.append(c + 0.5**DEPTH * (np.stack((c, a, b)) - c))
    x, w = get_quadrature(RefTri, FINE)
    shares = np.einsum("kn,mkv->vmn", np.stack([1 - x.sum(axis=0), *x]), np.stack(cells))
    weights = np.outer(np.abs(np.linalg.det(np.stack(cells))), w)
    return shares[1:].reshape(2, -1), weights.ravel()


def indicators(problem: Equations, solved: Solved) -> NDArray:
    """(elements,) ``h^2 |f + div sigma|^2 + h |jump of sigma n|^2``, jumps with half at interior edges.

    On the boundary jumps are those to the tractions, where neither displacement nor contact is given. Where
    all nodes touch, the obstacle bears the source.
    """
    mesh, basis, components = solved.basis.mesh, solved.basis, problem.components

    def traction(side: FacetBasis, gradient: NDArray) -> NDArray:
        stress = problem.stress(np.asarray(gradient)).reshape(components, 2, *side.dx.shape)
        return (stress * np.asarray(side.normals)).sum(axis=1)

    def weighted(side: FacetBasis, jump: NDArray) -> NDArray:
        return side.dx.sum(axis=1) * ((jump**2).sum(axis=0) * side.dx).sum(axis=1)

    corners = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.full(3, 1 / 6)
    slope = np.asarray(Basis(mesh, basis.elem, quadrature=corners).interpolate(solved.u).grad)
    stress = problem.stress(slope).reshape(components, 2, -1, 3)  # linear on elements
    shares = mesh.mapping().invA.transpose(1, 2, 0)  # gradients of two barycentric coordinates
    divergence = np.einsum("cdek,dek->ce", stress[..., 1:] - stress[..., :1], shares)
    f = np.broadcast_to(problem.source(np.asarray(basis.global_coordinates())), (components, *basis.dx.shape))
    x, number = mesh.p[:, mesh.t], np.zeros(basis.N, dtype=int)
    h2 = ((x - np.roll(x, 1, axis=1)) ** 2).sum(axis=0).max(axis=0)
    residual = ((f + divergence[..., None]) ** 2 * basis.dx).sum(axis=(0, 2))
    number[solved.dofs] = np.arange(solved.nodes)
    result = np.where(solved.touching[number[basis.element_dofs]].all(axis=0), 0.0, h2 * residual)

    sides = [InteriorFacetBasis(mesh, basis.elem, intorder=EDGES, side=side) for side in (0, 1)]
    jump = traction(sides[0], np.subtract(*(side.interpolate(solved.u).grad for side in sides)))
    both = mesh.f2t[:, sides[0].find].ravel()
    result += np.bincount(both, np.tile(weighted(sides[0], jump) / 2, 2), mesh.nelements)

    rim = FacetBasis(mesh, basis.elem, intorder=EDGES)
    ends, place = mesh.facets[:, rim.find], np.asarray(rim.global_coordinates())
    middle = mesh.p[:, ends].mean(axis=1)
    jump = traction(rim, rim.interpolate(solved.u).grad) - problem.traction(place)
    is_given = np.broadcast_to(problem.held(middle) > 0, (components, middle.shape[1])).copy()
    is_given[-1] |= solved.touching[ends].any(axis=0)
    if problem.friction is not None:
        contact, slip = problem.above(middle) > 0, solved.slip[ends]
        is_given[0] |= contact & (slip == 0).any(axis=0)
        jump[0] += (contact * slip.mean(axis=0))[:, None] * problem.friction(place)
    jump = np.where(is_given[..., None], 0.0, jump)
    return result + np.bincount(mesh.f2t[0, rim.find], weighted(rim, jump), mesh.nelements)


def adaptive(problem: Equations, mesh: MeshTri, order: int, most: int) -> Iterator[Solved]:
    """Meshes refined by the estimator, up to a number of nodes."""
    solved = solve(problem, mesh, order)
    while solved.nodes <= most:
        yield solved
        began = time.process_time()
        errors = indicators(problem, solved)
        ranked = np.argsort(-errors)
        share = np.searchsorted(np.cumsum(errors[ranked]), BULK * errors.sum())
        mesh = mesh.refined(ranked[: 1 + share])
        solved = solve(problem, mesh, order, solved, solved.seconds + time.process_time() - began)


def uniform(problem: Equations, mesh: MeshTri, order: int, most: int) -> Iterator[Solved]:
    """Meshes refined uniformly, up to a number of nodes; each has the time of its own solve."""
    solved = solve(problem, mesh, order)
    while solved.nodes <= most:
        yield solved
        mesh = mesh.refined()
        solved = solve(problem, mesh, order, solved)


def _dot(a: NDArray, b: NDArray) -> NDArray:
    """Sum of products over components, at (elements, points)."""
    product = np.asarray(a) * np.asarray(b)
    return product.reshape(-1, *product.shape[-2:]).sum(axis=0)
