"""A square plate with a round hole, stretched: stress concentration without contact.

Square of side 10 with a hole of radius 2.5, lambda = 1.25, mu = 1, plane strain; the bottom is
held, the top displaced by (0, 1), both components given; all boundary nodes pinned. Only the
validity of the elements limits the motion: no delta. The setting is that of the h- and
r-adaptivity tests of NeuROM-Py.
"""

from __future__ import annotations

from common import Case, command_line, energy_above, run

from support.formulations import fixed
from rmesh_nlp.meshes.shapes import plate_with_hole
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, PlaneStrain
from rmesh_nlp.solving.starts import refine


def problem(n: int) -> ContactProblem:
    """About ``n`` edges along each side."""
    return ContactProblem(
        mesh=plate_with_hole(10 / n),
        law=PlaneStrain(lame_lambda=1.25, lame_mu=1.0),
        dirichlet=("bottom", Dirichlet("top", (0.0, 1.0))),
        motion=Motion(None, pinned=("left", "right", "bottom", "top", "hole"), min_area_fraction=0.01),
        name="plate with hole",
    )


def main(n: int = 12) -> Case:
    """Plate with a hole, stretched."""
    grids = [problem(n)]
    for _ in range(2):
        grids.append(refine(grids[-1]))
    energies = [fixed.solve(grid).energy for grid in grids[-2:]]
    # errors of energies fall by four with h/2, or a little less: the fixed polygon is the domain
    reference = energies[1] - (energies[0] - energies[1]) / 3
    return run(grids[0], energy_above(reference), grids[1:2])


if __name__ == "__main__":
    command_line(main, 12)
