"""Relocation without move limits by a cascade of meshes: search where it is cheap, correct where it is dear.

The best positions for an energy with a distortion are a map of the domain that depends on the directions of
the edges and hardly on their length, if the weight falls like the error of the energy. So the map is found on
a coarse mesh, by continuation from heavy to light weights, prolonged to the next finer mesh, and there only
corrected.

1. Meshes: each coarser one has about a quarter of the nodes (:func:`rmesh_nlp.models.levels.coarsened`).
2. The error of the energy is estimated on the coarsest mesh; on the others it falls like the number of nodes
   to the power of the order of displacements, as that of relocated meshes does.
3. Coarsest mesh: schedules of weights, each weight from where the last one ended; the best end counts. More
   than one where they are cheap beside the finest mesh.
4. Each finer mesh: from the prolonged map, at the final weight, by a few iterations, more on the coarser
   ones, where they cost less (F. A. Bornemann, P. Deuflhard, The cascadic multigrid method for elliptic
   problems, Numer. Math. 75 (1996)). A map that does not lower the energy there is damped, or not taken at
   all (:func:`rmesh_nlp.models.levels.accepted`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import BadInputError, ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.levels import accepted, coarsened, prolonged
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.models.regularised_descent import descend
from rmesh_nlp.optimize.budget import Budget, processor_seconds
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.rigid import rigid_motions
from rmesh_nlp.settings import Count, Limit, Positive, Settings

Schedules = tuple[tuple[float, ...], ...]
"""Weights before the final one, schedule by schedule."""

CHEAP = 150.0
"""How many times the nodes of the coarsest mesh the finest one must have for more than one schedule. Below it
the others would cost a tenth of the solve and more, for 1 % less error in the median."""

ENOUGH = {1: 1.0, 2: 0.3}
"""Part of ``brief_unnested`` that a mesh made for the solution is given at an order. At order 2, 6 iterations
in place of 20 cost 2 % more error in the median of 14 problems and 12 % at most, for 0.72 of the time (chosen
on Example 6.1, the L-shape with r^(2/3), Example 6.3 and the wedge)."""

CONTINUED = 1e-2
"""A descent at a weight before the final one ends where the model predicts less than this part of the
error."""


@dataclass(frozen=True)
class CascadeSettings(Settings):
    """Settings of the cascade, chosen on Example 6.1 with 8 to 128 squares a side.

    The ``schedules`` were chosen on the L-shape, the wedge, Example 6.3 and the free boundary as well.
    docs/notes/large_moves.md has what other values gave, also on other problems.

    Attributes
    ----------
    regularisation : float
        Final weight of the distortion, relative to the estimated error of the energy.
    distortion : str
        See :mod:`rmesh_nlp.fem.distortion`.
    schedules : tuple of tuples of float
        Weights before the final one on the coarsest mesh, relative to the error too; the best end counts.
    coarsest : int
        Least number of nodes of the coarsest mesh.
    end : float
        A descent ends where the model predicts less than this part of the error.
    iterations : int
        Limit of a descent on a coarser mesh, and of what is no correction of a map.
    brief, brief_unnested : int
        Limit on the finest mesh, where it is a uniform refinement of the next coarser one and where it is
        not: a map is then prolonged less well. The latter holds on a mesh made for the solution too, in part
        at order 2 (:meth:`near`).
    stationary : int
        Largest number of nodes of a given mesh on which ``auto`` goes on to a stationary point; by default it
        never does: that takes two thirds of the time or more for 3 to 8 % less error.
    finish : int
        Limit of the iterations of that.
    most : int
        Contact solves of all meshes together after which ``auto`` does not go on to a stationary point.
    """

    regularisation: Positive = 3e-3
    distortion: str = "shape-size"
    schedules: Schedules = ((1.0, 0.1, 0.01), (1.0, 0.1), (0.1,), (0.1, 0.01))
    coarsest: Count = 60
    end: Positive = 3e-4
    iterations: Count = 20
    brief: Count = 10
    brief_unnested: Count = 20
    stationary: Limit = 0
    finish: Count = 120
    most: Count = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        regularised(1.0, 1.0, self.distortion)
        kinds = (tuple, list)
        if not (
            isinstance(self.schedules, kinds)
            and all(isinstance(schedule, kinds) for schedule in self.schedules)
        ):
            raise BadInputError(f"schedules must be lists of weights, got {self.schedules!r}")
        for schedule in self.schedules:
            weights((*schedule, self.regularisation), "a schedule of the cascade")

    def near(self, order: int) -> int:
        """Largest number of iterations on a mesh made for the solution, at an order of displacements."""
        return max(1, round(self.brief_unnested * ENOUGH[order]))

    def starts(self, coarsest: int, finest: int) -> Schedules:
        """The schedules that are tried on a coarsest mesh, by the nodes of both."""
        return self.schedules if finest >= CHEAP * coarsest else self.schedules[:1]

    def limit(self, is_brief: bool, is_nested: bool) -> int:
        """Largest number of iterations on a mesh."""
        if not is_brief:
            return self.iterations
        return self.brief if is_nested else self.brief_unnested


OnStep = Callable[[int, ReducedEnergy, Array, float], bool | None]
"""``(iteration, energy, q, value)`` of a level; the descent stops if it returns True."""


@dataclass(frozen=True)
class Level:
    """What was done on one mesh of the cascade.

    ``weight`` is the final one of the distortion, absolute. Energies are without the distortion: that of the
    prolonged map, and at the end. ``taken`` is the part of the prolonged map that was taken, see
    :func:`rmesh_nlp.models.levels.accepted`; it and ``prolonged`` are NaN on the coarsest mesh, and
    ``prolonged`` where the map folds a triangle at an arc. ``seconds``
    of processor time went to descents, ``build_seconds`` to building the models and making the map.
    """

    nodes: int
    triangles: int
    weight: float
    prolonged: float
    taken: float
    energy: float
    iterations: int
    products: int
    contact_solves: int
    seconds: float
    build_seconds: float


@dataclass(frozen=True)
class CascadeResult:
    """Where the cascade ended: outer variables of the finest mesh, whose ``problem`` was given.

    ``objective`` is the energy of the finest mesh with the distortion, ``gain_estimate`` the estimated error
    of its energy as given. ``levels`` begin with the coarsest. ``built`` is None if the time was up before.
    """

    q: Array
    problem: ContactProblem
    objective: Objective
    gain_estimate: float
    status: Status
    levels: tuple[Level, ...]
    built: ReducedEnergy | None = None

    @cached_property
    def energy(self) -> ReducedEnergy:
        """The objective as a function of q."""
        return self.built or ReducedEnergy.of(ContactSolver(self.problem), self.objective)

    def record(self) -> list[dict[str, Any]]:
        """The levels as plain values."""
        return [asdict(level) for level in self.levels]


def cascade(
    problem: ContactProblem,
    settings: CascadeSettings | None = None,
    on_step: OnStep | None = None,
    budget: Budget | None = None,
    solver: ContactSolver | None = None,
) -> CascadeResult:
    """Minimise the energy over the positions of all nodes, without move limits, by a cascade of meshes.

    Parameters
    ----------
    problem : ContactProblem
        Move limits are obeyed if there are any; without, the distortion alone keeps the elements valid.
    settings : CascadeSettings, optional
    on_step : callable, optional
        Called after each iteration on each mesh.
    budget : Budget, optional
        Once it is over nothing more is built or solved: the map of the last mesh is prolonged to the given
        one, where it is neither corrected nor compared, and the status is INTERRUPTED.
    solver : ContactSolver, optional
        Of the problem, where there is one already.

    Raises
    ------
    StoppedError
        If the time is up before there is a map.
    """
    chosen = settings or CascadeSettings()
    budget = budget or Budget()
    problems = _hierarchy(problem, chosen.coarsest, budget)
    budget.check()
    final_weight = chosen.regularisation
    run = _Descents(chosen, final_weight, on_step, budget)
    sizes = [current.mesh.p.shape[1] for current in problems]

    def solver_of(current: ContactProblem) -> ContactSolver:
        return solver if solver is not None and current is problem else ContactSolver(current)

    coarsest = solver_of(problems[0])
    powers = np.array(sizes, dtype=float) ** problem.order
    errors = gain_estimate(coarsest).value * powers[0] / powers
    shift, levels, built = np.zeros((2, 0)), [], None
    for number, current in enumerate(problems):
        run.error = float(errors[number])
        before = taken = float("nan")
        if number == 0:
            budget.check()
            energy, q, status = run.searched(coarsest, chosen.starts(sizes[0], sizes[-1]))
        else:
            coarse = problems[number - 1]
            energy = run.energy(solver_of(current), final_weight)
            prolonged_q = prolonged(coarse.mesh.p, coarse.triangles, shift, energy.relocation)
            q, taken = accepted(energy, prolonged_q)
            if energy.is_defined(prolonged_q):
                before = energy(prolonged_q).equilibrium.energy
            # what is not a correction of a map takes more than a few iterations
            brief = current is problem and taken == 1
            nested = current.mesh.t.shape[1] == 4 * coarse.mesh.t.shape[1]
            q, status = run.descend(energy, q, chosen.end, chosen.limit(brief, nested))
        shift = energy.relocation.nodes(q) - current.mesh.p
        levels.append(run.level(energy, q, before, taken))
        if number == len(problems) - 1:
            built = None if run.stopped else energy
        elif run.late():
            q = prolonged(current.mesh.p, current.triangles, shift, discretise(problem))
            break
    final = float(errors[-1])
    objective = regularised(final, final_weight, chosen.distortion)
    status = Status.INTERRUPTED if run.stopped else status
    return CascadeResult(q, problem, objective, final, status, tuple(levels), built)


def _hierarchy(problem: ContactProblem, coarsest: int, budget: Budget) -> list[ContactProblem]:
    """The problem on coarser and coarser meshes, coarsest first, itself last."""
    levels = [problem]
    while True:
        budget.check()
        coarser = coarsened(levels[-1], coarsest)
        if coarser is None or not _is_fixed(coarser):
            return levels[::-1]
        levels.append(coarser)


def _is_fixed(problem: ContactProblem) -> bool:
    """Whether no rigid-body mode is left: a coarse mesh may touch at one node where contact excludes it."""
    if rigid_motions(problem).size > 0:
        try:
            ContactSolver(problem)
        except ProblemError:
            return False
    return True


class _Descents:
    """Descents on the meshes of one cascade, and what they cost on the present one.

    ``error`` is the estimated error of the energy there.
    """

    def __init__(
        self, settings: CascadeSettings, final_weight: float, on_step: OnStep | None, budget: Budget
    ) -> None:
        self._settings, self._weight, self._on_step, self._budget = settings, final_weight, on_step, budget
        self._reported, self.stopped, self.error = 0, False, float("nan")
        self._clear()

    def _clear(self) -> None:
        self._iterations = self._products = 0
        self._energies: list[ReducedEnergy] = []
        self._began, self._seconds = processor_seconds(), 0.0

    def late(self) -> bool:
        """Whether the descents were stopped, or the time is up."""
        self.stopped = self.stopped or self._budget.is_over()
        return self.stopped

    def energy(self, solver: ContactSolver, weight: float) -> ReducedEnergy:
        """The energy of a mesh with the distortion."""
        objective = regularised(self.error, weight, self._settings.distortion)
        self._energies.append(ReducedEnergy.of(solver, objective))
        return self._energies[-1]

    def level(self, energy: ReducedEnergy, q: Array, before: float, taken: float) -> Level:
        """The present mesh, where q was reached; the next one begins."""
        mesh, reached = energy.relocation.problem.mesh, energy(q).equilibrium.energy
        level = Level(
            nodes=mesh.p.shape[1],
            triangles=mesh.t.shape[1],
            weight=self._weight * self.error,
            prolonged=before,
            taken=taken,
            energy=reached,
            iterations=self._iterations,
            products=self._products,
            contact_solves=sum(energy.contact_solves for energy in self._energies),
            seconds=self._seconds,
            build_seconds=processor_seconds() - self._began - self._seconds,
        )
        self._clear()
        return level

    def searched(self, solver: ContactSolver, schedules: Schedules) -> tuple[ReducedEnergy, Array, Status]:
        """The best end of all schedules on the coarsest mesh; the first map that there is once it is late."""
        chosen = self._settings
        best: tuple[float, ReducedEnergy, Array, Status] | None = None
        reached: tuple[ReducedEnergy, Array, Status] | None = None
        ends: dict[tuple[float, ...], Array] = {}
        for schedule in schedules:
            whole = (*schedule, self._weight)
            # schedules may begin alike: what they share is solved once
            for path in (whole[:number] for number in range(1, len(whole) + 1)):
                if path in ends:
                    continue
                if reached is not None and self.late():
                    return best[1:] if best is not None else reached
                energy, last = self.energy(solver, path[-1]), path == whole
                start = ends[path[:-1]] if len(path) > 1 else np.zeros(energy.relocation.n_q)
                # of several only the best one is followed to the end
                end = chosen.end if last and len(schedules) == 1 else CONTINUED
                ends[path], status = self.descend(energy, start, end, chosen.iterations)
                reached = energy, ends[path], status
                if last and (best is None or energy(ends[path]).value < best[0]):
                    best = energy(ends[path]).value, *reached
        assert best is not None
        _, energy, q, status = best
        if len(schedules) > 1 and not self.late():
            q, status = self.descend(energy, q, chosen.end, chosen.iterations)
        return energy, q, status

    def descend(self, energy: ReducedEnergy, q: Array, end: float, limit: int) -> tuple[Array, Status]:
        """A descent that ends where the model predicts less than the part ``end`` of the error."""
        before = self._reported

        def report(iteration: int, x: Array, value: float) -> bool:
            if self._on_step is not None and self._on_step(before + iteration, energy, x, value):
                self.stopped = True
            return self.stopped

        began = processor_seconds()
        result = descend(
            energy,
            q,
            gain_tolerance=end,
            # relative to all there is to gain, so that a good start ends soon
            reference=energy(q).value + self.error,
            max_iterations=limit,
            on_step=report,
        )
        self._seconds += processor_seconds() - began
        self._reported += result.iterations
        self._iterations += result.iterations
        self._products += result.products
        return result.x, result.status
