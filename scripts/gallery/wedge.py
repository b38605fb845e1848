"""A block above a wedge: a foundation alpha(x_1) with a kink, and Tresca friction.

Block (0, 4) x (0, 1), held on the left, pressed down on the right half of its top. The foundation
rises to its ridge at x_1 = 3 and falls again, a piecewise-linear graph; the node above the ridge is
pinned automatically. The friction bound grows with x_1.
"""

from __future__ import annotations

from common import Case, command_line, energy_above, run

import rmesh_nlp as rm
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    Relative,
    Traction,
)

WEDGE = PiecewiseLinear((0.0, 3.0, 4.0), (-0.12, -0.03, -0.06))


def problem(n: int) -> ContactProblem:
    """``4 n`` times ``n`` cells."""
    mesh = named(
        rectangle(4 * n, n, x=(0, 4), diagonal="falling"), {"load": lambda x: (x[1] == 1) & (x[0] > 2)}
    )
    return ContactProblem(
        mesh=mesh,
        law=PlaneStrain(lame_lambda=1.15e4, lame_mu=0.83e4),
        dirichlet=("left",),
        obstacle=Obstacle.graph("bottom", WEDGE, friction=lambda x, y: 5 * x),
        motion=Motion(Relative(0.3)),
        tractions=(Traction("load", (-20.0, -57.5)),),
        name="wedge",
    )


def main(n: int = 5) -> Case:
    """Block on a wedge with friction."""
    fine, finer = (rm.solve(problem(k * n), "fixed").energy for k in (2, 4))
    return run(problem(n), energy_above(finer - (fine - finer) / 3))


if __name__ == "__main__":
    command_line(main, 5)
