"""Hertz: a half disc pressed onto a rigid plane, against the analytic pressure.

Lower half of a disc of radius R = 1, E = 1000, nu = 0.3, plane strain, its flat top pushed down
by a given displacement; by symmetry the right quarter is computed. The arc is cut off by its
chord below, so that contact nodes slide; the gap is that of the disc, R - sqrt(R^2 - x^2).
For the resultant P of the computed pressure the analytic solution is

    p(x) = p0 sqrt(1 - x^2 / a^2),   a = sqrt(4 P R (1 - nu^2) / (pi E)),   p0 = 2 P / (pi a).

The computed half-width is where the straight line fitted to p^2 over x^2 at the nodes in contact
vanishes (p^2 is linear in x^2 for Hertz); beside it the bracket from the last node in contact to
the first one out of it is given. The peak is the largest nodal pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from common import Case, command_line, energy_above, run

import rmesh_nlp as rm
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import half_disc
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain, Relative
from rmesh_nlp.solving.solution import Solution

RADIUS, YOUNG, POISSON = 1.0, 1000.0, 0.3
PUSH = 0.02


@dataclass(frozen=True)
class Contact:
    """Computed contact over the analytic one: half-width, its bracket, peak pressure, as ratios."""

    half_width: float
    bracket: tuple[float, float]
    peak: float

    def __str__(self) -> str:
        low, high = self.bracket
        return f"half-width {self.half_width:.4f} (in {low:.3f} to {high:.3f}), peak {self.peak:.4f}"


def problem(n: int) -> ContactProblem:
    """About ``n`` edges over the contact half-width."""
    return ContactProblem(
        mesh=half_disc(1.6 / n, radius=RADIUS, contact=0.2, h_contact=0.12 / n),
        law=PlaneStrain.from_young(YOUNG, POISSON),
        dirichlet=(Dirichlet("axis", (0.0, None)), Dirichlet("top", (0.0, -PUSH))),
        obstacle=Obstacle("contact", offset=lambda x, y: RADIUS - ca.sqrt(RADIUS**2 - x**2)),
        motion=Motion(Relative(0.3), pinned=("arc", "top")),
        name="Hertz",
    )


def measure(solution: Solution) -> Contact:
    """Half-width and peak of the computed pressure over those of Hertz."""
    nodes = solution.problem.contact_nodes
    x, pressure = solution.mesh.p[0, nodes], solution.pressure[nodes]
    load = 2 * float(pressure @ DisplacementSpace(solution.problem).weights(np.asarray(solution.mesh.p)))
    a = np.sqrt(4 * load * RADIUS * (1 - POISSON**2) / (np.pi * YOUNG))
    touching = pressure > 0
    slope, square = np.polyfit(x[touching] ** 2, pressure[touching] ** 2, 1)
    bracket = (float(x[touching].max() / a), float(x[~touching].min() / a))
    return Contact(
        float(np.sqrt(-square / slope) / a), bracket, float(pressure.max() * np.pi * a / (2 * load))
    )


def main(n: int = 8) -> Case:
    """Half disc on a rigid plane."""
    grids = [problem(n), problem(2 * n), problem(4 * n)]
    fine, finer = (rm.solve(grid, "fixed").energy for grid in grids[1:])
    case = run(grids[0], energy_above(finer - (fine - finer) / 3))
    print(f"{case.after.mesh.p.shape[1]} nodes; computed over analytic:")
    print(f"  before {measure(case.before)}")
    print(f"  after  {measure(case.after)}")
    return case


if __name__ == "__main__":
    command_line(main, 8)
