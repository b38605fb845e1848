"""Optimal control of nonsmooth systems, discretised by the implicit Euler rule."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mpcc_library.builder import Builder
from rmesh_nlp.mpcc.reading import Problem


def bouncing(size: int, seed: int) -> Problem:
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


def hysteresis(size: int, seed: int) -> Problem:
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
