"""No relocation: the contact problem on the mesh as given, the baseline of all comparisons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rmesh_nlp.contact import active_set
from rmesh_nlp.evaluation import Array
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step, Work


@dataclass(frozen=True)
class Fixed(Formulation):
    """Solves the contact problem on the mesh as given; start, seed and limits change nothing."""

    relocates: ClassVar[bool] = False

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        state = active_set.solve(outer.contact.system_at(np.zeros(outer.n)))
        monitor.work += Work(1, 1, state.iterations)
        nan, seconds = float("nan"), monitor.budget.elapsed
        step = Step(state.iterations, state.energy, 0.0, 0.0, nan, 1, seconds, energy_given=state.energy)
        monitor.note(step)
        return Outcome(outer, np.zeros(outer.n), state.status, label="")
