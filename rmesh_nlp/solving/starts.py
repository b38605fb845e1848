"""Several starts and several levels, for any strategy.

A strategy is a function ``solve(problem, *, seed, start, ...) -> Solution``; those of
``formulations`` are, and so is any that takes these two options.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.refining import refined
from rmesh_nlp.solving.registry import accepted
from rmesh_nlp.solving.solution import Solution, interrupted

Solve = Callable[..., Solution]


@dataclass(frozen=True)
class MultiStart:
    """Solutions from several starts, in the order of the seeds.

    Attributes
    ----------
    solutions : tuple of Solution
        The first is that from the initial mesh.
    """

    solutions: tuple[Solution, ...]

    @property
    def best(self) -> Solution:
        """The successful solution that ends lowest; the first one if none succeeded."""
        good = [s for s in self.solutions if s.success]
        return min(good, key=_end) if good else self.solutions[0]

    @property
    def ends(self) -> Array:
        """(solutions,) audited energies, or values of another minimised objective; NaN of a failure."""
        return np.array([_end(s) if s.success else np.nan for s in self.solutions])

    @property
    def energies(self) -> Array:
        """Audited energies (solutions,); NaN where a solve did not succeed."""
        return np.array([s.audit.energy_audited if s.success else np.nan for s in self.solutions])

    @property
    def spread(self) -> float:
        """Largest less least audited energy of the successful solutions; NaN if none succeeded."""
        energies = self.energies[np.isfinite(self.energies)]
        return float(np.ptp(energies)) if energies.size else float("nan")

    def reported(self) -> Solution:
        """The best solution, its record telling the energies of all starts and their spread."""
        figures = {
            "start_seeds": [s.seed for s in self.solutions],
            "start_energies": [None if np.isnan(e) else float(e) for e in self.energies],
            "start_spread": self.spread,
        }
        if self.solutions[0].objective != "energy":
            figures["start_values"] = [None if np.isnan(end) else float(end) for end in self.ends]
        stopped = self.solutions[-1].status is Status.INTERRUPTED
        best = interrupted(self.best) if stopped else self.best
        return replace(best, extra={**best.extra, **figures})


def _end(solution: Solution) -> float:
    value = None if solution.objective == "energy" else solution.extra.get("objective_value")
    return float(solution.audit.energy_audited if value is None else value)


def multistart(
    solve: Solve, problem: ContactProblem, seeds: int | Iterable[int] = 8, **options: Any
) -> MultiStart:
    """Solve from the initial mesh and from random starts.

    Parameters
    ----------
    solve : callable
        A strategy.
    problem : ContactProblem
    seeds : int or iterable of int
        Their seeds, or how many: 1, 2, ... The same seed gives the same start.
    options
        Further options of the strategy.
    """
    chosen = range(1, seeds + 1) if isinstance(seeds, int) else seeds
    starts: list[int | None] = [None, *chosen]
    solutions: list[Solution] = []
    for seed in starts:
        solutions.append(solve(problem, seed=seed, **options))
        if solutions[-1].status is Status.INTERRUPTED:
            break
    return MultiStart(tuple(solutions))


def refine(problem: ContactProblem) -> ContactProblem:
    """The same problem with every triangle cut into four, names kept.

    Boxes keep their widths in units of length: a relative delta is doubled, since edges are
    halved. Rules that name node numbers go on to hold for the same nodes.
    """
    return refined(problem)


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


def multilevel(
    solve: Solve, problem: ContactProblem, refinements: int = 1, **options: Any
) -> tuple[Solution, ...]:
    """Optimise on the mesh as given, refine, prolong the motion and go on from there.

    Returns the solutions of all levels, coarsest first. The last one's ``energy_initial`` is
    that of the refined initial mesh without any motion.
    """
    if refinements < 0:
        raise ValueError(f"the number of refinements must not be negative, got {refinements}")
    solutions = [solve(problem, **options)]
    for _ in range(refinements):
        fine = refine(problem)
        if solutions[-1].status is Status.INTERRUPTED:
            break
        start = prolong(problem, np.asarray(solutions[-1].mesh.p), fine)
        solutions.append(solve(fine, start=start, **options))
        problem = fine
    return tuple(solutions)


def with_starts(solve: Solve) -> Solve:
    """The strategy with two more options, ``starts`` and ``levels``, if it takes a seed and a start.

    ``starts=n`` solves from n random starts besides the mesh as given and returns the best
    solution; ``levels=n`` refines n times and returns the finest. The record tells of the others.
    """
    signature = inspect.signature(solve)
    if not {"seed", "start"} <= accepted(solve, ("seed", "start")):
        return solve

    @functools.wraps(solve)
    def run(problem: ContactProblem, *, starts: int = 0, levels: int = 0, **options: Any) -> Solution:
        if starts and (levels or options.get("seed") is not None):
            raise ValueError("starts cannot be combined with levels or a seed")
        if starts:
            options.pop("seed", None)
            return multistart(solve, problem, starts, **options).reported()
        if levels:
            solutions = multilevel(solve, problem, levels, **options)
            energies = [s.audit.energy_audited for s in solutions]
            return replace(solutions[-1], extra={**solutions[-1].extra, "level_energies": energies})
        return solve(problem, **options)

    more = [inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY, default=0) for n in ("starts", "levels")]
    own = list(signature.parameters.values())
    place = len(own) - (own[-1].kind is inspect.Parameter.VAR_KEYWORD)
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*own[:place], *more, *own[place:]]
    )
    return run
