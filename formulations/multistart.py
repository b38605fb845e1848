"""Several starts of one formulation: the best end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.settings import Count
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome, continuous_energy
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import plain


@dataclass(frozen=True)
class MultiStart(Wrapper):
    """Runs a formulation from the mesh as given and from random starts; the lowest end is the outcome.

    Attributes
    ----------
    starts : int
        How many random ones, with the seeds 1, 2, ...
    """

    starts: Count = 8
    begins_by_itself: ClassVar[tuple[str, ...]] = ("seed",)

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        ends, energies, merits = list[Outcome](), list[float](), list[tuple[float, float]]()
        seeds: list[int | None] = [None, *range(1, self.starts + 1)]
        for seed in seeds:
            outcome = monitor.run(self.inner, outer, q if seed is None else outer.variables(seed=seed))
            ends.append(outcome)
            energies.append(continuous_energy(outcome))
            merits.append((0.0, energies[-1]) if outer.objective.collapses else _merit(outcome))
            if monitor.budget.is_over():
                break
        finite = [energy for energy in energies if np.isfinite(energy)]
        values = [value for _, value in merits]
        # ends with a value before those without
        best = min(range(len(ends)), key=lambda k: (not np.isfinite(values[k]), merits[k]))
        starts = {
            "start_seeds": tuple(seeds[: len(ends)]),
            "start_energies": tuple(map(plain, energies)),
            "start_spread": max(finite) - min(finite) if finite else None,
        }
        if not outer.objective.collapses:
            starts["start_values"] = tuple(map(plain, values))
        return ends[best].having(starts)


def _merit(outcome: Outcome) -> tuple[float, float]:
    """Violation and objective at the end of a run; NaN of an invalid mesh."""
    outer, q = outcome.outer, outcome.q
    return outer.merit(outer.function(q)) if outer.is_valid(q) else (0.0, float("nan"))
