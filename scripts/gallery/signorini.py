"""The Signorini singularity r^(3/2) where contact changes to no contact.

Laplace(u) = 0 in (-1, 1) x (0, 1); on the bottom u >= 0, du/dn >= 0, u du/dn = 0; elsewhere u is
given by the exact solution

    u = r^(3/2) cos(3 theta / 2) = Re (x + i y)^(3/2),

which touches for x < 0 and is free for x > 0. Its smoothness H^(5/2) is the best that solutions of
Signorini problems have.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

import rmesh_nlp as rm


def exact(x: Any, y: Any) -> Any:
    """The exact solution; a tiny radius keeps its derivatives finite at the origin."""
    r = ca.sqrt(x * x + y * y + 1e-30)
    return r * ca.sqrt(r) * ca.cos(1.5 * ca.atan2(y, x))


def problem(n: int) -> rm.ContactProblem:
    """``2 n + 1`` times ``n`` cells: no node is at the origin."""
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(2 * n + 1, n, x=(-1, 1)),
        law=rm.Laplace(),
        dirichlet=tuple(rm.Dirichlet(side, (exact,)) for side in ("left", "right", "top")),
        obstacle=rm.Obstacle("bottom", (1.0,)),
        motion=rm.Motion(rm.Relative(0.45)),
        exact=rm.ExactSolution(exact, float("nan")),
        name="Signorini",
    )
