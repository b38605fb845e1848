"""How near a relocated mesh comes to the best one of as many triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.fem.recovery import interpolation_error, recovered
from rmesh_nlp.models.attainable import LeastErrors


@dataclass(frozen=True)
class Attained:
    """By how much the best mesh of as many triangles as the last one has would lower the error of the energy.

    ``share_of_attainable`` is its error over that of the last mesh: 1 if that is the best one.
    """

    attainable_factor: float
    share_of_attainable: float


def attained(
    gain: float, reduction: ErrorReduction, last: Admissible, finest: Admissible | None
) -> Attained | None:
    """Both from derivatives on the refined last mesh, on the last one itself where none was refined.

    ``gain`` is the decrease of the audited energy. The error of the last mesh is that of interpolation,
    within the bounds that are known.
    """
    fine = last if finest is None else finest
    triangles, refined = last.problem.triangles.shape[1], fine.problem.triangles
    nodes = fine.body.nodes
    regions = recovered(fine.parts.space, nodes, fine.displacement)
    times = (refined.shape[1] / triangles) ** last.problem.order  # how the error falls
    error = float(np.clip(times * interpolation_error(nodes, refined, regions), *reduction.error))
    least = min(LeastErrors.of(nodes, regions, triangles).any_mesh, error)
    return Attained((gain + error) / least, least / error) if least > 0 else None
