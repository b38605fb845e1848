"""How near a relocated mesh comes to the best one of as many triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction, on_refined
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.recovery import Recovered, interpolation_error, second_derivatives
from rmesh_nlp.models.attainable import LeastErrors
from rmesh_nlp.solving.parts import Part
from rmesh_nlp.solving.solution import Assessment


@dataclass(frozen=True)
class Attained(Part):
    """By how much the best mesh of as many triangles as the last one has would lower the error of the energy.

    ``share_of_attainable`` is its error over that of the last mesh: 1 if that is the best one.
    """

    attainable_factor: float
    share_of_attainable: float


def attained(found: Assessment, reduction: ErrorReduction, finest: Admissible | None) -> Attained | None:
    """Both from second derivatives on the last mesh and on its refinement, extrapolated to fine meshes."""
    assert found.assessed is not None
    last = found.assessed[1]
    here, there = (_recovered(one) for one in (last, on_refined(last) if finest is None else finest))
    triangles = found.problem.triangles.shape[1]
    coarse, fine = (LeastErrors.of(*one, triangles).any_mesh for one in (here, there))
    error = interpolation_error(here[0], last.parts.problem.triangles, here[1])
    error = float(np.clip(error, *reduction.error))
    least = min(fine + max(fine - coarse, 0.0) / 3, error)
    return Attained((found.gain_audited + error) / least, least / error) if least > 0 else None


def _recovered(one: Admissible) -> tuple[Array, tuple[Recovered, ...]]:
    """Nodes (2, vertices) and second derivatives."""
    values = one.displacement[:, one.parts.space.number]
    return one.body.nodes, second_derivatives(one.problem, one.body.nodes, values)
