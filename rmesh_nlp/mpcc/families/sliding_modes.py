"""Two switching surfaces, Radau collocation, steps of free length, and a target that must be hit exactly."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc.families.instance import Builder, Instance

_RADAU = np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])


def sliding_modes(size: int, seed: int) -> Instance:
    """``q_k' = -sign(c_k(q)) + v_k``, ``v' = u``: from a random point to the origin with least control.

    The surfaces ``c_1 = q_1 + b q_2^2``, ``c_2 = q_2 + b q_1`` are reached and followed (sliding modes), as
    in the example of A. Nurkanovic, M. Sperl, S. Albrecht, M. Diehl, Numer. Math. 156 (2024) 1115-1162,
    section 6. ``size`` control intervals of two elements with two Radau stages each; cross complementarity
    makes switches fall between elements.
    """
    random = np.random.default_rng([12, size, seed])
    length, bend = 4.0 / size, random.uniform(0.05, 0.2)
    begin = random.uniform(0.5, 2.0, 2) * np.sign(random.uniform(-1, 1, 2))
    b = Builder()
    q, v, f = ca.SX(begin), ca.SX.zeros(2), ca.SX(0)

    def surfaces(at: ca.SX) -> ca.SX:
        return ca.vertcat(at[0] + bend * at[1] ** 2, at[1] + bend * at[0])

    c = surfaces(q)
    before = ca.vertcat(ca.fmax(c, 0), ca.fmax(-c, 0))  # lambda at the start
    for _ in range(size):
        u = b.unknown(2, -10.0, 10.0, 0.0)
        steps = []
        for _ in range(2):
            h = b.unknown(1, 0.1 * length, 0.9 * length, 0.5 * length)
            stages, rates, thetas, lambdas = [], [], [], []
            for _ in range(2):
                stage_q, stage_v = b.unknown(2, start=begin), b.unknown(2, -2.0, 2.0, 0.0)
                plus, minus = b.unknown(2, 0.0, 1.0, 0.5), b.unknown(2, 0.0, 1.0, 0.5)
                above, below = b.unknown(2, 0.0, np.inf, 0.5), b.unknown(2, 0.0, np.inf, 0.5)
                b.constrain(plus + minus - 1)
                b.constrain(surfaces(stage_q) - above + below)
                stages.append((stage_q, stage_v))
                rates.append((stage_v - plus + minus, u))
                # minus is the share of the mode below the surface: it vanishes where the distance above is
                # positive
                thetas.append(ca.vertcat(minus, plus))
                lambdas.append(ca.vertcat(above, below))
            for i in range(2):
                for place, origin in enumerate((q, v)):
                    change = sum(_RADAU[i, j] * rates[j][place] for j in range(2))
                    b.constrain(stages[i][place] - origin - h * change)
            for theta in thetas:
                b.pair(theta, lambdas[0] + lambdas[1] + before)
            before, (q, v) = lambdas[1], stages[1]
            steps.append(h)
            f += h * ca.sumsqr(u)
        b.constrain(steps[0] + steps[1] - length)
    b.constrain(q)
    return b.done(f"sliding-modes-{size}-{seed}", f)
