"""Optimal control of nonsmooth systems, discretised by the implicit Euler rule.

Piecewise smooth systems are written in Stewart's form: ``x' = sum theta_i f_i(x, u)`` with
``theta_i >= 0 _|_ g_i(x) - mu >= 0``, ``sum theta_i = 1``. D. E. Stewart, A high accuracy method for solving
ODEs with discontinuous right-hand side, Numer. Math. 58 (1990) 299-328.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from mpcc_library.instance import Builder, Instance


def bouncing(size: int, seed: int) -> Instance:
    """A point mass above a table, thrust limited, perfectly inelastic impacts (Moreau's time stepping)."""
    random = np.random.default_rng([5, size, seed])
    h, gravity = 2.0 / size, 9.81
    height, goal = random.uniform(0.5, 1.5), random.uniform(0.0, 1.0)
    b = Builder()
    q, v, f = ca.SX(height), ca.SX(0.0), ca.SX(0)
    for _ in range(size):
        u = b.unknown(1, 0.0, 15.0, 5.0)
        q_next, v_next = b.unknown(1, -np.inf, np.inf, height), b.unknown(1)
        impulse = b.unknown(1, 0.0, np.inf, 0.0)
        b.constrain(v_next - v - h * (u - gravity) - impulse)
        b.constrain(q_next - q - h * v_next)
        b.pair(impulse, q_next)
        f += h * 1e-3 * u**2
        q, v = q_next, v_next
    return b.done(f"bouncing-{size}-{seed}", f + 10 * (q - goal) ** 2 + v**2)


def hysteresis(size: int, seed: int) -> Instance:
    """Play operator: the output follows the input within a distance r; track a wave, ``size`` steps."""
    random = np.random.default_rng([7, size, seed])
    h, r = 2 * np.pi / size, random.uniform(0.1, 0.4)
    phase, scale = random.uniform(0, 6), random.uniform(0.5, 1.5)
    b = Builder()
    u, z, f = ca.SX(0), ca.SX(0), ca.SX(0)
    for k in range(size):
        rate = b.unknown(1, -2.0, 2.0, 0.0)
        u_next, z_next = b.unknown(), b.unknown()
        up, down = b.unknown(1, 0.0, np.inf, 0.0), b.unknown(1, 0.0, np.inf, 0.0)
        b.constrain(u_next - u - h * rate)
        b.constrain(z_next - z - up + down)
        b.pair(ca.vertcat(up, down), ca.vertcat(r - u_next + z_next, r + u_next - z_next))
        f += h * ((z_next - scale * np.sin(h * (k + 1) + phase)) ** 2 + 0.01 * rate**2)
        u, z = u_next, z_next
    return b.done(f"hysteresis-{size}-{seed}", f)


def switch_detection(size: int, seed: int) -> Instance:
    """``x' = 1`` or ``3`` on the two sides of ``x = 0``, steps of free length that must end at the switch.

    Finite elements with switch detection: every ``lambda`` of one step is paired with the ``theta`` of its
    neighbours too, so that theta may only change between steps. In a branch there are then more equations
    than free unknowns. A. Nurkanovic, M. Sperl, S. Albrecht, M. Diehl, Finite elements with switch detection
    for direct optimal control of nonsmooth systems, Numer. Math. 156 (2024) 1115-1162. ``size`` intervals of
    two elements each.
    """
    random = np.random.default_rng([8, size, seed])
    length, goal = 2.0 / size, random.uniform(0.5, 1.5)
    start = random.uniform(-1.5, -0.5)
    b = Builder()
    x, f = ca.SX(start), ca.SX(0)
    before = ca.fmax(ca.SX([0.0, 0.0]) + ca.DM([0.0, -2 * start]), 0)
    for _ in range(size):
        u = b.unknown(1, -2.0, 2.0, 0.0)
        steps = []
        for _ in range(2):
            h = b.unknown(1, 0.1 * length, 0.9 * length, 0.5 * length)
            after = b.unknown(1, -np.inf, np.inf, start)
            theta, lam, mu = b.unknown(2, 0.0, 1.0, 0.5), b.unknown(2, 0.0, np.inf, 0.5), b.unknown()
            b.constrain(after - x - h * (u + theta[0] * 1.0 + theta[1] * 3.0))
            b.constrain(ca.sum1(theta) - 1)
            b.constrain(ca.vertcat(after, -after) - mu - lam)
            b.pair(theta, lam + before)
            before, x = lam, after
            steps.append(h)
            f += h * (0.1 * u**2)
        b.constrain(steps[0] + steps[1] - length)
        f += 1e-3 * (steps[0] - steps[1]) ** 2
    return b.done(f"switch-detection-{size}-{seed}", f + (x - goal) ** 2)
