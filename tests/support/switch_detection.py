"""An optimal control problem whose branches have more equations than free unknowns."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mpcc_library.families import Builder
from rmesh_nlp.mpcc import Problem


def switch_detection(size: int, seed: int) -> Problem:
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
