"""Families of applications: control with contacts, time-freezing, friction, gas networks, learning.

Markets from published equations are `cournot` (Outrata, Kocvara and Zowe 1998) and `prices` (Hobbs, Metzler
and Pang 2000) in `families.py`; structures are `membrane` and `membrane-pressure` in `large.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from mpcc_library.families import INF, Builder
from rmesh_nlp.mpcc import Problem


def push_box(size: int, seed: int) -> Problem:
    """A pusher moves a box over a floor with dry friction in ``size`` steps; contact times are not given."""
    random = np.random.default_rng([60, size, seed])
    h, friction, goal = 1.5 / size, random.uniform(1, 4), random.uniform(0.3, 1.0)
    b = Builder()
    x, v, pusher, speed, f = ca.SX(0), ca.SX(0), ca.SX(-0.3), ca.SX(0), ca.SX(0)
    for _ in range(size):
        force = b.unknown(1, -20.0, 20.0)
        x_next, v_next, pusher_next, speed_next = (b.unknown() for _ in range(4))
        contact, forth, back, slip = (b.unknown(lower=0.0) for _ in range(4))
        b.constrain(speed_next - speed - h * force + contact)
        b.constrain(v_next - v - contact - forth + back)
        b.constrain(ca.vertcat(x_next - x - h * v_next, pusher_next - pusher - h * speed_next))
        b.pair(ca.vertcat(contact, slip), ca.vertcat(x_next - pusher_next - 0.2, h * friction - forth - back))
        b.pair(ca.vertcat(forth, back), ca.vertcat(slip + v_next, slip - v_next))
        f += h * (1e-2 * force**2 + (x_next - goal) ** 2)
        x, v, pusher, speed = x_next, v_next, pusher_next, speed_next
    return b.done(f"push-box-{size}-{seed}", f + 10 * (x - goal) ** 2 + v**2 + 0.1 * speed**2)


def stick_slip(size: int, seed: int) -> Problem:
    """Two blocks with dry friction, joined by a spring; the first is driven, the second has a goal."""
    random = np.random.default_rng([61, size, seed])
    h, stiffness, bound = 1.5 / size, random.uniform(4, 12), random.uniform(0.5, 2)
    b = Builder()
    x, v, f = ca.SX.zeros(2), ca.SX.zeros(2), ca.SX(0)
    for _ in range(size):
        drive, x_next, v_next, force = b.unknown(1, -15.0, 15.0), b.unknown(2), b.unknown(2), b.unknown(2)
        forth, back = b.unknown(2, 0.0), b.unknown(2, 0.0)
        spring = stiffness * (x_next[1] - x_next[0])
        b.constrain(ca.vertcat(x_next - x - h * v_next, v_next - forth + back))
        b.constrain(v_next - v - h * (ca.vertcat(drive + spring, -spring) + force))
        b.pair(ca.vertcat(forth, back), ca.vertcat(bound + force, bound - force))
        f += h * (0.01 * drive**2 + (x_next[1] - 1) ** 2)
        x, v = x_next, v_next
    return b.done(f"stick-slip-{size}-{seed}", f + 10 * (x[1] - 1) ** 2 + ca.sumsqr(v))


def time_freezing(size: int, seed: int) -> Problem:
    """A ball with a thruster is to be at a height after a bounce, in ``size`` steps of pseudo time.

    Above the table the clock runs. Below it the clock stands still while a damped spring turns the velocity,
    so in clock time the velocity jumps. Which of the two holds is Stewart's complementarity,
    ``0 <= theta_i _|_ g_i - mu >= 0`` with ``g = (-q, q)`` and ``theta_1 + theta_2 = 1``. Steps are those of
    the implicit Euler method.
    A. Nurkanovic, T. Sartor, S. Albrecht, M. Diehl, A time-freezing approach for numerical optimal control of
    nonsmooth differential equations with state jumps, IEEE Control Syst. Lett. 5 (2021) 439-444.
    """
    random = np.random.default_rng([64, size, seed])
    h, goal, restitution = 2.0 / size, random.uniform(0.2, 0.8), random.uniform(0.6, 0.9)
    stiffness = 20.0
    damping = 2 * abs(np.log(restitution)) * np.sqrt(stiffness / (np.pi**2 + np.log(restitution) ** 2))
    b = Builder()
    q, v, clock, f = ca.SX(1.0), ca.SX(0.0), ca.SX(0.0), ca.SX(0)
    for _ in range(size):
        thrust, q_next, v_next, mu = b.unknown(1, -8.0, 8.0), b.unknown(start=0.5), b.unknown(), b.unknown()
        clock_next, theta = b.unknown(), b.unknown(2, 0.0, INF, 0.5)
        flight, table = thrust - 9.81, -stiffness * q_next - damping * v_next
        b.constrain(ca.vertcat(q_next - q - h * v_next, ca.sum1(theta) - 1))
        b.constrain(v_next - v - h * (theta[0] * flight + theta[1] * table))
        b.constrain(clock_next - clock - h * theta[0])
        b.pair(theta, ca.vertcat(-q_next - mu, q_next - mu))
        f += h * 1e-2 * thrust**2
        q, v, clock = q_next, v_next, clock_next
    return b.done(f"time-freezing-{size}-{seed}", f + 10 * (q - goal) ** 2 + v**2)


def gas(size: int, seed: int) -> Problem:
    """A gas network of ``size`` nodes on a ring with chords; compressors and supplies at least cost.

    Weymouth's equation ``pi_i - pi_j = resistance q |q|`` of squared pressures, with ``q = forth - back`` and
    ``0 <= forth _|_ back >= 0``; a compressor raises pressure only along its flow, which it does not allow to
    turn. D. De Wolf and Y. Smeers, The gas transmission problem solved by an extension of the simplex
    algorithm, Manag. Sci. 46 (2000) 1454-1465; B. Baumrucker and L. Biegler, MPEC strategies for cost
    optimization of pipeline operations, Comput. Chem. Eng. 34 (2010) 900-913.
    """
    random = np.random.default_rng([62, size, seed])
    pipes = [(i, (i + 1) % size) for i in range(size)]
    pipes += [tuple(random.choice(size, 2, replace=False)) for _ in range(size // 3)]
    demand = random.uniform(0.2, 1.5, size) * (random.uniform(size=size) < 0.7)
    sources = random.choice(size, max(2, size // 4), replace=False)
    capacity = np.zeros(size)
    capacity[sources] = 1.6 * demand.sum() / sources.size
    cost, resistance = random.uniform(1, 3, size), random.uniform(0.2, 2, len(pipes))
    b = Builder()
    supply, squared = b.unknown(size, 0.0, capacity, 0.5 * capacity), b.unknown(size, 4.0, 64.0, 30.0)
    forth, back = b.unknown(len(pipes), 0.0, INF, 1.0), b.unknown(len(pipes), 0.0, INF, 0.1)
    lift = b.unknown(len(pipes), 0.0, 20.0 * (random.uniform(size=len(pipes)) < 0.4))
    balance, drop = supply - demand, ca.SX.zeros(len(pipes))
    for k, (i, j) in enumerate(pipes):
        balance[i] -= forth[k] - back[k]
        balance[j] += forth[k] - back[k]
        drop[k] = squared[i] + lift[k] - squared[j] - resistance[k] * (forth[k] ** 2 - back[k] ** 2)
    b.constrain(balance)
    b.constrain(drop)
    b.pair(ca.vertcat(forth, lift), ca.vertcat(back, back))
    return b.done(
        f"gas-{size}-{seed}", ca.dot(cost, supply) + 0.05 * ca.dot(lift, forth) + 0.01 * ca.sum1(lift)
    )


def margins(size: int, seed: int) -> Problem:
    """Choose the bound of a support vector machine's multipliers by the error on ``size`` other points.

    K. Bennett, G. Kunapuli, J. Hu, J.-S. Pang, Bilevel optimization and machine learning, Comput. Intell.:
    Research Frontiers (2008) 25-47: ``0 <= a _|_ 1 - a - hinge >= 0`` and so on by the KKT conditions.
    """
    random = np.random.default_rng([63, size, seed])
    points, normal = random.normal(size=(2, size, 2)), random.normal(size=2)
    labels = np.sign(points @ normal + random.normal(0, 0.8, (2, size)))
    rows = labels[..., None] * points
    b = Builder()
    bound, w = b.unknown(1, 1e-2, 10.0, 1.0), b.unknown(2)
    weight, excess = b.unknown(size, 0.0, INF, 0.5), b.unknown(size, 0.0, INF, 0.5)
    miss, least = b.unknown(size, 0.0, INF, 0.5), b.unknown(size, 0.0, INF, 0.5)
    b.constrain(w - ca.mtimes(rows[0].T, weight))
    b.pair(ca.vertcat(weight, excess), ca.vertcat(ca.mtimes(rows[0], w) - 1 + excess, bound - weight))
    b.pair(ca.vertcat(miss, least), ca.vertcat(ca.mtimes(rows[1], w) + least, 1 - miss))
    return b.done(f"margins-{size}-{seed}", ca.sum1(miss) / size)


APPLICATIONS: dict[str, tuple[Callable[[int, int], Problem], tuple[int, ...]]] = {
    "push-box": (push_box, (10, 30, 100)),
    "stick-slip": (stick_slip, (10, 30, 100)),
    "time-freezing": (time_freezing, (10, 30, 100)),
    "gas": (gas, (6, 20, 60)),
    "margins": (margins, (8, 30, 100)),
}
"""Makers, of a size and a seed, and sizes."""
