"""A membrane on a flat obstacle: the free boundary is the unit circle.

-Laplace(u) = -2, u >= 0 in (-1.5, 1.5)^2, u given on the boundary. The solution is radial,
u = r^2 / 2 - ln r - 1/2 for r >= 1 and 0 inside (Nochetto, Siebert, Veeser 2003).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

import rmesh_nlp as rm


def exact(x: Any, y: Any) -> Any:
    """The exact solution."""
    r2 = ca.fmax(x * x + y * y, 1.0)
    return r2 / 2 - ca.log(r2) / 2 - 0.5


def problem(n: int) -> rm.ContactProblem:
    """``n`` times ``n`` cells."""
    sides = ("left", "right", "bottom", "top")
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(n, n, x=(-1.5, 1.5), y=(-1.5, 1.5)),
        law=rm.Laplace(source=-2.0),
        dirichlet=tuple(rm.Dirichlet(side, (exact,)) for side in sides),
        obstacle=rm.Obstacle.interior(0.0),
        motion=rm.Motion(rm.Relative(0.3)),
        exact=rm.ExactSolution(exact, float("nan")),
        name="free boundary",
    )
