"""A quantity of interest: the profile of a punch, shaped so that its peak pressure is low.

An elastic block, 2 wide and 1 high, E = 1000, nu = 0.3, plane strain, is pressed onto a rigid plane
by a load that is largest in its middle; by symmetry the right half is computed. The pressure
below a flat block follows the load. Here the nodes of the lower edge may move up and down, and the
smoothed peak of the contact pressure is minimised, with a weight on the distortion of the elements:

    peak-pressure(bottom, 10, 12) + 0.02*quality.

The mean pressure is 10, whatever the profile, so the best one makes the pressure uniform. The energy
could not be the objective: its minimum over shapes is another one. So the contact problem stays a
constraint, and ``nested`` and ``mpcc`` find the same profile. On 8 x 8 squares the largest nodal
pressure falls from 13.80 to 10.88.
"""

from __future__ import annotations

from pathlib import Path

from common import command_line, save

import rmesh_nlp as rm

REFERENCE = 10.0
"""The mean pressure; it only scales the objective."""

EXPONENT = 12


def problem(n: int) -> rm.ContactProblem:
    """The right half on ``n`` x ``n`` squares; the gap is the height of the lower edge."""
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(n, n),
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=rm.Obstacle.graph("bottom", 0.0),
        motion=rm.Motion((1e-6, 0.004), pinned=("top", "left", "right"), free=("bottom",)),
        tractions=(rm.Traction("top", (0.0, lambda x, y: -20 * (1 - x))),),
        name="punch",
    )


def main(n: int = 8) -> dict[str, rm.Solution]:
    """Shape the punch by both formulations and print what it gave."""
    objective = f"peak-pressure(bottom, {REFERENCE:g}, {EXPONENT}) + 0.02*quality"
    punch = problem(n)
    print(f"gradient: order {rm.verify_gradient(punch, objective).order:.2f}")
    solutions = {name: rm.solve(punch, name, objective=objective) for name in ("fixed", "nested", "mpcc")}
    for name, solution in solutions.items():
        value = solution.record().get("objective_value", float("nan"))
        peak = REFERENCE * value ** (1 / EXPONENT)  # its distortion neglected
        largest = f"largest nodal pressure {solution.pressure.max():.4g}"
        print(f"{name}: {solution.status.value}, smoothed peak {peak:.4g}, {largest}")
    return solutions


def draw(solutions: dict[str, rm.Solution], path: Path) -> None:
    """The pressures before and after."""
    axes = rm.plot(solutions["fixed"], solutions["nested"], what="pressure")
    save(axes[0].figure, path)


if __name__ == "__main__":
    command_line(main, 8, draw)
