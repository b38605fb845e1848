"""What a problem asks for on the edges of a mesh: given displacements, tractions, contact.

On every edge the tractions of the elements beside it must add up to

    g + p n + q t + R,

g the given traction, p >= 0 the contact pressure along the obstacle's normal n, |q| <= s friction along its
tangent t, and R the reaction in those components whose displacement is given. The other edge of a pair has
the opposite of p n + q t, and a tool on which the force F acts the integral of it: that of p n + q t is F in
each component along which the tool moves. Where n turns along an edge the field balances the best
approximation of p n + q t by polynomials of its degree, as it does of loads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rmesh_nlp.assessment.integrals import RULES, over_edges
from rmesh_nlp.assessment.parts import Parts, edge_parts, refined, triangle_parts
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.integrals import Loads, integrals, tractions
from rmesh_nlp.certificate.polynomials import powers, projection
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.standoff import LATTICES, SAMPLES
from rmesh_nlp.errors import located
from rmesh_nlp.evaluation import PROVED, Array, Index, Mask, magnitude, numbers_of
from rmesh_nlp.fem.bernstein import functions, to_coefficients
from rmesh_nlp.meshes.geometry import lengths
from rmesh_nlp.problem import ContactProblem, Obstacle, Place
from rmesh_nlp.problem.body import Edges
from rmesh_nlp.problem.coefficients import Coefficient, on_points, product
from rmesh_nlp.problem.enclosures import resolved
from rmesh_nlp.problem.pairs import edges_of_pair

SAMPLED = np.clip(np.linspace([1, 0], [0, 1], 33, axis=1), PROVED, 1 - PROVED)
"""Barycentric coordinates (2, 33) on a piece of an edge at which coefficients are looked at."""


class ContactPart(NamedTuple):
    """The edges of one obstacle on the boundary, and where they stand among all contact edges."""

    number: int
    obstacle: Obstacle
    edges: Index
    place: slice
    others: Index  # of a pair the edge at the place of each
    reversed: Mask  # whether that has its ends the other way round


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
    coulomb: Array  # (k, contact edges), Coulomb's coefficient
    axes: Array  # (contact edges, k, components, k, components), moments along tangent, if any, and normal
    axes_doubt: Array  # (k, contact edges), what these may be wrong by on a displacement of size 1
    parts: tuple[ContactPart, ...]  # the contact edges obstacle by obstacle
    inside: Inside
    is_certain: bool  # whether it is known where the data jump and kink


def conditions_of(problem: ContactProblem, skeleton: Skeleton) -> Conditions:
    """The conditions of a problem on its mesh at the given positions.

    Raises NotCertifiableError for contact that tractions linear on edges cannot express.
    """
    order, n = problem.order, problem.components
    held, given, given_doubt, given_error, is_certain = _given_displacement(problem, skeleton)
    traction = tractions(problem, skeleton, problem.tractions)
    inside, inside_is_certain = _inside(problem, skeleton)
    is_certain &= traction.is_certain and inside_is_certain
    parts = _contact_parts(problem, skeleton, held)
    contact = numbers_of(part.edges for part in parts)
    offset, offset_doubt, friction, coulomb, axes_doubt = np.zeros((5, order + 1, contact.size))
    axes = np.zeros((contact.size, order + 1, n, order + 1, n))
    for part in parts:
        obstacle = part.obstacle
        edges = Edges(skeleton.body, part.edges)
        with located(f"the obstacle on {obstacle.boundary!r}"):
            gap = integrals(obstacle.clearance, skeleton, part.edges, 2)
            is_certain &= gap.is_certain and is_seen(obstacle.clearance, edges)
            if n == 2:
                below, known = _linear_below(product(problem.measure, obstacle.friction_law.given), edges)
                friction[:, part.place] = functions(1, powers(order, 2).T / order).T @ below
                coulomb[:, part.place] = _at_nodes(obstacle.friction_law.slope, skeleton, part.edges)
                is_certain &= known
            axes[part.place], axes_doubt[:, part.place], known = _axes(obstacle, edges, order)
            is_certain &= known
        offset[:, part.place], offset_doubt[:, part.place] = gap.moments, gap.doubt
    supports, gaps = (held, given, given_doubt, given_error), (offset, offset_doubt, friction, coulomb)
    return Conditions(*supports, traction, contact, *gaps, axes, axes_doubt, parts, inside, is_certain)


def _axes(obstacle: Obstacle, edges: Edges, order: int) -> tuple[Array, Array, bool]:
    """Axes and their doubt on edges, as in :class:`Conditions`, and whether nothing of a normal hides."""
    k = order + 1
    if obstacle.level is None:
        along = np.multiply.outer(obstacle.normal, np.repeat(np.eye(k)[..., None], edges.size, axis=2))
        doubt, is_certain = np.zeros((k, edges.size)), True
    else:

        def tested(_: Index, shares: Array, where: Array, weights: Array) -> Array:
            phi, unit = functions(order, shares), weights / edges.body.problem.measured(where)
            sums = np.einsum("jmp,lmp,cmp,mp->cjlm", phi, phi, obstacle.normals(where), unit)
            return sums.reshape(-1, len(unit))

        directions = tuple(lambda x, y, c=c: obstacle.direction(x, y)[c] for c in range(2))
        sums = over_edges(edges, tested, directions)
        along, doubt = (
            part.reshape(2, k, k, -1) / lengths(edges.body.nodes, edges.ends)
            for part in (sums.value, sums.doubt)
        )
        along, doubt, is_certain = projection(along, 2), np.sum(doubt, axis=(0, 2)), sums.is_certain
    each = np.stack([[along[1], -along[0]], along]) if len(along) == 2 else along[None]
    return each.transpose(4, 2, 0, 3, 1), doubt, is_certain


def _given_displacement(
    problem: ContactProblem, skeleton: Skeleton
) -> tuple[Mask, Array, float, float, bool]:
    n, order, count = problem.components, problem.order, skeleton.ends.shape[1]
    held, given = np.zeros((n, count), dtype=bool), np.zeros((n, order + 1, count))
    doubt, error, is_certain = 0.0, 0.0, True
    for support in problem.supports:
        edges = np.unique(problem.mesh.boundaries[support.boundary])
        for i, coefficient in enumerate(support.value):
            if coefficient is None:
                continue
            with located(f"the displacement given on {support.boundary!r}"):
                part = integrals(coefficient, skeleton, edges, 2)
                at_nodes = _at_nodes(coefficient, skeleton, edges)
                pieces, shares, values, is_seen = _samples(coefficient, Edges(skeleton.body, edges))
            held[i, edges], given[i][:, edges] = True, part.moments
            own = to_coefficients(order, 2) @ at_nodes[:, pieces.owner]
            values -= np.sum(functions(order, shares) * own[:, :, None], axis=0)
            doubt = np.max(part.doubt, initial=doubt)
            error = max(error, magnitude(values))
            is_certain &= part.is_certain and is_seen
    scale = max(magnitude(given), 1e-300)
    return held, given, doubt / scale, error / scale, is_certain


def _at_nodes(coefficient: Coefficient, skeleton: Skeleton, edges: Index) -> Array:
    """(order + 1, edges) values at the ends of edges, and for order 2 in the middle."""
    return on_points(coefficient, skeleton.space.points(skeleton.nodes)[:, skeleton.along[:, edges]])


def _inside(problem: ContactProblem, skeleton: Skeleton) -> tuple[Inside, bool]:
    obstacles = [obstacle for obstacle in problem.obstacles if obstacle.boundary is Place.INTERIOR]
    (sign, offset), *rest = [(obstacle.normal[0], obstacle.offset) for obstacle in obstacles] or [(0.0, 0.0)]
    if rest:
        raise NotCertifiableError("there are two obstacles in the interior")
    elements = np.arange(skeleton.areas.size if obstacles else 0)
    gap = integrals(offset, skeleton, elements, 3)
    is_certain = gap.is_certain and (not obstacles or _is_seen_inside(offset, skeleton, elements))
    return Inside(sign, elements, gap.moments, gap.doubt), is_certain


def _is_seen_inside(offset: Coefficient, skeleton: Skeleton, elements: Index) -> bool:
    """Whether no ridge or needle of an obstacle hides between the points at which gaps are looked at.

    Each sixteenth of a part is resolved, and no part is narrower than twice their distance on a mesh that is
    twice as coarse, unless it ends at a vertex, beside which there is one kink only.
    """
    parts = triangle_parts(skeleton.body, elements, (offset,))
    owner, corners = parts.owner, parts.corners
    longest = np.max(np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=0), axis=0)
    is_narrow = _are_inside(parts) & (parts.share < longest / LATTICES[-1])
    for _ in range(2):
        owner, corners = refined(owner, corners, np.full(owner.size, True))
    points = skeleton.body.points(elements[owner], corners.transpose(0, 2, 1))[0]
    return not np.any(is_narrow) and bool(np.all(resolved(offset, points, RULES[1])[0]))


def _contact_parts(problem: ContactProblem, skeleton: Skeleton, held: Mask) -> tuple[ContactPart, ...]:
    """Of each boundary with contact the edges on which the gap is not given beforehand."""
    parts: list[ContactPart] = []
    seen, first = np.zeros(held.shape[1], dtype=bool), 0
    for number, (obstacle, partner) in enumerate(zip(problem.obstacles, problem.partners, strict=True)):
        if isinstance(obstacle.boundary, Place):
            continue
        normal = (np.array(obstacle.normal) != 0) | (obstacle.level is not None)
        both = np.unique(problem.mesh.boundaries[obstacle.boundary])[None]
        if obstacle.other:
            both = edges_of_pair(problem.mesh, obstacle.boundary, obstacle.other)
        both = both[:, np.any(~held[:, both] & normal[:, None, None], axis=(0, 1))].astype(np.int64)
        if np.any(seen[both]):
            raise NotCertifiableError("an edge is in contact with two obstacles")
        if np.all(normal) and held.shape[0] == 2 and np.any(held[:, both]):
            raise NotCertifiableError(
                "a displacement component is given on a contact edge whose contact normal is oblique"
            )
        seen[both] = True
        edges, others = both[0], both[1:].ravel()
        begin = skeleton.ends[0, edges[: others.size]]
        is_reversed = (begin if partner is None else partner[begin]) != skeleton.ends[0, others]
        place = slice(first, first := first + edges.size)
        parts.append(ContactPart(number, obstacle, edges, place, others, is_reversed))
    return tuple(parts)


def is_seen(coefficient: Coefficient, edges: Edges) -> bool:
    """Whether nothing of a gap hides between the points of edges at which gaps are looked at."""
    parts, _, _, is_certain = _samples(coefficient, edges)
    return is_certain and not np.any(_are_inside(parts) & (parts.share < 2 / SAMPLES))


def _are_inside(parts: Parts) -> Mask:
    """Parts without a vertex of their owner."""
    return np.max(parts.corners, axis=(0, 1)) < 1 - PROVED


def _samples(coefficient: Coefficient, edges: Edges) -> tuple[Parts, Array, Array, bool]:
    """Pieces of edges, barycentric coordinates (2, k, 33) just inside of their ends, and values there.

    The last value says whether nothing hides between them.
    """
    parts = edge_parts(edges, (coefficient,))
    shares = parts.corners.transpose(0, 2, 1) @ SAMPLED
    points = edges.at(parts.owner, shares[1])[0]
    cells, values = np.stack([points[..., :-1], points[..., 1:]], axis=-1), on_points(coefficient, points)
    is_seen = not callable(coefficient) or np.all(resolved(coefficient, cells, RULES[1])[0])
    return parts, shares, values, parts.is_certain and bool(is_seen)


def _linear_below(friction: Coefficient, edges: Edges) -> tuple[Array, bool]:
    """Ends (2, edges) of linear functions below a friction bound on edges, as high as samples allow.

    On an edge where the bound jumps or kinks it is a constant. The second value says whether it is known
    where it does.
    """
    parts, _, values, is_certain = _samples(friction, edges)
    owner = parts.owner
    # between two samples it is below its chord by an eighth of the second difference
    values -= np.pad(np.maximum(np.diff(values, 2), 0.0) / 8, ((0, 0), (1, 1)), "edge")
    steepest = np.max(np.abs(np.diff(values)), axis=1) * len(SAMPLED.T)
    values -= 2 * PROVED * steepest[:, None]  # samples are inside of the ends
    least, ends = np.full(edges.size, np.inf), np.zeros((2, edges.size))
    np.minimum.at(least, owner, np.min(values, axis=1))
    ends[:, owner] = values[:, [0, -1]].T
    excess = np.max(ends[:, owner].T @ SAMPLED - values, axis=1)
    ends[:, owner] -= np.where(excess > PROVED * np.max(np.abs(values), axis=1), excess, 0.0)
    is_constant = (np.bincount(owner, minlength=edges.size) > 1) | np.any(ends < 0, axis=0)
    return np.where(is_constant, np.maximum(least, 0.0), ends), is_certain
