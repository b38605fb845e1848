"""What a problem asks for on the edges of a mesh: given displacements, tractions, contact.

On every edge the tractions of the elements beside it must add up to

    g + p n + q t + R,

g the given traction, p >= 0 the contact pressure along the obstacle's normal n, |q| <= s friction along its
tangent t, and R the reaction in those components whose displacement is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rmesh_nlp.assessment.parts import PROVED, edge_parts
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.fields import element_of
from rmesh_nlp.certificate.integrals import Loads, integrals, tractions
from rmesh_nlp.certificate.polynomials import lowered, powers
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude, numbers_of
from rmesh_nlp.fem.bernstein import functions, to_coefficients
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.body import Edges
from rmesh_nlp.problem.coefficients import Coefficient, on_points

SAMPLE_POINTS = np.stack([np.linspace(1, 0, 33), np.linspace(0, 1, 33)])
"""Barycentric coordinates (2, 33) of the points of an edge at which coefficients are looked at."""


class ContactPart(NamedTuple):
    """The edges of one obstacle on the boundary, and where they stand among all contact edges."""

    obstacle: Obstacle
    edges: Index
    place: slice


class Inside(NamedTuple):
    """An obstacle in the interior; moments are against the polynomials of the field's degree on elements."""

    sign: float  # 1 for an obstacle below, -1 above
    elements: Index  # (m,), those where it is: all of them, or none
    offset: Array  # (functions, m), moments of the gap without displacement
    offset_doubt: Array  # (functions, m)


@dataclass(frozen=True)
class Conditions:
    """Boundary and contact conditions on all edges of a mesh.

    Arrays run over the edges in their last axis; k stands for Bernstein's polynomials along an edge, of the
    degree of the forces through it. Moments are integrals against these, divided by the length.
    """

    held: Mask  # (components, edges), where the displacement is given
    given: Array  # (components, k, edges), moments of the given displacement
    given_doubt: float  # largest doubt of these by quadrature, relative to the largest moment
    given_error: float  # largest distance from what displacements interpolate, relative to the same
    traction: Loads
    contact: Index  # (contact edges,), their numbers; the arrays below run over these
    offset: Array  # (k, contact edges), moments of the initial gap
    offset_doubt: Array  # (k, contact edges)
    friction: Array  # (k, contact edges), a function that nowhere exceeds the friction bound; 0 for a scalar
    axes: Array  # (contact edges, components, components), rows: the obstacle's tangent, if any, and normal
    parts: tuple[ContactPart, ...]  # the contact edges obstacle by obstacle
    inside: Inside
    is_certain: bool  # whether it is known where the data jump and kink

    @property
    def degree(self) -> int:
        """Of the forces through the edges."""
        return self.given.shape[1] - 1


def conditions_of(problem: ContactProblem, skeleton: Skeleton) -> Conditions:
    """The conditions of a problem on its mesh at the given positions.

    Raises NotCertifiableError for contact that tractions linear on edges cannot express.
    """
    degree, n = element_of(problem).pieces.degree, problem.components
    held, given, given_doubt, given_error, is_certain = _given_displacement(problem, skeleton, degree)
    traction, inside, inside_is_certain = tractions(problem, skeleton), *_inside(problem, skeleton, degree)
    is_certain &= traction.is_certain and inside_is_certain
    parts = _contact_parts(problem, held)
    contact = numbers_of(part.edges for part in parts)
    offset, offset_doubt, friction = np.zeros((3, degree + 1, contact.size))
    axes = np.zeros((contact.size, n, n))
    for part in parts:
        obstacle = part.obstacle
        gap = integrals(obstacle.offset, skeleton, part.edges, 2, problem.order)
        offset[:, part.place] = lowered(gap.moments, degree)
        offset_doubt[:, part.place] = lowered(gap.doubt, degree)
        is_certain &= gap.is_certain
        if n == 2:
            edges = Edges(skeleton.body, part.edges)
            below, known = _linear_below(obstacle.friction, edges)
            friction[:, part.place] = functions(1, powers(degree, 2).T / degree).T @ below
            is_certain &= known
        axes[part.place] = np.array([obstacle.tangent, obstacle.normal] if n == 2 else [obstacle.normal])
    supports, gaps = (held, given, given_doubt, given_error), (offset, offset_doubt, friction, axes)
    return Conditions(*supports, traction, contact, *gaps, parts, inside, is_certain)


def _given_displacement(
    problem: ContactProblem, skeleton: Skeleton, degree: int
) -> tuple[Mask, Array, float, float, bool]:
    n, count = problem.components, skeleton.ends.shape[1]
    held, given = np.zeros((n, count), dtype=bool), np.zeros((n, degree + 1, count))
    doubt, error, is_certain = 0.0, 0.0, True
    for support in problem.supports:
        edges = np.unique(problem.mesh.boundaries[support.boundary])
        for i, coefficient in enumerate(support.value):
            if coefficient is None:
                continue
            part = integrals(coefficient, skeleton, edges, 2, problem.order)
            held[i, edges], given[i][:, edges] = True, lowered(part.moments, degree)
            samples = _samples(coefficient, Edges(skeleton.body, edges))
            at_nodes = samples[[0, -1, len(samples) // 2][: problem.order + 1]]
            shares = functions(problem.order, SAMPLE_POINTS).T @ to_coefficients(problem.order, 2)
            doubt = np.max(part.doubt, initial=doubt)
            error = np.max(np.abs(samples - shares @ at_nodes), initial=error)
            is_certain &= part.is_certain
    scale = max(magnitude(given), 1e-300)
    return held, given, doubt / scale, error / scale, is_certain


def _inside(problem: ContactProblem, skeleton: Skeleton, degree: int) -> tuple[Inside, bool]:
    obstacles = [obstacle for obstacle in problem.obstacles if obstacle.boundary is Place.INTERIOR]
    (sign, offset), *rest = [(obstacle.normal[0], obstacle.offset) for obstacle in obstacles] or [(0.0, 0.0)]
    if rest:
        raise NotCertifiableError("there are two obstacles in the interior")
    elements = np.arange(skeleton.areas.size if obstacles else 0)
    gap = integrals(offset, skeleton, elements, 3, degree)
    return Inside(sign, elements, gap.moments, gap.doubt), gap.is_certain


def _contact_parts(problem: ContactProblem, held: Mask) -> tuple[ContactPart, ...]:
    """Of each boundary with contact the edges on which the gap is not given beforehand."""
    parts: list[ContactPart] = []
    seen = np.zeros(held.shape[1], dtype=bool)
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
        first = int(np.count_nonzero(seen))
        seen[edges] = True
        parts.append(ContactPart(obstacle, edges, slice(first, first + edges.size)))
    return tuple(parts)


def _samples(coefficient: Coefficient, edges: Edges) -> Array:
    """(points, edges) values at the ``SAMPLE_POINTS`` of edges."""
    s = np.broadcast_to(SAMPLE_POINTS[1], (edges.size, SAMPLE_POINTS.shape[1]))
    return on_points(coefficient, edges.at(np.arange(edges.size), s)[0]).T


def _linear_below(friction: Coefficient, edges: Edges) -> tuple[Array, bool]:
    """Ends (2, edges) of linear functions below a friction bound on edges, as high as samples allow.

    On an edge where the bound jumps or kinks it is a constant. The second value says whether it is known
    where it does.
    """
    samples = _samples(friction, edges)
    ends = samples[[0, -1]]
    excess = np.max(SAMPLE_POINTS.T @ ends - samples, axis=0)
    scale = PROVED * np.max(np.abs(samples), axis=0)
    ends = np.maximum(ends - np.where(excess > scale, excess, 0.0), 0.0)
    parts = edge_parts(edges, (friction,))
    inner = ROUNDING * (parts.end - parts.begin)
    s = np.stack([parts.begin + inner, parts.end - inner], axis=1)
    values = on_points(friction, edges.at(parts.owner, s)[0])
    least = np.min(samples, axis=0)
    np.minimum.at(least, parts.owner, np.min(values, axis=1))
    is_split = np.bincount(parts.owner, minlength=least.size) > 1
    return np.where(is_split, np.maximum(least, 0.0), ends), parts.is_certain
