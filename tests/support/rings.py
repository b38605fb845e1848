"""A quarter of a ring with a solution in closed form."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain

LAW = PlaneStrain(1.2, 0.8)
OVERLAP = 0.01


def ring_on_a_shaft(n: int, order: int) -> tuple[ContactProblem, float]:
    """1 < r < 2 on a rigid shaft that is too thick for it, on n x 2n squares, and its energy."""
    flat = rectangle(n, 2 * n)
    r, angle = 1 + flat.p[0], np.pi / 2 * flat.p[1]
    mesh = type(flat)(np.stack([r * np.cos(angle), r * np.sin(angle)]), flat.t)
    sides = {
        "inner": lambda p: np.hypot(*p) < 1 + 0.2 / n,
        "outer": lambda p: np.hypot(*p) > 2 - 0.2 / n,
        "bottom": lambda p: p[1] < 1e-9,
        "left": lambda p: p[0] < 1e-9,
    }
    problem = ContactProblem(
        named(mesh, sides),
        LAW,
        (Dirichlet("bottom", (None, 0.0)), Dirichlet("left", (0.0, None))),
        Obstacle.circle("inner", (0.0, 0.0), 1 + OVERLAP),
        Motion(None, curves={"inner": Circle((0.0, 0.0), 1.0), "outer": Circle((0.0, 0.0), 2.0)}),
        order=order,
    )
    # u_r = A r + B / r, with no stress at r = 2
    lam, mu = LAW.lame_lambda, LAW.lame_mu
    A = OVERLAP / (1 + 4 * (lam + mu) / mu)
    pressure = 2 * mu * (OVERLAP - A) - 2 * (lam + mu) * A
    return problem, np.pi / 4 * pressure * OVERLAP
