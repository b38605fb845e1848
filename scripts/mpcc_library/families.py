"""Families of generated MPCCs, seeded and of any size. None of them chose a default option."""

from collections.abc import Callable

import casadi as ca
import numpy as np

from mpcc_library.builder import Builder
from mpcc_library.equilibria import cournot, markets, tolls
from mpcc_library.switched import bouncing, hysteresis
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


FAMILIES: dict[str, tuple[Callable[[int, int], Problem], tuple[int, ...]]] = {
    "lpec": (lpec, (4, 10, 30, 100)),
    "bouncing": (bouncing, (10, 30, 100, 300)),
    "hysteresis": (hysteresis, (10, 30, 100, 300)),
    "cournot": (cournot, (4, 10, 30, 100)),
    "markets": (markets, (2, 5, 15, 60)),
    "tolls": (tolls, (3, 6, 12, 40)),
}
"""Makers, of a size and a seed, and sizes from tiny to a few thousand unknowns."""
