"""The least errors of the energy that meshes of as many triangles have, from recovered derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.interpolation_error import best_shapes, isotropic_errors, least_errors
from rmesh_nlp.fem.metric import nodal_areas
from rmesh_nlp.fem.recovery import Recovered

SAMPLES = 100
"""Nodes at which the best triangles whatsoever are looked for; their mean is right within two percent."""


@dataclass(frozen=True)
class LeastErrors:
    """Errors of the energy.

    Attributes
    ----------
    any_mesh : float
        Of the best triangles whatsoever, as in a lattice made for each place.
    equilateral : float
        Of triangles that are equilateral in the best metric, which remeshing makes.
    isotropic : float
        Of equilateral triangles of the best sizes, which local refinement tends to.
    """

    any_mesh: float
    equilateral: float
    isotropic: float

    @staticmethod
    def of(nodes: Array, regions: Sequence[Recovered], triangles: float) -> LeastErrors:
        """Those of a number of triangles, for derivatives at nodes (2, vertices)."""
        totals, degree = np.sum([_roots(nodes, region) for region in regions], axis=0), regions[0].degree
        return LeastErrors(*(float(total) ** degree / triangles ** (degree - 1) for total in totals))


def _roots(nodes: Array, region: Recovered) -> tuple[float, float, float]:
    """Integrals of the root of ``phi`` over a region, for the three kinds of triangles."""
    law, derivatives, power = region.law, region.derivatives, 1 / region.degree
    areas = nodal_areas(nodes[:, region.nodes], region.triangles)
    stretch, angle, phi = best_shapes(law, derivatives)
    equilateral = areas * phi**power
    total = float(equilateral.sum())
    if total == 0:
        return 0.0, 0.0, 0.0
    # nodes that stand for equal parts of the integral
    parts = (np.arange(SAMPLES) + 0.5) / SAMPLES * total
    chosen = np.searchsorted(np.cumsum(equilateral), parts)
    chosen = np.minimum(chosen, areas.size - 1)
    least = least_errors(law, derivatives[:, :, chosen], stretch[chosen], angle[chosen])
    share = float(np.mean((least / phi[chosen]) ** power))
    return total * share, total, float(areas @ isotropic_errors(law, derivatives) ** power)
