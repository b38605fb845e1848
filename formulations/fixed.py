"""No relocation: the contact problem on the mesh as given, the baseline of all comparisons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rmesh_nlp.assessment.contact_results import contact_results
from rmesh_nlp.contact import active_set
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.errors import located
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import ByName
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step, Work


@dataclass(frozen=True)
class Fixed(Formulation):
    """Solves the contact problem on the mesh as given; start and seed change nothing."""

    relocates: ClassVar[bool] = False
    takes_steps: ClassVar[bool] = True

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        state, after = self._solved(outer, monitor), list[ByName]()
        for number, step in enumerate(outer.problem.steps, 2):
            if state.status is not Status.CONVERGED:
                break
            after.append(_carried(outer, state))
            origin = outer.contact.displacement.values(state.u)
            with located(f"load step {number}"):
                outer = Outer.of(outer.problem.after(step, origin), outer.objective, outer.tolerance)
                state = self._solved(outer, monitor)
        details = {"steps": [*after, _carried(outer, state)]} if after else {}
        return Outcome(outer, np.zeros(outer.n), state.status, label="", details=details)

    def _solved(self, outer: Outer, monitor: Monitor) -> Equilibrium:
        state = active_set.solve(outer.contact.given_system)
        monitor.work += Work(1, 1, state.iterations)
        energy = state.energy
        monitor.note(
            Step(state.iterations, energy, 0.0, 0.0, np.nan, 1, monitor.budget.elapsed, energy_given=energy)
        )
        return state


def _carried(outer: Outer, state: Equilibrium) -> dict[str, dict[str, float]]:
    """What each contact boundary carries, by the names of the record."""
    results = contact_results(
        outer.discretisation.space, outer.problem.mesh.p, outer.contact.given_system, state
    )
    return {
        name: {key: of for key, of in vars(result).items() if of is not None}
        for name, result in results.items()
    }
