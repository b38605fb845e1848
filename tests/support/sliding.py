"""A contact problem with friction whose exact solution sticks on one part and slides on the other."""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    ExactSolution,
    Motion,
    Obstacle,
    PlaneStrain,
    Traction,
)

LAMBDA, MU = 40.0, 30.0
BOUND = 3.0
"""The friction bound g."""

TURN = 0.5
"""The lower edge sticks for x < TURN and slides for x > TURN, a line of the grids: so rules are exact."""

SLIDE, PRESS = 0.2, -0.1
"""Sizes of the slip and of the (downward) strain."""


def displacement(x: Any, y: Any) -> Any:
    """The exact solution.

    On y = 0 it slips by ``SLIDE (x - TURN)_+^3``, against a shear stress that rises to the bound at TURN and
    is at the bound from there on; the lower edge stays down, pressed on by the strain in y.
    """
    past, before = ca.fmax(x - TURN, 0), ca.fmax(TURN - x, 0) / TURN
    shear = BOUND * (1 - before * before)
    return ca.vertcat(SLIDE * past * past * past + y * shear / MU, PRESS * y)


def _stress(x: Any, y: Any) -> Any:
    u = displacement(x, y)
    slope = ca.horzcat(ca.jacobian(u, x), ca.jacobian(u, y))
    strain = (slope + slope.T) / 2
    return LAMBDA * ca.trace(strain) * ca.SX.eye(2) + 2 * MU * strain, strain


def _functions() -> tuple[ca.Function, ca.Function, ca.Function]:
    """The body force that the solution needs, its stress, and the density of its energy without friction."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    stress, strain = _stress(x, y)
    force = -(ca.jacobian(stress[:, 0], x) + ca.jacobian(stress[:, 1], y))
    density = ca.dot(stress, strain) / 2 - ca.dot(force, displacement(x, y))
    return (
        ca.Function("force", [x, y], [force[0], force[1]]),
        ca.Function("stress", [x, y], [stress[0, 0], stress[0, 1], stress[1, 1]]),
        ca.Function("density", [x, y], [density]),
    )


def exact_energy() -> float:
    """J(u) by Gauss rules on either side of TURN, where the solution is a polynomial."""
    _, stress, density = _functions()
    points, weights = np.polynomial.legendre.leggauss(12)
    total = 0.0
    for low, high in ((0.0, TURN), (TURN, 1.0)):
        x, wx = low + (high - low) * (points + 1) / 2, weights * (high - low) / 2
        y, wy = (points + 1) / 2, weights / 2
        total += sum(wx[i] * wy[j] * float(density(x[i], y[j])) for i in range(x.size) for j in range(y.size))
        for s, w in zip(x, wx, strict=True):  # the top
            total -= w * float(ca.dot(ca.vertcat(*stress(s, 1.0)[1:]), displacement(s, 1.0)))
    for s, w in zip((points + 1) / 2, weights / 2, strict=True):  # the right
        total -= w * float(ca.dot(ca.vertcat(*stress(1.0, s)[:2]), displacement(1.0, s)))
    return total + BOUND * SLIDE * (1 - TURN) ** 4 / 4


def sliding_block(n: int) -> ContactProblem:
    """The unit square on ``n`` x ``n`` squares, held on the left, loaded elsewhere.

    On the left the solution is linear, so that the discrete one can meet it.
    """
    force, stress, _ = _functions()
    return ContactProblem(
        mesh=rectangle(n, n),
        law=PlaneStrain(LAMBDA, MU, tuple(partial(_part, force, i) for i in range(2))),
        dirichlet=(Dirichlet("left", (0.0, lambda x, y: PRESS * y)),),
        tractions=(
            Traction("top", tuple(partial(_part, stress, i) for i in (1, 2))),
            Traction("right", tuple(partial(_part, stress, i) for i in (0, 1))),
        ),
        obstacle=Obstacle("bottom", (0.0, 1.0), 0.0, BOUND),
        motion=Motion((0.02, 0.02)),
        quadrature=6,
        exact=ExactSolution(displacement, exact_energy()),
        name="sliding block",
    )


def _part(force: ca.Function, i: int, x: Any, y: Any) -> Any:
    return force(x, y)[i]
