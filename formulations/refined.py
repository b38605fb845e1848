"""Several levels: optimise on the mesh as given, refine it uniformly, and go on from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.settings import Count
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome, continuous_energy
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part


@dataclass(frozen=True)
class Levels(Part):
    """The continuous energies at the ends of the levels."""

    level_energies: tuple[float, ...]


@dataclass(frozen=True)
class Refined(Wrapper):
    """Runs a formulation on each level from the relocation of the one before; the finest is the outcome.

    Move limits keep their widths in units of length. The energy before is that of the refined mesh without
    any motion.

    Attributes
    ----------
    levels : int
        Uniform refinements.
    """

    levels: Count = 1

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        super().accepts(problem, objective)
        if problem.design:
            said = "levels carry node positions to finer meshes, and no design variables"
            raise BadInputError(f"{said}: solve on the finer mesh from the design that was found")

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        found = monitor.run(self.inner, outer, q)
        energies = [continuous_energy(found)]
        for _ in range(self.levels):
            if monitor.is_over():
                break
            coarse = found.outer.problem
            with monitor.clock.during("build"):
                fine = Outer(refined(coarse), outer.objective, outer.tolerance)
                start = fine.variables(prolong(coarse, found.outer.nodes(found.q), fine.problem))
            found = monitor.run(self.inner, fine, start)
            energies.append(continuous_energy(found))
        return found.having(Levels(tuple(energies)))


def prolong(coarse: ContactProblem, nodes: Array, fine: ContactProblem) -> Array:
    """Positions (2, nodes) of a refined mesh when its coarse nodes are at ``nodes``.

    The motion is interpolated linearly: midpoints of edges move by the mean of their ends.
    """
    move = nodes - coarse.mesh.p
    middle = move[:, coarse.mesh.facets].mean(axis=1)
    shift = np.hstack([move, middle])
    if shift.shape != fine.mesh.p.shape or not np.array_equal(fine.mesh.p[:, : move.shape[1]], coarse.mesh.p):
        raise ValueError("the fine mesh is not the uniform refinement of the coarse one")
    return np.asarray(fine.mesh.p + shift)
