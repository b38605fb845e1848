"""Edge flips by energy between relocations: the connectivity follows the solution as far as flips can."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from formulations.schedule import Schedule
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.flips import flips_and_moves
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work

SOLVES = 3
"""Contact solves of a round of flips."""


@dataclass(frozen=True)
class FlipFigures(Part):
    """How many edges were flipped, how many triangles are new, and both by rounds."""

    flips: int
    changed_triangles: int
    flip_rounds: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class Flips(Wrapper):
    """Flips edges after a relocation and relocates again, until neither gains; without move limits only.

    Attributes
    ----------
    flips : bool
        Whether to flip at all.
    then : Formulation, optional
        What relocates after flips; by default what does before.
    """

    flips: bool = True
    then: Any = None

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        super().accepts(problem, objective)
        if problem.motion.delta is not None:
            raise BadInputError('flips need a problem without move limits: delta = "none"')

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        found = monitor.run(self.inner, outer, q)
        if not self.flips or monitor.is_over() or not found.outer.is_valid(found.q):
            return found
        first, given = found, outer.problem

        def relocate(flipped: ContactProblem) -> ContactProblem:
            nonlocal found
            if monitor.is_over():
                return flipped
            with monitor.clock.during("build"):
                there = first.outer.on(flipped)
            found = monitor.run(_again(self), there, there.variables())
            return _moved(found)

        gain = monitor.estimate(outer) if first.outer.gain is None else first.outer.gain
        ended = monitor.attempt(
            lambda: flips_and_moves(_moved(first), gain, relocate, given=given, stop=monitor.is_over)
        )
        if ended is None:
            return found.after(first)
        last, rounds = ended
        monitor.work += Work(SOLVES * len(rounds))
        if rounds and not _same(_moved(found), last):
            with monitor.clock.during("build"):
                there = first.outer.on(last)
            found = Outcome(there, there.variables(), found.status)
        before, after = ({*map(frozenset, one.triangles.T)} for one in (given, found.outer.problem))
        figures = FlipFigures(
            flips=sum(one.flips for one in rounds),
            changed_triangles=len(after - before),
            flip_rounds=tuple(asdict(one) for one in rounds),
        )
        return found.after(first).having(figures)


def _again(flips: Flips) -> Any:
    """What relocates after flips: of a schedule only its end, since the last weight is kept."""
    if flips.then is not None:
        return flips.then
    return flips.inner.inner if isinstance(flips.inner, Schedule) else flips.inner


def _moved(found: Outcome) -> ContactProblem:
    problem = found.outer.problem
    return replace(problem, mesh=relocated_mesh(problem.mesh, found.outer.nodes(found.q)))


def _same(one: ContactProblem, other: ContactProblem) -> bool:
    return np.array_equal(one.mesh.p, other.mesh.p) and np.array_equal(one.mesh.t, other.mesh.t)
