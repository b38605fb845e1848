"""Penetration between contact nodes: gaps are imposed at nodes, and foundations may pass in between."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.contact.standoff import cells_of
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body


def penetration(space: DisplacementSpace, nodes: Array, displacement: Array) -> float:
    """Largest negative gap on the contact edges or triangles, as a positive length; 0 without.

    ``nodes`` (2, vertices) are positions, ``displacement`` (components, nodes) coefficients.
    """
    body = Body(space.problem, nodes)
    every = (cells for part in space.contact_sets for cells in cells_of(body, space, part))
    return max((float(np.max(cells.depths(displacement), initial=0.0)) for cells in every), default=0.0)
