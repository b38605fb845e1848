"""Problems without contact whose solutions are known, smooth and singular."""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, ExactSolution, Laplace, Motion, PlaneStrain, Traction

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
    u = _bent(x, y)
    slope = ca.horzcat(ca.jacobian(u, x), ca.jacobian(u, y))
    strain = (slope + slope.T) / 2
    stress = LAMBDA * ca.trace(strain) * ca.SX.eye(2) + 2 * MU * strain
    body = ca.Function("f", [x, y], [-(ca.jacobian(stress[:, 0], x) + ca.jacobian(stress[:, 1], y))])
    sides = {"right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
    loads = {name: ca.Function("t", [x, y], [stress @ ca.DM(n)]) for name, n in sides.items()}

    def parts(function: ca.Function) -> tuple[Any, Any]:
        return partial(_entry, function, 0), partial(_entry, function, 1)

    return ContactProblem(
        rectangle(n, n),
        PlaneStrain(LAMBDA, MU, parts(body)),
        (Dirichlet("left", (lambda x, y: _bent(x, y)[0], lambda x, y: _bent(x, y)[1])),),
        tractions=tuple(Traction(name, parts(load)) for name, load in loads.items()),
        motion=Motion(None),
        quadrature=10,
        exact=ExactSolution(_bent, float("nan")),
        order=order,
    )


def _bent(x: Any, y: Any) -> Any:
    return ca.vertcat(ca.sin(2 * x) * ca.cos(y), x * x * ca.exp(y))


def _entry(function: ca.Function, i: int, x: Any, y: Any) -> Any:
    return function(x, y)[i]


def corner_mode(x: Any, y: Any) -> Any:
    """``r^(2/3) sin(2 phi / 3)`` about the re-entrant corner of the L-shape, zero on its two edges."""
    phi = ca.atan2(-x - y, y - x) + 3 * ca.pi / 4
    return (x * x + y * y + 1e-30) ** (1 / 3) * ca.sin(2 * phi / 3)


def l_shape(n: int, order: int, grading: float = 1.0) -> ContactProblem:
    """(-1, 1)^2 without its lower right quarter on squares of 1/n, its mode given on the boundary.

    A grading g moves the vertices from x to ``x |x|^(g - 1)``, |x| the larger coordinate: squares about the
    corner stay squares.
    """
    i, j = np.meshgrid(np.arange(-n, n), np.arange(-n, n), indexing="ij")
    i, j = (index[(i < 0) | (j >= 0)] for index in (i, j))
    corners = np.array([(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)])  # (4, 2, squares)
    points, number = np.unique(corners.transpose(0, 2, 1).reshape(-1, 2), axis=0, return_inverse=True)
    a, b, c, d = number.reshape(4, -1)
    X = points.T / n
    X = X * np.max(np.abs(X), axis=0) ** (grading - 1)
    mesh = MeshTri(X, np.hstack([[a, b, c], [a, c, d]])).with_boundaries(
        {
            "notch": lambda x: (x[0] > -1e-12) & (x[1] < 1e-12) & (np.abs(x).min(axis=0) < 1e-12),
            "outer": lambda x: np.max(np.abs(x), axis=0) > 1 - 1e-9,
        }
    )
    given = ("notch", Dirichlet("outer", (corner_mode,)))
    exact = ExactSolution(corner_mode, float("nan"))
    return ContactProblem(mesh, Laplace(), given, motion=Motion(None), exact=exact, order=order)
