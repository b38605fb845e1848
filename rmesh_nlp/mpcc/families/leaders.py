"""Small programs as hand-written collections have them: whole numbers, starts at zero, many minima."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.families.instance import Builder, Instance


def _whole(random: np.random.Generator, *shape: int) -> Array:
    """Whole numbers from -4 to 4, three in ten of them zero."""
    values = random.integers(-4, 5, shape) * (random.uniform(size=shape) < 0.7)
    return np.asarray(values, dtype=float)


def leader(size: int, seed: int) -> Instance:
    """A leader over a linear lower level (even seeds), or a quadratic one (odd), by its KKT conditions.

    ``min_y e^T y + y^T Q y / 2 + x^T P y, C x + D y <= f, sum y <= s, y >= 0``, ``size`` unknowns below.
    Data are whole numbers, so that rows are dependent and pairs biactive.
    """
    random = np.random.default_rng([31, size, seed])
    n, m, k = max(1, size // 2), size, size + 1
    quadratic = bool(seed % 2)
    b = Builder()
    x, y = b.unknown(n, 0.0, 10.0, 0.0), b.unknown(m, 0.0, np.inf, 0.0)
    lam, nu, mu = (b.unknown(count, 0.0, np.inf, 0.0) for count in (k, 1, m))
    C, D = _whole(random, k, n), _whole(random, k, m)
    x_ref = random.integers(0, 6, n).astype(float)
    y_ref = random.integers(0, 4, m).astype(float)
    slack = C @ x_ref + D @ y_ref + random.integers(0, 5, k) - ca.mtimes(ca.DM(C), x) - ca.mtimes(ca.DM(D), y)
    slope = _whole(random, m) + ca.mtimes(ca.DM(D.T), lam) + nu - mu
    if quadratic:
        slope += random.integers(0, 3, m).astype(float) * y + ca.mtimes(ca.DM(_whole(random, m, n)), x)
    b.constrain(slope)
    b.pair(ca.vertcat(lam, nu, mu), ca.vertcat(slack, y_ref.sum() + 5 - ca.sum1(y), y))
    z = ca.vertcat(x, y)
    f = ca.dot(_whole(random, n + m), z)
    if quadratic:
        f = ca.sumsqr(z - random.integers(-2, 7, n + m).astype(float))
    return b.done(f"leader-{size}-{seed}", f)


def polynomial(size: int, seed: int) -> Instance:
    """A quartic with two valleys in each of the leader's unknowns above ``size`` linear pairs."""
    random = np.random.default_rng([33, size, seed])
    n = max(1, size // 3)
    b = Builder()
    x = b.unknown(n, -4.0, 4.0, random.integers(-1, 2, n))
    y = b.unknown(size, 0.0, np.inf, random.integers(0, 2, size))
    half = random.integers(-2, 3, (size, size)).astype(float)
    M = half @ half.T / 4 + np.eye(size) + np.triu(random.integers(-1, 2, (size, size)), 1)
    b.pair(y, M @ y + random.integers(-2, 3, (size, n)).astype(float) @ x + random.integers(-4, 4, size))
    f = ca.sumsqr(y - random.integers(-1, 4, size)) + ca.sum1(x**4 / 20 - x**2)
    return b.done(f"polynomial-{size}-{seed}", f + ca.dot(_whole(random, n), x))


def path_tolls(size: int, seed: int) -> Instance:
    """Tolls on arcs of a network of ``size`` nodes, travellers on shortest paths, congestion linear.

    No toll is stationary, and the relaxed problems lead there. M. Labbe, P. Marcotte, G. Savard, A bilevel
    model of taxation and its application to optimal highway pricing, Manag. Sci. 44 (1998) 1608-1622.
    """
    random = np.random.default_rng([35, size, seed])
    arcs = [
        (i, j) for i in range(size) for j in range(i + 1, size) if random.uniform() < 4 / size or j == i + 1
    ]
    m = len(arcs)
    A = np.zeros((size, m))
    for a, (i, j) in enumerate(arcs):
        A[i, a], A[j, a] = 1.0, -1.0
    demand = np.zeros(size)
    demand[0], demand[-1] = 1.0, -1.0
    b = Builder()
    flow = b.unknown(m, 0.0, np.inf, 0.0)
    toll = b.unknown(m, 0.0, np.where(random.uniform(size=m) < 0.6, 6.0, 0.0), 0.0)
    potential = b.unknown(size - 1)
    b.constrain(ca.mtimes(ca.DM(A[:-1]), flow) - demand[:-1])
    time = random.integers(1, 9, m).astype(float) + 0.2 * flow
    b.pair(flow, time + toll - ca.mtimes(ca.DM(A[:-1].T), potential))
    return b.done(f"path-tolls-{size}-{seed}", -ca.dot(toll, flow))


def markets(size: int, seed: int) -> Instance:
    """Taxes of a leader on ``size`` markets in which three firms with capacities compete.

    ``0 <= q_ij _|_ c_ij + tax_j + lam_i - price_j + s_j q_ij >= 0``, ``0 <= lam_i _|_ capacity_i - sum_j q_ij
    >= 0``, linear prices ``a_j - s_j sum_i q_ij``. The leader wants revenue, and amounts near whole targets.
    """
    random = np.random.default_rng([36, size, seed])
    firms = 3
    b = Builder()
    tax = b.unknown(size, -5.0, 20.0, 0.0)
    q = b.unknown(firms * size, 0.0, np.inf, 0.0)
    lam = b.unknown(firms, 0.0, np.inf, 0.0)
    amount = ca.reshape(q, firms, size)
    slope = random.integers(1, 4, size).astype(float)
    price = random.integers(15, 40, size).astype(float) - slope * ca.sum1(amount).T
    cost = random.integers(1, 12, (firms, size)).astype(float)
    f = -ca.dot(tax, ca.sum1(amount).T) + ca.sumsqr(ca.sum1(amount).T - random.integers(0, 8, size))
    for j in range(size):
        own = amount[:, j]
        b.pair(own, cost[:, j] + tax[j] + lam - price[j] + slope[j] * own)
    b.pair(lam, random.integers(2 * size, 5 * size, firms) - ca.sum2(amount))
    return b.done(f"markets-{size}-{seed}", f)
