"""A regularisation: a schedule of weights of a distortion, each solved from where the last one ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.regularisation import regularised, weights
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer


@dataclass(frozen=True)
class Schedule(Wrapper):
    """Minimises the energy with a distortion in the place of area constraints.

    Attributes
    ----------
    weights : float, str or tuple of float
        Of the distortion, relative to the error of the energy on the mesh as given; the last may be 0. 0.01
        suits most problems without move limits.
    distortion : str
        "quality", "shape-size" or "elastic", see :mod:`rmesh_nlp.fem.distortion`.
    """

    weights: float | str | tuple[float, ...] = (1.0, 0.1, 0.01)
    distortion: str = "shape-size"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "weights", weights(self.weights))
        regularised(1.0, 1.0, self.distortion)

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        if not objective.is_energy:
            raise BadInputError(
                f"regularisation is relative to the error of the energy, not of {objective.text}: "
                f"write the weight into the objective, such as {objective.text} + 0.01*{self.distortion}"
            )

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        schedule, gain = weights(self.weights), monitor.estimate(outer)
        for weight in schedule:
            with monitor.budget.during("build"):
                objective = regularised(gain, weight, self.distortion)
                weighted = outer.minimising(objective, gain)
            outcome = monitor.run(self.inner, weighted, q)
            q = outcome.q
            if monitor.budget.is_over():
                break
        relative = list(schedule) if len(schedule) > 1 else schedule[0]
        return outcome.having(weights_of(relative, self.distortion, schedule[-1], gain))


def weights_of(relative: float | list[float], distortion: str, last: float, gain: float) -> dict[str, Any]:
    """Entries of the record: weights relative to the estimated error ``gain``, the last one by itself too."""
    return {
        "regularisation": relative,
        "distortion": distortion,
        "regularisation_weight": last * gain,
        "gain_estimate": gain,
    }
