"""The least energy of all admissible displacements of a mesh: convex, with rows of gaps and of friction."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.sparse import block_diag, bmat, csr_matrix, identity, vstack
from skfem import MeshTri

from truth.body import Body, composite
from truth.data import Data, values

CHECK = 512, 96
"""Parts of a contact edge, or of the side of a triangle over an interior obstacle, where gaps are checked."""

Rows = tuple[csr_matrix, np.ndarray, np.ndarray]
"""A, d, b: where b is infinite a row is the constraint A u + d >= 0, else friction b |A u + d|."""

PIQP = {"eps_abs": 1e-11, "eps_rel": 1e-11, "verbose": False}
"""1e-12 is not always reached; its points are inside all gaps, whatever the tolerance."""


@dataclass(frozen=True)
class Equilibrium:
    """A displacement (unknowns,) of a mesh, with friction integrated in its ``energy`` J.

    ``resultant`` is the sum of all normal forces.
    """

    body: Body
    u: np.ndarray
    energy: float
    converged: bool
    resultant: float


def minimise(K: csr_matrix, f: np.ndarray, rows: Rows) -> tuple[np.ndarray, np.ndarray, bool]:
    """Minimise ``u.K u / 2 - f.u`` with rows: u, the forces of the rows, and whether that converged.

    A quadratic program whose last unknowns are the magnitudes of the slips, by PIQP (R. Schwan, Y. Jiang,
    D. Kuhn, C. N. Jones, A proximal interior-point quadratic programming solver, CDC 2023).
    """
    A, d, b = rows
    rough = np.isfinite(b)
    gaps, slips, size = A[~rough], A[rough], identity(int(rough.sum()))
    H = ca.DM(block_diag([(K + K.T) / 2, 0 * size], format="csc"))
    G = ca.DM(bmat([[gaps, None], [slips, size], [-slips, size]], format="csc"))
    how = {"piqp": PIQP, "error_on_fail": False}
    solver = ca.conic("least", "piqp", {"h": H.sparsity(), "a": G.sparsity()}, how)
    least = np.concatenate([-d[~rough], -d[rough], d[rough]])
    answer = solver(h=H, g=np.append(-f, b[rough]), a=G, lba=least, uba=np.inf)
    open_, back, forth = np.split(-answer["lam_a"].full().ravel(), np.cumsum([gaps.shape[0], slips.shape[0]]))
    forces = np.zeros(d.size)
    forces[~rough], forces[rough] = open_, back - forth
    return answer["x"].full().ravel()[: f.size], forces, bool(solver.stats()["success"])


def gap_rows(body: Body, parts: int) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
    """Gaps A u + d at the ends of equal parts of contact edges or triangles' sides, and which can move."""
    foundation, t = body.data.foundation, np.arange(parts + 1) / parts
    if foundation.kind == "interior":
        a, b = (part[np.add.outer(t, t) <= 1 + 1e-9] for part in np.meshgrid(t, t, indexing="ij"))
        points = np.einsum("iae,aq->ieq", body.p[:, body.t], np.stack([1 - a - b, a, b]))
        matrix = body.at(np.arange(body.t.shape[1]), points)
    else:
        points, _, matrix = body.trace(foundation.boundary, t)
    normal, distance = foundation.at(points)
    A = body.along(matrix, normal)
    return A, distance.ravel(), np.asarray(np.abs(A[:, ~body.given[0]]).sum(axis=1)).ravel() > 1e-9


def slip_rows(body: Body, t: np.ndarray, w: np.ndarray) -> tuple[csr_matrix, np.ndarray]:
    """Rows of the slip, and bounds g ds, at points t of the contact edges with weights w."""
    foundation = body.data.foundation
    points, length, matrix = body.trace(foundation.boundary, t)
    normal, _ = foundation.at(points)
    rows = body.along(matrix, np.stack([normal[1], -normal[0]]))
    return rows, (values(foundation.friction, points) * length * w).ravel()


def friction(body: Body, u: np.ndarray, parts: int = 64) -> float:
    """The integral of g |u_t|: each part of an edge is split where u_t changes its sign."""
    if body.data.foundation.friction == 0:
        return 0.0
    t, (s, w) = np.arange(parts + 1) / parts, composite(1, 4)
    slip = (slip_rows(body, t, np.ones(parts + 1))[0] @ u).reshape(-1, parts + 1)
    first, second = slip[:, :-1, None], slip[:, 1:, None]
    root = np.where(first * second < 0, first / np.where(first == second, 1.0, first - second), 0.5)
    points = t[:-1, None] + np.concatenate([root * s, root + (1 - root) * s], axis=2) / parts
    weights = np.concatenate([root * w, (1 - root) * w], axis=2) / parts
    rows, bound = slip_rows(body, points.reshape(len(slip), -1), weights.reshape(len(slip), -1))
    return float(bound @ np.abs(rows @ u))


def energy(body: Body, F: np.ndarray, u: np.ndarray) -> float:
    """J(u)."""
    return float(u @ (body.stiffness @ u) / 2 - F @ u) + friction(body, u)


def accurate_loads(body: Body) -> np.ndarray:
    """Forces by a rule so fine that a coarser one agrees to 1e-9."""
    for n in (8, 12, 20, 32):
        F, before = body.loads(n), body.loads(n - 2)
        if np.max(np.abs(F - before)) <= 1e-9 * np.max(np.abs(F)):
            break
    return F


def contact_rows(body: Body, parts: int) -> tuple[Rows, int]:
    """Rows of friction, then of gaps, that are not given by supports, and the number of the first."""
    A, d, use = gap_rows(body, parts)
    A, d = A[use], d[use]
    if body.data.foundation.friction == 0:
        return (A, d, np.full(d.size, np.inf)), 0
    B, bound = slip_rows(body, *composite(4 * parts, 2))
    use = (np.asarray(np.abs(B[:, ~body.given[0]]).sum(axis=1)).ravel() > 1e-9) & (bound > 0)
    B, bound = B[use], bound[use]
    limits = np.append(bound, np.full(d.size, np.inf))
    return (vstack([B, A]).tocsr(), np.append(0 * bound, d), limits), bound.size


def equilibrium(body: Body, F: np.ndarray, parts: int = 1, check: int = 0) -> Equilibrium:
    """The least energy with gaps at the ends of ``parts`` (of order 2 twice as many) of edges or triangles.

    With ``check`` points where the gap is most negative among so many more are added, until none is.
    """
    held, u = body.given
    free, u = ~held, u.copy()
    (A, d, bound), slips = contact_rows(body, parts * body.data.order)
    fine = gap_rows(body, check) if check else None
    K, f, given = body.stiffness[free][:, free], (F - body.stiffness @ u)[free], np.where(held, u, 0.0)
    for _ in range(60):
        u[free], mu, converged = minimise(K, f, (A[:, free], d + A @ given, bound))
        if fine is None:
            break
        z = np.where(fine[2], fine[0] @ u + fine[1], np.inf).reshape(body.cells, -1)
        small = 1e-9 * np.max(np.abs(u))
        converged = converged and bool(np.min(z) >= -small)
        cells = np.flatnonzero(z.min(axis=1) < -small / 10)
        if converged or not cells.size:
            break
        new = cells * z.shape[1] + z[cells].argmin(axis=1)
        A, d = vstack([A, fine[0][new]]).tocsr(), np.append(d, fine[1][new])
        bound = np.append(bound, np.full(new.size, np.inf))
    return Equilibrium(body, u, energy(body, F, u), converged, float(np.sum(mu[slips:])))


def least(data: Data, mesh: MeshTri) -> Equilibrium:
    """The best admissible displacement of a mesh."""
    body = Body(data, mesh)
    return equilibrium(body, accurate_loads(body), 8, CHECK[data.foundation.kind == "interior"])


def blocked(body: Body) -> bool:
    """Whether supports alone press the body into the foundation: then nothing is admissible."""
    A, d, free = gap_rows(body, 8)
    return bool(np.min((A @ body.given[1] + d)[~free], initial=0.0) < -1e-9)
