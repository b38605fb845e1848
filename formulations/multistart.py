"""Several starts of one formulation: the best end."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        ends: list[tuple[float, Outcome]] = []
        seeds: list[int | None] = [None, *range(1, self.starts + 1)]
        for seed in seeds:
            found = monitor.run(self.inner, outer, q if seed is None else outer.moves(seed=seed))
            ends.append((continuous_energy(found), found))
            if monitor.is_over():
                break
        energies = [energy for energy, _ in ends]
        values = energies if outer.objective.collapses else [_value(found) for _, found in ends]
        known = [energy for energy in energies if np.isfinite(energy)]
        best = ends[int(np.nanargmin(values))][1] if known else ends[0][1]
        details = {
            "start_seeds": seeds[: len(ends)],
            "start_energies": [energy if np.isfinite(energy) else None for energy in energies],
            "start_spread": max(known) - min(known) if known else None,
        }
        if values is not energies:
            details["start_values"] = [value if np.isfinite(value) else None for value in values]
        return replace(best, details={**best.details, **details})


def _value(found: Outcome) -> float:
    """The objective at the end of a run; NaN of an invalid mesh."""
    return float(found.outer.function(found.q).value) if found.outer.is_valid(found.q) else float("nan")
