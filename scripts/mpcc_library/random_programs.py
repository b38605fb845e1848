"""Random programs with linear pairs: QPECs, LPECs, bilevel programs over quadratic lower levels."""

from __future__ import annotations

import casadi as ca
import numpy as np
from mpcc_library.instance import Builder, Instance

from rmesh_nlp.evaluation import Array


def _positive(random: np.random.Generator, n: int, least: float) -> Array:
    """A random positive definite matrix with eigenvalues from ``least`` to about 3."""
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    return np.asarray(Q @ np.diag(random.uniform(least, 3.0, n)) @ Q.T)


def qpec(size: int, seed: int) -> Instance:
    """``min 1/2 z^T P z + c^T z``, ``A x <= b``, ``0 <= y _|_ N x + M y + q >= 0``, M positive definite.

    ``size`` pairs. P is indefinite on the followers' part; a box keeps the problem bounded. Some entries
    of the solution of the pairs at the start are biactive on purpose. Like the QPECs of H. Jiang and D.
    Ralph, QPECgen, Comput. Optim. Appl. 13 (1999) 25-59, but without their planted solution.
    """
    random = np.random.default_rng([1, size, seed])
    n = max(2, size // 2)
    b = Builder()
    x = b.unknown(n, -5.0, 5.0, random.uniform(-1, 1, n))
    y = b.unknown(size, 0.0, 20.0, random.uniform(0, 1, size))
    M = _positive(random, size, 0.5) + 0.5 * np.triu(random.normal(size=(size, size)), 1) / np.sqrt(size)
    N = random.normal(size=(size, n))
    reference, side = random.uniform(-2, 2, n), random.integers(0, 3, size)
    y_ref = np.where(side == 0, random.uniform(0.2, 2, size), 0.0)
    q = np.where(side == 1, random.uniform(0.2, 2, size), 0.0) - N @ reference - M @ y_ref
    A = random.normal(size=(n // 2 + 1, n))
    b.constrain(A @ x, -np.inf, A @ reference + random.uniform(0, 1, A.shape[0]))
    b.pair(y, N @ x + M @ y + q)
    z = ca.vertcat(x, y)
    P = _positive(random, n + size, 0.1) - 0.3 * np.diag(random.uniform(size=n + size) < 0.2)
    return b.done(f"qpec-{size}-{seed}", 0.5 * ca.bilin(P, z, z) + ca.dot(random.normal(size=n + size), z))


def lpec(size: int, seed: int) -> Instance:
    """A linear objective over ``0 <= y _|_ N x + M y + q >= 0`` and a box, ``size`` pairs.

    M is positive semidefinite of half rank, so that the followers' answer need not be unique.
    """
    random = np.random.default_rng([2, size, seed])
    n = max(2, size // 2)
    b = Builder()
    x = b.unknown(n, -3.0, 3.0, 0.0)
    y = b.unknown(size, 0.0, 10.0, 0.0)
    half = random.normal(size=(size, max(1, size // 2)))
    skew = random.normal(size=(size, size))
    M = (half @ half.T + 0.3 * (skew - skew.T)) / size
    N = random.normal(size=(size, n))
    reference, side = random.uniform(-2, 2, n), random.integers(0, 3, size)
    y_ref = np.where(side == 0, random.uniform(0.2, 2, size), 0.0)
    q = np.where(side == 1, random.uniform(0.2, 2, size), 0.0) - N @ reference - M @ y_ref
    b.pair(y, N @ x + M @ y + q)
    cost = ca.dot(random.normal(size=n), x) + ca.dot(random.uniform(-0.5, 1.5, size), y)
    return b.done(f"lpec-{size}-{seed}", cost)


def bilevel(size: int, seed: int) -> Instance:
    """A leader over a quadratic lower level with ``size`` inequality constraints, by its KKT conditions.

    ``min_y 1/2 y^T Q y + (C x + d)^T y, A y <= b + B x``; the leader tracks a target in y that need not be
    attainable, with a cosine that makes several minima.
    """
    random = np.random.default_rng([3, size, seed])
    n, m = max(2, size // 3), max(2, size // 2)
    b = Builder()
    x = b.unknown(n, -2.0, 2.0, random.uniform(-1, 1, n))
    y = b.unknown(m)
    lam = b.unknown(size, 0.0, np.inf, 0.5)
    Q, C, A = _positive(random, m, 0.3), random.normal(size=(m, n)), random.normal(size=(size, m))
    B, d = 0.5 * random.normal(size=(size, n)), random.normal(size=m)
    slack = A @ random.normal(size=m) * 0.2 + random.uniform(0.1, 1.5, size)
    b.constrain(Q @ y + C @ x + d + A.T @ lam)
    b.pair(lam, slack + B @ x - A @ y)
    target = random.normal(size=m)
    f = ca.sumsqr(y - target) + 0.1 * ca.sumsqr(x) + 0.3 * ca.sum1(ca.cos(3 * x))
    return b.done(f"bilevel-{size}-{seed}", f)
