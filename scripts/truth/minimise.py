"""The contact problem of a mesh: a convex quadratic energy with unilateral rows and rows of friction."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, lstsq, solve
from scipy.optimize import brentq
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

PENALTY, HARDEST = 1e3, 1e7
"""Penalty of a row in units of the stiffness that it sees. More takes more steps, less more rounds."""

MOST = 1500
"""Unknowns of rows up to which the others are eliminated first."""

Found = tuple[np.ndarray, np.ndarray, bool]
"""Minimiser, forces of the rows, and whether the method converged."""


Rows = tuple[csr_matrix, np.ndarray, np.ndarray, np.ndarray]
"""A, d, low, high: with [0, inf) a row is the constraint A u + d >= 0, with [-b, b] friction b |A u + d|."""


def factorised(K: Any, order: str = "MMD_AT_PLUS_A") -> Any:
    """LU factors of a symmetric positive definite matrix, with diagonal pivots."""
    return splu(K.tocsc(), order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def minimise(
    K: csr_matrix,
    f: np.ndarray,
    rows: Rows,
    tolerance: float,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> Found:
    """Minimise ``u.K u / 2 - f.u + sum_r h_r((A u + d)_r)``, h_r(z) the maximum of -mu z over [low, high].

    Unknowns without a row are eliminated: with them ordered first, the last block of the factors is the
    factorised Schur complement.
    """
    A, d, low, high = rows
    u, mu = start or (np.zeros(f.size), 0 * d)
    with_row = np.zeros(f.size, dtype=bool)
    with_row[A.indices] = True
    rest, C = np.flatnonzero(~with_row), np.flatnonzero(with_row)
    if not rest.size or C.size > MOST:
        return multipliers(K, f, rows, tolerance, u, mu)
    inner, across = factorised(K[rest][:, rest]), K[rest][:, C]
    order = np.concatenate([rest[np.argsort(inner.perm_c)], C])
    whole = factorised(K[order][:, order], "NATURAL")
    place = whole.perm_c[rest.size :] - rest.size
    assert np.array_equal(np.sort(place), np.arange(C.size)), "the order was not kept"
    S = (whole.L[rest.size :, rest.size :] @ whole.U[rest.size :, rest.size :]).toarray()
    S = S[np.ix_(place, place)]
    reduced = f[C] - across.T @ inner.solve(f[rest])
    uC, mu, converged = multipliers((S + S.T) / 2, reduced, (A[:, C], d, low, high), tolerance, u[C], mu)
    u = np.zeros(f.size)
    u[C], u[rest] = uC, inner.solve(f[rest] - across @ uC)
    return u, mu, converged


def multipliers(K: Any, f: np.ndarray, rows: Rows, tolerance: float, u: np.ndarray, mu: np.ndarray) -> Found:
    """:func:`minimise` by the method of multipliers.

    Its smooth convex problems are solved by semismooth Newton steps with an exact line search (the derivative
    along a line is monotone), which end after finitely many. It has converged when the duality gap is at
    most 10 times ``tolerance`` of the energy and no constraint is violated by more than ``tolerance`` of the
    largest displacement; stationarity holds to rounding.
    """
    A, d, low, high = rows
    square, diagonal, bounded = A.multiply(A).tocsr(), K.diagonal(), np.isfinite(high)
    stiffness = (square @ diagonal) / (square @ np.ones(f.size)) ** 2
    penalty, mu, size = PENALTY * stiffness, np.clip(mu, low, high), 1e-300
    for _ in range(40):
        for steps in range(60):  # noqa: B007
            before = u
            u, decrease = newton_step(K, f, rows, mu, penalty, u)
            size = max(size, abs(f @ before), abs((K @ before - f) @ before), decrease * 1e-6)
            if decrease <= 1e-15 * size:
                break
        z = A @ u + d
        mu = np.clip(mu - penalty * z, low, high)
        gap = mu @ z + np.where(bounded, high, 0.0) @ np.abs(z)
        violated = np.max(-z[~bounded], initial=0.0) > tolerance * np.max(np.abs(u), initial=1e-300)
        if abs(gap) <= 10 * tolerance * size and not violated:
            return u, mu, True
        if steps < 4:  # the forces are nearly right: a stiffer penalty brings them closer
            penalty = np.minimum(10 * penalty, HARDEST * stiffness)
    return u, mu, False


def newton_step(
    K: Any, f: np.ndarray, rows: Rows, mu: np.ndarray, penalty: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, float]:
    """The lowest point along a semismooth Newton step, and by how much the linear model falls."""
    A, d, low, high = rows
    z, rest = A @ u + d, K @ u - f
    trial = mu - penalty * z
    on, r = (trial > low) & (trial < high), rest - A.T @ np.clip(trial, low, high)
    small = 1e-9 * K.diagonal()  # for a body that only contact holds
    step = -solved(K, A[on].T @ diags(penalty[on]) @ A[on], small, r)
    change, curvature = A @ step, step @ (K @ step)

    def slope(t: float) -> float:
        return float(step @ rest + t * curvature - change @ np.clip(trial - t * penalty * change, low, high))

    t = 1.0 if slope(1.0) <= 0 else brentq(slope, 0.0, 1.0, xtol=1e-16) if slope(0.0) < 0 else 0.0
    return u + t * step, abs(step @ r)


def solved(K: Any, more: csr_matrix, small: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Solve ``(K + more + small) s = r``."""
    if not isinstance(K, np.ndarray):
        return factorised(K + more + diags(small)).solve(r)
    H = K + more.toarray() + np.diag(small)
    try:
        return solve(H, r, assume_a="pos")
    except LinAlgError:
        return lstsq(H, r)[0]
