"""Problems without contact whose smooth solutions are known."""

from __future__ import annotations

from typing import Any

import casadi as ca

from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, ExactSolution, Laplace, Motion, PlaneStrain, Traction
from support.sliding import elastic, entries

LAMBDA, MU = 3.0, 2.0


def smooth_membrane(n: int, order: int) -> ContactProblem:
    """``sin(2 x) exp(y)`` on the unit square, given on its boundary."""
    value = lambda x, y: ca.sin(2 * x) * ca.exp(y)  # noqa: E731
    return ContactProblem(
        rectangle(n, n),
        Laplace(lambda x, y: 3 * value(x, y)),
        tuple(Dirichlet(side, (value,)) for side in ("left", "right", "bottom", "top")),
        motion=Motion(None),
        quadrature=10,
        exact=ExactSolution(value, float("nan")),
        order=order,
    )


def smooth_block(n: int, order: int) -> ContactProblem:
    """``(sin(2 x) cos(y), x^2 exp(y))`` on the unit square, given on the left and loaded elsewhere."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    _, stress, force = elastic(_bent(x, y), x, y, LAMBDA, MU)
    body = ca.Function("f", [x, y], [force])
    sides = {"right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
    loads = {name: ca.Function("t", [x, y], [stress @ ca.DM(n)]) for name, n in sides.items()}

    return ContactProblem(
        rectangle(n, n),
        PlaneStrain(LAMBDA, MU, entries(body, 0, 1)),
        (Dirichlet("left", (lambda x, y: _bent(x, y)[0], lambda x, y: _bent(x, y)[1])),),
        tractions=tuple(Traction(name, entries(load, 0, 1)) for name, load in loads.items()),
        motion=Motion(None),
        quadrature=10,
        exact=ExactSolution(_bent, float("nan")),
        order=order,
    )


def _bent(x: Any, y: Any) -> Any:
    return ca.vertcat(ca.sin(2 * x) * ca.cos(y), x * x * ca.exp(y))
