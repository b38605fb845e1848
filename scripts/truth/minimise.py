"""The contact problem of a mesh: a convex quadratic energy with unilateral rows and rows of friction."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.sparse import block_diag, bmat, csr_matrix, identity

Rows = tuple[csr_matrix, np.ndarray, np.ndarray]
"""A, d, b: where b is infinite a row is the constraint A u + d >= 0, else friction b |A u + d|."""

PIQP = {"eps_abs": 1e-11, "eps_rel": 1e-11, "verbose": False}
"""1e-12 is not always reached; its points are inside all gaps, whatever the tolerance."""


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
