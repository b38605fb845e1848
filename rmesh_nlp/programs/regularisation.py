"""The weight of a distortion in the energy, relative to what relocation can gain.

``energy + w * distortion`` has a limit as the mesh is refined if ``w`` falls like the error of the energy:
then the best moves are a map of the domain that hardly depends on the mesh. So the weight is given as a
part of that error, which also makes one number suit every load and unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.penetration import penetration_work_of
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.levels import refined

EXTRAPOLATION = 4 / 3
"""Error of the energy over its decrease by one uniform refinement, if the error falls by four."""

LEAST_GAIN = 1e-9
"""Least error of the energy, in parts of the energy, that a weight is made of."""

LEAST_DEGREE = 6
"""Least degree of the rule with which the error is estimated."""


@dataclass(frozen=True)
class GainEstimate:
    """What moving nodes can gain at most, by one uniform refinement.

    Attributes
    ----------
    energy, energy_refined : float
        On the mesh, and on its uniform refinement, each with what penetration between contact nodes is worth.
    value : float
        Estimated error of the energy of the mesh, positive.
    """

    energy: float
    energy_refined: float
    value: float


def gain_estimate(problem: ContactProblem) -> GainEstimate:
    """Estimate the error of the energy of the mesh as given, with an accurate rule, by two contact solves.

    Over a curved foundation gaps hold at nodes only, and on a coarse mesh the energy can be far too low: it
    may even rise by refinement. So what penetration is worth to first order is added to both energies.
    """
    rule = problem.rule
    accurate = replace(problem, quadrature=max(rule, LEAST_DEGREE) if isinstance(rule, int) else LEAST_DEGREE)
    fine = refined(accurate, polygon=True)
    here, there = _without_penetration(accurate), _without_penetration(fine)
    floor = LEAST_GAIN * max(abs(here), abs(there), 1e-300)
    return GainEstimate(here, there, max(EXTRAPOLATION * (here - there), floor))


def _without_penetration(problem: ContactProblem) -> float:
    model = ContactModel(problem)
    state = model.solve(problem.mesh.p)
    return state.energy + penetration_work_of(model, np.asarray(problem.mesh.p), state)


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
