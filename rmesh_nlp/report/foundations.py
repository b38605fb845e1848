"""The rigid foundations of an elastic problem as lines to draw."""

from __future__ import annotations

from collections.abc import Sequence
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

LARGEST_DEFORMATION = 0.08
"""Displacements are magnified up to this part of the body's extent."""

SEEN = 0.003
"""Part of the body's extent that is about as wide as a line of a picture."""


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


def magnification(displacements: Sequence[Array], ways: Sequence[Array], extent: float) -> float:
    """The factor by which displacements are drawn: the largest of 1, 2, 5, 10, ... that pictures allow.

    A foundation is drawn as the curve that it is in space. Where the displacement is drawn ``f`` times as
    large, a node that touches, ``u = w``, is drawn at ``X + f w``, beside its place ``X + w`` on the
    foundation by ``(f - 1) w``. If ``w`` is the same for the whole boundary, the foundation is drawn
    displaced by that (:func:`displaced`), and touching nodes touch it. If the gap varies by more than
    ``SEEN`` there is no such place, and displacements are drawn as they are.

    Parameters
    ----------
    displacements : sequence of (2, nodes) array
    ways : sequence of (2, points) array
        From points of each contact boundary to the foundation, before any displacement.
    extent : float
        Of the body.
    """
    largest = max(float(np.max(np.abs(u))) for u in displacements)
    varies = max((float(np.max(np.abs(way.T - way.mean(axis=1)))) for way in ways if way.size), default=0.0)
    if largest == 0:
        return 1.0
    factor = 1.0
    for wanted in (step * 10.0**decade for decade in range(12) for step in (1, 2, 5)):
        if wanted * largest > LARGEST_DEFORMATION * extent or (wanted - 1) * varies > SEEN * extent:
            break
        factor = wanted
    return factor


def displaced(points: Array, way: Array, factor: float) -> Array:
    """A foundation (2, points), drawn beside a body whose displacement is ``factor`` times as large."""
    return points + (factor - 1) * way.reshape(2, -1).mean(axis=1).reshape(2, *[1] * (points.ndim - 1))
