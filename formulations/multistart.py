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
        ends: list[tuple[float, Outcome]] = []
        seeds: list[int | None] = [None, *range(1, self.starts + 1)]
        for seed in seeds:
            outcome = monitor.run(self.inner, outer, q if seed is None else outer.variables(seed=seed))
            ends.append((continuous_energy(outcome), outcome))
            if monitor.budget.is_over():
                break
        energies = [energy for energy, _ in ends]
        collapses = outer.objective.collapses
        merits = [(0.0, e) for e in energies] if collapses else [_merit(outcome) for _, outcome in ends]
        values = energies if collapses else [value for _, value in merits]
        finite = [energy for energy in energies if np.isfinite(energy)]
        best = min(zip(map(_known_first, merits), range(len(ends)), strict=True))[1]
        starts = {
            "start_seeds": tuple(seeds[: len(ends)]),
            "start_energies": _finite(energies),
            "start_spread": max(finite) - min(finite) if finite else None,
            **({} if values is energies else {"start_values": _finite(values)}),
        }
        return ends[best][1].having(starts)


def _finite(values: list[float]) -> tuple[float | None, ...]:
    return tuple(value if np.isfinite(value) else None for value in values)


def _merit(outcome: Outcome) -> tuple[float, float]:
    """Violation and objective at the end of a run; NaN of an invalid mesh."""
    outer, q = outcome.outer, outcome.q
    return outer.merit(outer.function(q)) if outer.is_valid(q) else (0.0, float("nan"))


def _known_first(merit: tuple[float, float]) -> tuple[bool, tuple[float, float]]:
    """Ends with a value before those without."""
    return not np.isfinite(merit[1]), merit
