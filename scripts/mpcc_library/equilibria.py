"""Equilibria below an optimiser: firms, markets, travellers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mpcc_library.builder import Builder
from rmesh_nlp.mpcc.reading import Problem


def cournot(size: int, seed: int) -> Problem:
    """A leader among ``size`` Cournot followers with capacities: mixed complementarity by split multipliers.

    Inverse demand ``p(Q) = (a / Q)^(1 / e)`` and costs ``c q + k q^(1 + s)``, as in J. Outrata, M. Kocvara,
    J. Zowe, Nonsmooth Approach to Optimization Problems with Equilibrium Constraints, 1998, chapter 12.
    """
    random = np.random.default_rng([10, size, seed])
    elasticity, demand = random.uniform(1.0, 1.6), 5000.0
    capacity = random.uniform(10, 60, size)
    cost, power = random.uniform(2, 12, size), random.uniform(0.5, 1.2, size)
    b = Builder()
    leader = b.unknown(1, 0.0, 150.0, 30.0)
    q = b.unknown(size, 0.0, capacity, 0.5 * capacity)
    low, high = b.unknown(size, 0.0, np.inf, 0.0), b.unknown(size, 0.0, np.inf, 0.0)
    total = leader + ca.sum1(q)

    def price(quantity: ca.SX) -> ca.SX:
        return (demand / (quantity + 1e-3)) ** (1 / elasticity)

    slope = -price(total) / (elasticity * (total + 1e-3))
    marginal = cost + 0.1 * (1 + power) * (q + 1e-3) ** power
    b.constrain(marginal - price(total) - slope * q - low + high)
    b.pair(ca.vertcat(low, high), ca.vertcat(q, capacity - q))
    return b.done(f"cournot-{size}-{seed}", random.uniform(3, 10) * leader - leader * price(total))


def tolls(size: int, seed: int) -> Problem:
    """Revenue-optimal tolls on some of ``size`` parallel roads per pair of towns, drivers in equilibrium.

    ``0 <= flow_r _|_ time_r(flow) + toll_r - pi_w >= 0``, flows sum to the demand; times grow with the fourth
    power of a flow (Bureau of Public Roads). Three pairs of towns share a congested road.
    """
    random = np.random.default_rng([11, size, seed])
    b = Builder()
    f, shared = ca.SX(0), ca.SX(0)
    parts = []
    for _ in range(3):
        demand = random.uniform(1, 4)
        flow = b.unknown(size, 0.0, np.inf, demand / size)
        least = b.unknown(1, 0.0, np.inf, 1.0)
        toll = b.unknown(size, 0.0, 5.0 * (random.uniform(size=size) < 0.5), 0.0)
        b.constrain(ca.sum1(flow) - demand)
        shared += flow[0]
        parts.append((flow, least, toll, random.uniform(0.5, 2, size), random.uniform(0.5, 2, size)))
        f -= ca.dot(toll, flow)
    for flow, least, toll, free, room in parts:
        time = free * (1 + 0.15 * (flow / room) ** 4)
        time[0] += 0.1 * shared**2
        b.pair(flow, time + toll - least)
    return b.done(f"tolls-{size}-{seed}", f)


def markets(size: int, seed: int) -> Problem:
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
