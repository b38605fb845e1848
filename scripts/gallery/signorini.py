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
from common import Case, command_line, energy_norm, run

from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, ExactSolution, Laplace, Motion, Obstacle, Relative


def exact(x: Any, y: Any) -> Any:
    """The exact solution; a tiny radius keeps its derivatives finite at the origin."""
    r = ca.sqrt(x * x + y * y + 1e-30)
    return r * ca.sqrt(r) * ca.cos(1.5 * ca.atan2(y, x))


def problem(n: int) -> ContactProblem:
    """``2 n`` times ``n`` cells; an odd ``n`` puts no node at the origin."""
    return ContactProblem(
        mesh=rectangle(2 * n + 1, n, x=(-1, 1)),
        law=Laplace(),
        dirichlet=tuple(Dirichlet(side, (exact,)) for side in ("left", "right", "top")),
        obstacle=Obstacle("bottom", (1.0,)),
        motion=Motion(Relative(0.45)),
        exact=ExactSolution(exact, float("nan")),
        name="Signorini",
    )


def main(n: int = 10) -> Case:
    """Signorini problem with a known singularity."""
    return run(problem(n), energy_norm)


if __name__ == "__main__":
    command_line(main, 10)
