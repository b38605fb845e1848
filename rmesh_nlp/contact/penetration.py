"""Penetration between contact nodes: gaps are imposed at nodes, and foundations may pass in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.contact.standoff import cells_of
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet


@dataclass(frozen=True)
class Penetration:
    """The largest negative gap on the cells of a contact set, as a positive length; 0 without.

    ``ratio`` is the largest one in units of the cell's edge; 0 where displacements have a unit of their own.
    """

    contact: ContactSet
    depth: float
    ratio: float


def penetrations(space: DisplacementSpace, nodes: Array, displacement: Array) -> list[Penetration]:
    """Those of all contact sets.

    ``nodes`` (2, vertices) are positions, ``displacement`` (components, nodes) coefficients.
    """
    body, result = Body(space.problem, nodes), []
    for part in space.contact_sets:
        depth = ratio = 0.0
        for cells in cells_of(body, space, part):
            depths = -np.min(cells.at_points(displacement), axis=1)
            depth = max(depth, float(np.max(depths, initial=0.0)))
            if space.problem.components == 2:
                length = np.linalg.norm(cells.points[:, :, -1] - cells.points[:, :, 0], axis=0)
                ratio = max(ratio, float(np.max(depths / length, initial=0.0)))
        result.append(Penetration(part, depth, ratio))
    return result
