"""Torsion of an L-shaped bar: a corner singularity, and a mesh that crowds into it.

-Laplace(u) = 1 in (-1, 1)^2 without its lower right quarter, u = 0 on the boundary; no contact.
At the re-entrant corner u behaves like r^(2/3) sin(2 theta / 3), so uniform grids lose their
order. All sides slide. The exact energy is -0.1070379 (twice it, 0.2140758, is in the literature
on adaptive finite elements).
"""

from __future__ import annotations

from common import Case, command_line, energy_above, run

from rmesh_nlp.meshes.shapes import l_shape
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Relative

EXACT_ENERGY = -0.2140758036 / 2


def problem(n: int) -> ContactProblem:
    """About ``n`` edges along each short side."""
    return ContactProblem(
        mesh=l_shape(1 / n),
        law=Laplace(source=1.0),
        dirichlet=("corner", "outer"),
        motion=Motion(Relative(0.45)),
        name="L-shape",
    )


def main(n: int = 8) -> Case:
    """L-shaped bar with a corner singularity."""
    return run(problem(n), energy_above(EXACT_ENERGY))


if __name__ == "__main__":
    command_line(main, 8)
