"""The weight of a distortion in the energy, relative to what relocation can gain.

``energy + w * distortion`` has a limit as the mesh is refined if ``w`` falls like the error of the energy:
then the best moves are a map of the domain that hardly depends on the mesh. So the weight is given as a
part of that error, which also makes one number suit every load and unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.errors import BadInputError, ProblemError
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.refinement import edge_gains
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined

EXTRAPOLATION = 4 / 3
"""Error of the energy over its decrease by one uniform refinement, if the error falls by four."""

LEAST_GAIN = 1e-9
"""Least error of the energy, in parts of the energy, that a weight is made of."""


@dataclass(frozen=True)
class GainEstimate:
    """What moving nodes can gain at most, by one uniform refinement.

    Attributes
    ----------
    energy, energy_refined : float
        Of the continuous problem on the mesh, and on its uniform refinement.
    value : float
        Estimated error of the energy of the mesh, positive.
    """

    energy: float
    energy_refined: float
    value: float


ESTIMATE_SOLVES = 2
"""Contact solves of an estimate."""


def gain_estimate(problem: ContactProblem) -> GainEstimate:
    """Estimate the error of the continuous energy of the mesh as given, by two contact solves.

    Where the contact problem cannot be solved on the refined mesh, or its energy does not fall, the gains of
    new nodes on edges estimate it.
    """
    here, there = admissible(problem), _refined(problem)
    floor = LEAST_GAIN * max(abs(here.energy), 1e-300)
    if there is not None and there.status is Status.CONVERGED and there.energy < here.energy:
        return GainEstimate(
            here.energy, there.energy, max(EXTRAPOLATION * (here.energy - there.energy), floor)
        )
    gain = float(edge_gains(problem).sum())
    return GainEstimate(here.energy, here.energy - gain, max(gain, floor))


def _refined(problem: ContactProblem) -> Admissible | None:
    try:
        return admissible(refined(problem))
    except ProblemError:  # new nodes on a curve fold a thin element
        return None


def weights(regularisation: float | str | Sequence[float], name: str = "regularisation") -> tuple[float, ...]:
    """A schedule of relative weights, checked: positive and finite numbers, of which the last may be zero.

    A text has its numbers separated by commas.

    Raises
    ------
    BadInputError
        If it is none.
    """
    text = regularisation.split(",") if isinstance(regularisation, str) else regularisation
    given = text if isinstance(text, Sequence) else (text,)
    try:
        values = tuple(float(value) for value in given)
    except (TypeError, ValueError):
        raise BadInputError(f"{name} must be a number or a list of numbers, got {regularisation!r}") from None
    if not values or not all(np.isfinite(v) and v >= 0 for v in values) or 0 in values[:-1]:
        raise BadInputError(
            f"{name} must be positive and finite, and only its last value may be 0, got {regularisation!r}"
        )
    return values


def regularised(gain: float, weight: float, distortion: str = "shape-size") -> Objective:
    """``energy + weight * gain * distortion``; the energy alone if the weight is 0.

    Raises
    ------
    BadInputError
        If the distortion is unknown.
    """
    if distortion not in DISTORTIONS:
        raise BadInputError(f"unknown distortion {distortion!r}: choose from {', '.join(DISTORTIONS)}")
    if weight == 0:
        return parse_objective("energy")
    return parse_objective(f"energy + {weight * gain:.6g}*{distortion}")
