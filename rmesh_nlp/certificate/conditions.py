"""What a problem asks for on the edges of a mesh: given displacements, tractions, contact.

On every edge the tractions of the elements beside it must add up to

    g + p n + q t + R,

g the given traction, p >= 0 the contact pressure along the obstacle's normal n, |q| <= s friction along its
tangent t, and R the reaction in those components whose displacement is given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.integrals import Integrals, integrals, values_at
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Obstacle, Place

Mask = NDArray[np.bool_]

SAMPLE_POINTS = np.stack([np.linspace(1, 0, 33), np.linspace(0, 1, 33)])
"""Barycentric coordinates (2, 33) of the points of an edge at which coefficients are looked at."""

DEVIATION = 1e-12
"""Deviations relative to the values themselves that count as none."""


class NotCertifiableError(ValueError):
    """No certificate is known for this kind of problem; the message says which kind."""


@dataclass(frozen=True)
class ContactPart:
    """The edges of one obstacle on the boundary.

    Attributes
    ----------
    obstacle : Obstacle
    edges : (edges of this part,) int array
    place : slice
        Where they stand among all contact edges.
    """

    obstacle: Obstacle
    edges: NDArray[np.int64]
    place: slice


@dataclass(frozen=True)
class Conditions:
    """Boundary and contact conditions on all edges of a mesh.

    Arrays run over the edges in their last axis; 2 stands for the ends of an edge. Moments are
    integrals against the linear functions of the ends, divided by the length.

    Attributes
    ----------
    held : (components, edges) bool array
        Where the displacement is given.
    given : (components, 2, edges) array
        Moments of the given displacement.
    given_doubt, given_error : float
        Largest doubt of these by quadrature, and largest distance of the given displacement from its
        linear interpolation, both relative to the largest moment.
    traction : (components, 2, edges) array
        Moments of the given traction.
    traction_oscillation : (edges,) array
        L2 norm over the edge of the traction less its best linear approximation.
    traction_doubt : (components, 2, edges) array
        Doubt of ``traction`` by quadrature.
    contact : (edges,) int array
        Numbers of the contact edges; the arrays below run over these.
    offset : (2, contact edges) array
        Moments of the initial gap.
    offset_doubt : (2, contact edges) array
    friction : (2, contact edges) array
        Values at the ends of a linear function that nowhere exceeds the friction bound.
    axes : (contact edges, components, components) array
        Rows: the obstacle's tangent and normal, or the normal alone in a scalar problem.
    parts : tuple of ContactPart
        The contact edges obstacle by obstacle.
    """

    held: Mask
    given: Array
    given_doubt: float
    given_error: float
    traction: Array
    traction_oscillation: Array
    traction_doubt: Array
    contact: NDArray[np.int64]
    offset: Array
    offset_doubt: Array
    friction: Array
    axes: Array
    parts: tuple[ContactPart, ...]


def conditions_of(problem: ContactProblem, skeleton: Skeleton) -> Conditions:
    """The conditions of a problem on its mesh at the given positions.

    Raises
    ------
    NotCertifiableError
        For contact that tractions linear on edges cannot express.
    """
    supports, loads = _given_displacement(problem, skeleton), _tractions(problem, skeleton)
    parts = _contact_parts(problem, supports[0])
    contact = np.concatenate([np.zeros(0, dtype=np.int64), *(part.edges for part in parts)])
    n = problem.components
    offset, offset_doubt, friction = np.zeros((3, 2, contact.size))
    axes = np.zeros((contact.size, n, n))
    for part in parts:
        corners, obstacle = skeleton.nodes[:, skeleton.ends[:, part.edges]], part.obstacle
        gap = integrals(obstacle.offset, corners)
        offset[:, part.place], offset_doubt[:, part.place] = gap.moments, gap.doubt
        friction[:, part.place] = _linear_below(values_at(obstacle.friction, corners, SAMPLE_POINTS))
        rows = (obstacle.tangent, obstacle.normal) if n == 2 else (obstacle.normal,)
        axes[part.place] = np.array(rows)
    return Conditions(*supports, *loads, contact, offset, offset_doubt, friction, axes, parts)


def _given_displacement(problem: ContactProblem, skeleton: Skeleton) -> tuple[Mask, Array, float, float]:
    n, count = problem.components, skeleton.ends.shape[1]
    held, given = np.zeros((n, count), dtype=bool), np.zeros((n, 2, count))
    doubt = error = 0.0
    for support in problem.supports:
        edges = np.unique(problem.mesh.boundaries[support.boundary])
        corners = skeleton.nodes[:, skeleton.ends[:, edges]]
        for i, coefficient in enumerate(support.value):
            if coefficient is None:
                continue
            part = integrals(coefficient, corners)
            samples = values_at(coefficient, corners, SAMPLE_POINTS)
            held[i, edges], given[i][:, edges] = True, part.moments
            doubt = max(doubt, float(np.max(part.doubt, initial=0.0)))
            bend = np.abs(samples - SAMPLE_POINTS.T @ samples[[0, -1]])
            error = max(error, float(np.max(bend, initial=0.0)))
    scale = max(float(np.max(np.abs(given), initial=0.0)), 1e-300)
    return held, given, doubt / scale, error / scale


def _tractions(problem: ContactProblem, skeleton: Skeleton) -> tuple[Array, Array, Array]:
    n, count = problem.components, skeleton.ends.shape[1]
    traction, doubt = np.zeros((2, n, 2, count))
    oscillation = np.zeros(count)
    for load in problem.tractions:
        edges = np.unique(problem.mesh.boundaries[load.boundary])
        corners = skeleton.nodes[:, skeleton.ends[:, edges]]
        square = np.zeros(edges.size)
        for i, coefficient in enumerate(load.value):
            part = integrals(coefficient, corners)
            traction[i][:, edges] += part.moments
            doubt[i][:, edges] += part.doubt
            if callable(coefficient):
                square += _remainder(part)
        oscillation[edges] += np.sqrt(square * skeleton.lengths[edges])
    return traction, oscillation, doubt


def _remainder(part: Integrals) -> Array:
    """Mean square over each edge of a function less its best linear approximation."""
    ends = linear_values(part.moments)
    return np.asarray(np.maximum(part.square - np.sum(ends * part.moments, axis=0), 0.0))


def linear_values(moments: Array) -> Array:
    """Values at the ends (2, ...) of the linear function with these moments: the L2 projection."""
    return np.stack([4 * moments[0] - 2 * moments[1], 4 * moments[1] - 2 * moments[0]])


def _contact_parts(problem: ContactProblem, held: Mask) -> tuple[ContactPart, ...]:
    """Of each boundary with contact the edges on which the gap is not given beforehand."""
    parts: list[ContactPart] = []
    seen = np.zeros(held.shape[1], dtype=bool)
    first = 0
    for obstacle in problem.obstacles:
        if isinstance(obstacle.boundary, Place):
            continue
        if obstacle.level is not None:
            raise NotCertifiableError("the normal of a curved foundation turns along an edge")
        normal = np.array(obstacle.normal) != 0
        edges = np.unique(problem.mesh.boundaries[obstacle.boundary])
        edges = edges[np.any(~held[:, edges] & normal[:, None], axis=0)].astype(np.int64)
        if np.any(seen[edges]):
            raise NotCertifiableError("an edge is in contact with two obstacles")
        if np.all(normal) and held.shape[0] == 2 and np.any(held[:, edges]):
            raise NotCertifiableError(
                "a displacement component is given on a contact edge whose contact normal is oblique"
            )
        seen[edges] = True
        parts.append(ContactPart(obstacle, edges, slice(first, first + edges.size)))
        first += edges.size
    return tuple(parts)


def _linear_below(samples: Array) -> Array:
    """Ends (2, edges) of linear functions below the samples (points, edges), as high as these allow."""
    if samples.shape[1] == 0:
        return np.zeros((2, 0))
    ends = samples[[0, -1]]
    excess = np.max(SAMPLE_POINTS.T @ ends - samples, axis=0)
    scale = DEVIATION * np.max(np.abs(samples), axis=0)
    return np.asarray(np.maximum(ends - np.where(excess > scale, excess, 0.0), 0.0))
