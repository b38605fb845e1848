"""The rigid foundations of an elastic problem as lines to draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import contact_edges
from rmesh_nlp.problem import ContactProblem

FAR = 1.0
"""Part of the extent of the body beyond which a foundation is not drawn."""

POINTS = 9
"""Points of a foundation below one contact edge."""


@dataclass(frozen=True)
class Foundation:
    """What one contact boundary may meet.

    Attributes
    ----------
    name : str
        Name of the contact boundary.
    nodes : (contact nodes,) int array
    gaps : (contact nodes,) array
        Before any displacement; negative where the foundation overlaps the body.
    feet : (2, contact nodes) array
        The points of the foundation that the nodes would meet.
    lines : (2, edges, points) array
        The foundation below each contact edge.
    starts : (2, edges, points) array
        The points of the contact edges that it is below of.
    is_far : bool
        Whether it is too far off to be drawn with the body.
    """

    name: str
    nodes: NDArray[np.int64]
    gaps: Array
    feet: Array
    lines: Array
    starts: Array
    is_far: bool


def foundations(problem: ContactProblem, nodes: Array) -> list[Foundation]:
    """The foundations for node positions (2, nodes); none for scalar problems."""
    if problem.components == 1:
        return []
    found = []
    extent = float(np.max(np.ptp(nodes, axis=1)))
    for part in problem.contact_sets:
        edges = contact_edges(problem, part.obstacle)
        t = np.linspace(0, 1, POINTS)
        points = np.einsum("cve,vk->cek", nodes[:, edges], np.stack([1 - t, t]))
        lines = part.obstacle.feet(points.reshape(2, -1)).reshape(points.shape)
        gaps = part.obstacle.distances(nodes[:, part.nodes])
        feet = part.obstacle.feet(nodes[:, part.nodes])
        far = bool(np.min(np.abs(gaps)) > FAR * extent)
        found.append(Foundation(str(part.obstacle.boundary), part.nodes, gaps, feet, lines, points, far))
    return found
