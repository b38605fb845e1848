"""Random linear programs over linear pairs."""

from __future__ import annotations

import casadi as ca
import numpy as np
from mpcc_library.builder import Builder

from rmesh_nlp.mpcc.reading import Problem


def lpec(size: int, seed: int) -> Problem:
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
