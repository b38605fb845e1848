"""Quarters of the ring 1 < r < 2 with solutions in closed form."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain

INNER, OUTER = Circle((0.0, 0.0), 1.0), Circle((0.0, 0.0), 2.0)
LAW = PlaneStrain(1.2, 0.8)
OVERLAP = 0.01


def _parts(n: int) -> dict:
    """Mesh of n x 2n squares and motion along both circles."""
    flat = rectangle(n, 2 * n)
    r, angle = 1 + flat.p[0], np.pi / 2 * flat.p[1]
    mesh = type(flat)(np.stack([r * np.cos(angle), r * np.sin(angle)]), flat.t)
    sides = {
        "inner": lambda p: np.hypot(*p) < 1 + 0.2 / n,
        "outer": lambda p: np.hypot(*p) > 2 - 0.2 / n,
        "bottom": lambda p: p[1] < 1e-9,
        "left": lambda p: p[0] < 1e-9,
    }
    return {"mesh": named(mesh, sides), "motion": Motion(None, curves={"inner": INNER, "outer": OUTER})}


def conducting_ring(n: int, order: int = 1) -> tuple[ContactProblem, float]:
    """log r, and its energy."""
    given = (Dirichlet("inner", 0.0), Dirichlet("outer", np.log(2)))
    problem = ContactProblem(law=Laplace(0.0), dirichlet=given, **_parts(n), order=order)
    return problem, np.pi / 4 * np.log(2)


def ring_on_a_shaft(n: int, order: int = 1) -> tuple[ContactProblem, float, float]:
    """A ring on a rigid shaft that is too thick for it, its energy and the pressure."""
    symmetry = (Dirichlet("bottom", (None, 0.0)), Dirichlet("left", (0.0, None)))
    shaft = Obstacle.circle("inner", (0.0, 0.0), 1 + OVERLAP)
    problem = ContactProblem(law=LAW, dirichlet=symmetry, obstacle=shaft, **_parts(n), order=order)
    # u_r = A r + B / r, with no stress at r = 2
    lam, mu = LAW.lame_lambda, LAW.lame_mu
    A = OVERLAP / (1 + 4 * (lam + mu) / mu)
    B = OVERLAP - A
    pressure = 2 * mu * B - 2 * (lam + mu) * A
    return problem, np.pi / 4 * pressure * OVERLAP, pressure
