"""A contact problem with friction whose exact solution sticks on one part and slides on the other."""

from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np

import rmesh_nlp as rm

LAMBDA, MU = 40.0, 30.0
BOUND = 3.0
"""The friction bound g."""

TURN = 0.5
"""The lower edge sticks for x < TURN and slides for x > TURN, a line of the grids: so rules are exact."""

SLIDE, PRESS = 0.2, -0.1
"""Sizes of the slip and of the (downward) strain."""


def displacement(x: Any, y: Any, power: int = 2) -> Any:
    """The exact solution.

    On y = 0 it slips by ``SLIDE (x - TURN)_+^3``, against a shear stress that rises to the bound at TURN and
    is at the bound from there on; the lower edge stays down, pressed on by the strain in y. At TURN the body
    force has a jump, with the power 3 a kink.
    """
    past, before = ca.fmax(x - TURN, 0), ca.fmax(TURN - x, 0) / TURN
    shear = BOUND * (1 - before**power)
    return ca.vertcat(SLIDE * past * past * past + y * shear / MU, PRESS * y)


def elastic(u: ca.SX, x: ca.SX, y: ca.SX, lame_lambda: float, lame_mu: float) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Strain and stress of a displacement, and the body force that it needs."""
    slope = ca.horzcat(ca.jacobian(u, x), ca.jacobian(u, y))
    strain = (slope + slope.T) / 2
    stress = lame_lambda * ca.trace(strain) * ca.SX.eye(2) + 2 * lame_mu * strain
    return strain, stress, -(ca.jacobian(stress[:, 0], x) + ca.jacobian(stress[:, 1], y))


def entries(function: ca.Function, *which: int) -> tuple[Any, ...]:
    """Entries of a matrix by their numbers, column by column, each as a function of position."""
    return tuple(partial(_entry, function, i) for i in which)


@cache
def _functions(power: int) -> tuple[ca.Function, ca.Function, ca.Function]:
    """The body force that the solution needs, its stress, and the density of its energy without friction."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    u = displacement(x, y, power)
    strain, stress, force = elastic(u, x, y, LAMBDA, MU)
    density = ca.dot(stress, strain) / 2 - ca.dot(force, u)
    results = {"force": force, "stress": stress, "density": density}
    one, two, three = (ca.Function(name, [x, y], [value]) for name, value in results.items())
    return one, two, three


@cache
def exact_energy(power: int = 2) -> float:
    """J(u) by Gauss rules on either side of TURN, where the solution is a polynomial."""
    _, stress, density = _functions(power)
    points, weights = np.polynomial.legendre.leggauss(12)
    y, wy = (points + 1) / 2, weights / 2
    total = BOUND * SLIDE * (1 - TURN) ** 4 / 4
    for low, high in ((0.0, TURN), (TURN, 1.0)):
        for x, wx in zip(low + (high - low) * y, (high - low) * wy, strict=True):
            total += wx * sum(w * float(density(x, at)) for at, w in zip(y, wy, strict=True))
            total -= wx * float(ca.dot(stress(x, 1.0)[:, 1], displacement(x, 1.0, power)))  # the top
    for at, w in zip(y, wy, strict=True):  # the right
        total -= w * float(ca.dot(stress(1.0, at)[:, 0], displacement(1.0, at, power)))
    return total


def sliding_block(n: int, power: int = 2) -> rm.ContactProblem:
    """The unit square on ``n`` x ``n`` squares, held on the left, loaded elsewhere.

    On the left the solution is linear, so that the discrete one can meet it.
    """
    force, stress, _ = _functions(power)
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(n, n),
        law=rm.PlaneStrain(LAMBDA, MU, entries(force, 0, 1)),
        dirichlet=(rm.Dirichlet("left", (0.0, lambda x, y: PRESS * y)),),
        tractions=(rm.Traction("top", entries(stress, 2, 3)), rm.Traction("right", entries(stress, 0, 1))),
        obstacle=rm.Obstacle("bottom", friction=BOUND),
        motion=rm.Motion((0.02, 0.02)),
        quadrature=6,
        exact=rm.ExactSolution(partial(displacement, power=power), exact_energy(power)),
        name="sliding block",
    )


def _entry(function: ca.Function, i: int, x: Any, y: Any) -> Any:
    return ca.vec(function(x, y))[i]
