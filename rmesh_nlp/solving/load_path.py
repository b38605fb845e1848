"""A load path: a foundation that moves by a prescribed amount in steps.

Contact is geometrically linear and friction is that of one step (Tresca's bound on the total slip), so the
steps do not depend on each other: the path is a sequence of problems, each started from the last mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution

Solve = Callable[..., Solution]

RELOCATE = ("each", "once", "never")


@dataclass(frozen=True)
class PathStep:
    """One step of a load path.

    Attributes
    ----------
    number : int
        From 1.
    moved : (float, float)
        By how much the foundation has moved.
    solution : Solution
    obstacle : int
        Number of the foundation that moves.
    """

    number: int
    moved: tuple[float, float]
    solution: Solution
    obstacle: int = 0

    def row(self) -> dict[str, Any]:
        """Energies, and force, pressure and contact of the moving foundation, as plain values."""
        solution = self.solution
        force = contact_force(solution, self.obstacle)
        space = DisplacementSpace.of(solution.problem)
        pressure = solution.pressure[space.contact_sets[self.obstacle].nodes]
        return {
            "step": self.number,
            "moved_x": self.moved[0],
            "moved_y": self.moved[1],
            "status": solution.status.value,
            "success": solution.success,
            "energy_initial": solution.energy_initial,
            "energy": solution.energy,
            "force_x": force[0],
            "force_y": force[1],
            "largest_pressure": float(np.max(pressure, initial=0.0)),
            "touching_nodes": int(np.sum(pressure > 0)),
            "wall_time_s": solution.wall_time_s,
        }


def load_path(
    problem: ContactProblem,
    by: tuple[float, float],
    steps: int,
    solve: Solve,
    *,
    obstacle: int = 0,
    relocate: str = "each",
    hold: Solve | None = None,
    **options: Any,
) -> Iterator[PathStep]:
    """Solve the steps of a path one by one.

    Parameters
    ----------
    problem : ContactProblem
        With the foundation where it is before the first step.
    by : (float, float)
        How far the foundation moves in all.
    steps : int
        Equal parts of ``by``.
    solve : callable
        A solve that takes ``start``; it relocates nodes within the move limits of the problem's mesh.
    obstacle : int
        Number of the obstacle that moves, from 0.
    relocate : str
        "each": in every step, from the mesh of the last one. "once": for the last step, whose mesh then
        serves all steps; ``solve`` is called once. "never": the mesh as given.
    hold : callable, optional
        The solve without relocation, ``fixed``; needed for "once" and "never".
    options
        Further options of ``solve``.

    Raises
    ------
    ValueError
        If there is no such obstacle, ``relocate`` is unknown, or there are no steps.
    """
    if relocate not in RELOCATE:
        raise ValueError(f"relocate must be one of {', '.join(RELOCATE)}, got {relocate!r}")
    if steps < 1:
        raise ValueError(f"a load path needs at least one step, got {steps}")
    if not 0 <= obstacle < len(problem.obstacles):
        raise ValueError(f"there is no obstacle {obstacle}: the problem has {len(problem.obstacles)}")
    if relocate != "each" and hold is None:
        raise ValueError(f"relocate={relocate!r} needs the solve without relocation")
    path = [(by[0] * k / steps, by[1] * k / steps) for k in range(1, steps + 1)]
    if relocate == "once":
        problem = replace(problem, mesh=solve(_with_moved(problem, obstacle, path[-1]), **options).mesh)
    start: Array | None = None
    for number, moved in enumerate(path, 1):
        there = _with_moved(problem, obstacle, moved)
        if relocate == "each" or hold is None:
            solution = solve(there, start=start, **options)
            start = np.asarray(solution.mesh.p)
        else:
            solution = hold(there)
        yield PathStep(number, moved, solution, obstacle)


def contact_force(solution: Solution, obstacle: int = 0) -> Array:
    """Resultant (2,) of the pressure of one foundation on the body, friction left out."""
    space, nodes = DisplacementSpace.of(solution.problem), np.asarray(solution.mesh.p)
    part, points = space.contact_sets[obstacle], space.points(nodes)
    force = solution.pressure[part.nodes] * space.weights(nodes)[part.rows]
    total = np.zeros(2)
    total[: solution.problem.components] = part.obstacle.normals(points[:, part.nodes]) @ force
    return total


def _with_moved(problem: ContactProblem, number: int, by: tuple[float, float]) -> ContactProblem:
    obstacles = list(problem.obstacles)
    obstacles[number] = obstacles[number].moved(by)
    return replace(problem, obstacle=obstacles[0] if len(obstacles) == 1 else tuple(obstacles))
