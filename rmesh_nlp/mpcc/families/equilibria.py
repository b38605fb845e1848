"""Equilibria of mechanics and economics below an optimiser."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc.families.instance import Builder, Instance


def obstacle_control(size: int, seed: int) -> Instance:
    """Distributed control of a membrane over an obstacle on a ``size`` x ``size`` grid.

    ``min 1/2 |y - y_d|^2 + alpha / 2 |u|^2``, ``-Laplace y = u + force``, ``0 <= force _|_ y - psi >= 0``. M.
    Hintermueller and I. Kopacka, SIAM J. Optim. 20 (2009) 868-902.
    """
    random = np.random.default_rng([9, size, seed])
    n, h = size * size, 1.0 / (size + 1)
    X, Y = np.meshgrid(*[np.linspace(h, 1 - h, size)] * 2, indexing="ij")
    a, c = random.uniform(1, 3, 2)
    wanted = (np.sin(a * np.pi * X) * np.sin(c * np.pi * Y) + random.uniform(-0.3, 0.3)).ravel()
    psi = -random.uniform(0.0, 0.3) * np.ones(n)
    b = Builder()
    y, u = b.unknown(n), b.unknown(n, -50.0, 50.0, 0.0)
    force = b.unknown(n, 0.0, np.inf, 0.0)
    grid = ca.reshape(y, size, size)
    padded = ca.SX(size + 2, size + 2)
    padded[1:-1, 1:-1] = grid
    laplace = (4 * grid - padded[:-2, 1:-1] - padded[2:, 1:-1] - padded[1:-1, :-2] - padded[1:-1, 2:]) / h**2
    b.constrain(ca.vec(laplace) - u - force)
    b.pair(force, y - psi)
    f = 0.5 * h**2 * ca.sumsqr(y - wanted) + 0.5 * 10.0 ** random.uniform(-4, -2) * h**2 * ca.sumsqr(u)
    return b.done(f"obstacle-control-{size}-{seed}", f)


def cournot(size: int, seed: int) -> Instance:
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


def tolls(size: int, seed: int) -> Instance:
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
