"""What relocation can gain, and the weight of a distortion in the energy relative to it.

``energy + w * distortion`` has a limit as the mesh is refined if ``w`` falls like the error of the energy:
then the best positions are a map of the domain that hardly depends on the mesh. So the weight is given as a
part of that error (:func:`gain_estimate`), which also makes one number suit every load and unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.error_reduction import on_refined
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError, ProblemError, unknown
from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.remeshing import Solved
from rmesh_nlp.optimize.status import Status

EXTRAPOLATION = 4 / 3
"""Error of the energy over its decrease by one uniform refinement, if the error falls by four."""


def gain_estimate(solver: ContactSolver) -> float:
    """Estimate the error of the continuous energy of the mesh as given, by two contact solves.

    It is the most that relocation can gain, and positive, as weights are made of it.

    Where the contact problem cannot be solved on the refined mesh, or its energy does not fall, the error of
    interpolation by recovered derivatives estimates it.
    """
    given = admissible(solver.discretisation, start=solver.given.active)
    refined = _refined(given)
    least = ROUNDING * max(abs(given.energy), 1e-300)
    if refined is not None and refined.status is Status.CONVERGED and refined.energy < given.energy:
        return max(EXTRAPOLATION * (given.energy - refined.energy), least)
    return max(Solved(solver, solver.given).error, least)


def _refined(given: Admissible) -> Admissible | None:
    try:
        return on_refined(given)
    except ProblemError:  # new nodes on a curve fold a thin element
        return None


def weights(regularisation: float | str | Sequence[float], name: str = "regularisation") -> tuple[float, ...]:
    """A schedule of relative weights, checked: positive and finite numbers, of which the last may be zero.

    A text has its numbers separated by commas.

    A BadInputError says what is wrong with one.
    """
    text = regularisation.split(",") if isinstance(regularisation, str) else regularisation
    given = text if isinstance(text, Sequence) else (text,)
    try:
        values = tuple(map(float, given))
    except (TypeError, ValueError):
        raise BadInputError(
            f"{name} must be a number or a list of numbers, got {regularisation!r}", name
        ) from None
    if not values or not all(np.isfinite(v) and v >= 0 for v in values) or 0 in values[:-1]:
        raise BadInputError(
            f"{name} must be positive and finite, and only its last value may be 0, got {regularisation!r}",
            name,
        )
    return values


def regularised(gain: float, weight: float, distortion: str = "shape-size") -> Objective:
    """``energy + weight * gain * distortion``; the energy alone if the weight is 0."""
    if distortion not in DISTORTIONS:
        raise unknown("distortion", distortion, DISTORTIONS)
    if weight == 0:
        return parse_objective("energy")
    return parse_objective(f"energy + {weight * gain:.6g}*{distortion}")
