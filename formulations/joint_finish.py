"""Newton steps from where an interior point stopped to a stationary point.

Where boxes are weakly active an interior point meets them to the square root of its tolerance only, and where
many elements are at their least area rounding can hold its multipliers off the tolerance. From there Newton's
method on the reduced energy takes one to five steps, each an exact contact solve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rmesh_nlp.evaluation import Array
from rmesh_nlp.programs.interior import ROUNDING
from rmesh_nlp.programs.nested_settings import NestedSettings
from rmesh_nlp.programs.outer_solvers import OUTER_SOLVERS
from rmesh_nlp.programs.reduced_program import reduced_nlp
from rmesh_nlp.solving.history import Recorder
from rmesh_nlp.solving.referee import Referee

NEAR = 1e-2
"""First-order residual up to which the end of a solve is near a stationary point."""

STEPS = 10
"""Most steps. Three problems of ``scripts/soak_truth.py`` (seeds 3039, 3133, 3277) take five, two and two."""


@dataclass(frozen=True)
class Finish:
    """Moves that are closer to a stationary point, and the steps and contact solves that they took."""

    q: Array
    iterations: int
    contact_solves: int


def finished(referee: Referee, q: Array, iterations: int, recorder: Recorder, tolerance: float) -> Finish:
    """Newton steps from moves ``q`` after so many iterations, if a stationary point is near.

    What they lead to is taken if its first-order residual is lower and its energy is not higher.
    """
    energy, stay = referee.reduced, Finish(q, 0, 0)
    if not q.size or energy.relocation.objective.has_barrier or not referee.is_valid(q):
        return stay
    before, measure = energy.contact_solves, referee.residual(energy)
    residual = measure(energy(q))
    if not tolerance < residual <= NEAR:
        return stay
    program = replace(
        reduced_nlp(referee.relocation, energy, referee.is_valid, measure, tolerance),
        out_of_time=lambda: recorder.remaining == 0.0,
        warm=True,
    )
    value, count = energy(q).value, 0

    def watch(iteration: int, at: Array, _: float) -> bool:
        nonlocal count
        count, here = iteration, energy(at)
        return iteration > 0 and recorder.exact(iteration, at, here.value, measure(here))

    recorder.after(iterations)
    found = recorder.run(
        lambda: OUTER_SOLVERS["newton"](program, q, watch, NestedSettings(max_iterations=STEPS))
    )
    end = q
    if found is not None and referee.is_valid(found.q) and energy.is_defined(found.q):
        there = energy(found.q)
        if measure(there) < residual and there.value <= value + ROUNDING * abs(value):
            end = found.q
    return Finish(end, count, energy.contact_solves - before)
