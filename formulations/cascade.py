"""Relocation without move limits by a cascade of meshes: search where it is cheap, correct where it is dear.

The best positions for an energy with a distortion are a map of the domain that depends on the directions of
the edges and hardly on their length, if the weight falls like the error of the energy. So the map is found on
a coarse mesh, by continuation from heavy to light weights, prolonged to the next finer mesh, and there only
corrected.

1. Meshes: each coarser one has about a quarter of the nodes (:func:`rmesh_nlp.models.levels.coarsened`).
2. The error of the energy is estimated on the coarsest mesh; on the others it falls like the number of nodes
   to the power of the order of displacements, as that of relocated meshes does.
3. Coarsest mesh: a schedule of weights, each from where the last one ended.
4. Each finer mesh: from the prolonged map, at the final weight; few iterations correct it on the finest one
   (F. A. Bornemann, P. Deuflhard, The cascadic multigrid method for elliptic problems, Numer. Math. 75
   (1996)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formulations.schedule import Schedule, weights_of
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.descent import descend
from rmesh_nlp.models.levels import hierarchy, prolonged
from rmesh_nlp.models.regularisation import regularised, weights
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Count, Positive, Values
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer

ON_THE_WAY = 1e-2
"""Part of the error below which a descent at a weight before the final one ends."""


@dataclass(frozen=True)
class Descent(Formulation):
    """Newton-CG with local trust regions, for an energy with a distortion.

    Attributes
    ----------
    end : float
        It ends where the model predicts less than this part of what there is to gain.
    iterations : int
    """

    end: Positive = 3e-4
    iterations: Count = 20

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        track, energy = monitor.track(outer), outer.energy
        descent = descend(
            energy,
            q,
            outer.is_valid,
            track.exact,
            tolerance=np.inf,
            gain_tolerance=self.end,
            # relative to all there is to gain, so that a good start ends soon
            reference=energy(q).value + monitor.estimate(outer),
            max_iterations=self.iterations,
        )
        monitor.budget.check()
        return Outcome(outer, descent.x, descent.status)


@dataclass(frozen=True)
class Cascade(Formulation):
    """Minimises the energy over the positions of all nodes, by a cascade of meshes, from the given mesh.

    On a mesh that was made for the solution there are no coarser ones, which know less of it.
    docs/notes/large_moves.md has what other values of the settings gave.

    Attributes
    ----------
    regularisation : float
        Final weight of the distortion, relative to the estimated error of the energy.
    distortion : str
        See :mod:`rmesh_nlp.fem.distortion`.
    schedule : tuple of float
        Weights before the final one on the coarsest mesh, relative to the error too.
    coarsest : int
        Least number of nodes of the coarsest mesh.
    end : float
        A descent ends where the model predicts less than this part of the error.
    iterations : int
        Limit of a descent.
    """

    regularisation: Positive = 3e-3
    distortion: str = "shape-size"
    schedule: tuple[float, ...] = (1.0, 0.1, 0.01)
    coarsest: Count = 60
    end: Positive = 3e-4
    iterations: Count = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        regularised(1.0, 1.0, self.distortion)
        schedule = weights((*weights(self.schedule, "schedule"), self.regularisation), "schedule")
        object.__setattr__(self, "schedule", schedule[:-1])

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        if not objective.is_energy:
            raise BadInputError(
                f"the cascade minimises the energy, not {objective.text!r}: use nested or mpcc"
            )

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        if outer.is_near:
            descent = Descent(self.end, self.iterations)
            return Schedule(descent, (self.regularisation,), self.distortion).run(outer, q, monitor)
        budget, ends, levels = monitor.budget, list[Outcome](), list[Values]()

        def descend() -> None:
            with budget.during("build"):
                problems = hierarchy(outer.problem, self.coarsest)
            for problem in problems:
                with budget.during("build"):
                    level = (
                        outer if problem is outer.problem else Outer.of(problem, tolerance=outer.tolerance)
                    )
                first, solves = budget.iterations, monitor.spent.contact_solves
                outcome = (
                    self._corrected(level, ends[-1], monitor) if ends else self._searched(level, monitor)
                )
                if outcome.outer.gain is None:  # stopped before there was a map
                    return
                ends.append(outcome)
                done = {
                    "nodes": problem.n_vertices,
                    "triangles": problem.mesh.nelements,
                    "energy": outcome.outer.energy(outcome.q).equilibrium.energy,  # without the distortion
                    "iterations": budget.iterations - first,
                    "contact_solves": monitor.spent.contact_solves - solves,
                }
                levels.append(done)
                budget.check()

        monitor.attempt(descend)
        if not ends:
            return Outcome(outer, q, monitor.end)
        outcome = ends[-1]
        if outcome.outer.problem is not outer.problem:  # stopped before: the map so far, as it is
            end = monitor.tracked(self._weighted(outer, outcome.outer))
            q = _mapped(outcome, end)
            while not end.is_valid(q):
                q = 0.5 * q
            outcome = Outcome(end, q, monitor.end)
        gain, weight = outcome.outer.gain or 0.0, self.regularisation
        nodes = ", ".join(str(level["nodes"]) for level in levels)
        return outcome.having(
            {
                **weights_of(weight, self.distortion, weight, gain),
                "outer": "newton",
                "cascade": levels,
            },
            remarks=(f"over meshes of {nodes} nodes", *outcome.remarks),
        )

    def _searched(self, level: Outer, monitor: Monitor) -> Outcome:
        """Where the schedule of weights ends on the coarsest mesh."""
        heavier = Schedule(Descent(ON_THE_WAY, self.iterations), self.schedule, self.distortion)
        begun = monitor.run(heavier, level, np.zeros(level.n))
        if begun.outer.gain is None or monitor.budget.is_over():
            return begun
        return monitor.run(Descent(self.end, self.iterations), self._weighted(level, begun.outer), begun.q)

    def _weighted(self, level: Outer, coarser: Outer) -> Outer:
        """The energy with the distortion on a finer mesh: its error falls like the number of nodes."""
        problems = coarser.problem, level.problem
        coarse, fine = (float(problem.n_vertices) ** problem.order for problem in problems)
        error = (coarser.gain or 0.0) * coarse / fine
        return level.minimising(regularised(error, self.regularisation, self.distortion), error)

    def _corrected(self, level: Outer, before: Outcome, monitor: Monitor) -> Outcome:
        """Where a descent from the map of the next coarser mesh ends."""
        with monitor.budget.during("build"):
            weighted = self._weighted(level, before.outer)
            q = _mapped(before, weighted)
        start = q if weighted.is_valid(q) else np.zeros(level.n)
        return monitor.run(Descent(self.end, self.iterations), weighted, start)


def _mapped(coarse: Outcome, fine: Outer) -> Array:
    """Outer variables of a finer mesh that follow the map of a coarser one."""
    outer = coarse.outer
    shift = outer.nodes(coarse.q) - outer.problem.mesh.p
    return prolonged(outer.problem.mesh.p, outer.problem.triangles, shift, fine.discretisation)
