"""A membrane on a flat obstacle: the free boundary is the unit circle.

-Laplace(u) = -2, u >= 0 in (-1.5, 1.5)^2, u given on the boundary. The solution is radial,
u = r^2 / 2 - ln r - 1/2 for r >= 1 and 0 inside (Nochetto, Siebert, Veeser 2003).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from common import Case, command_line, energy_norm, run

from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, ExactSolution, Laplace, Motion, Obstacle, Relative


def exact(x: Any, y: Any) -> Any:
    """The exact solution."""
    r2 = ca.fmax(x * x + y * y, 1.0)
    return r2 / 2 - ca.log(r2) / 2 - 0.5


def problem(n: int) -> ContactProblem:
    """``n`` times ``n`` cells."""
    sides = ("left", "right", "bottom", "top")
    return ContactProblem(
        mesh=rectangle(n, n, x=(-1.5, 1.5), y=(-1.5, 1.5)),
        law=Laplace(source=-2.0),
        dirichlet=tuple(Dirichlet(side, (exact,)) for side in sides),
        obstacle=Obstacle.interior(0.0),
        motion=Motion(Relative(0.3)),
        exact=ExactSolution(exact, float("nan")),
        name="free boundary",
    )


def radius(case: Case) -> float:
    """Radius of the contact set from the total reaction, which is 2 per area of contact."""
    problem, nodes = case.after.problem, np.asarray(case.after.mesh.p)
    reaction = case.after.pressure[problem.contact_nodes] @ DisplacementSpace(problem).weights(nodes)
    return float(np.sqrt(reaction / (2 * np.pi)))


def main(n: int = 16) -> Case:
    """Membrane on a flat obstacle."""
    case = run(problem(n), energy_norm)
    print(f"radius of the contact set {radius(case):.4f}, exactly 1")
    return case


if __name__ == "__main__":
    command_line(main, 16)
