"""Integrals over triangles and edges of a body, by rules that are refined until two agree.

Triangles and edges are split where a coefficient jumps or kinks (:mod:`rmesh_nlp.assessment.parts`). A cell
is a piece of a part, in the coordinates (r, s) of its apex, or along the edge. On each one Gauss's rules of
two orders are compared. Where they differ, or where it is not proved that a coefficient is resolved
(:mod:`rmesh_nlp.problem.enclosures`), higher orders are tried, then the cell is cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.assessment.parts import AlongEdges, Parts, edge_parts, triangle_parts
from rmesh_nlp.evaluation import ROUNDING, Array, Index
from rmesh_nlp.optimize.budget import checkpoint
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body, Edges
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.enclosures import resolved
from rmesh_nlp.vectorised import CHUNK

Integrand = Callable[[Index, Array, Array, Array], Array]
"""``(owners (m,), barycentric (2 or 3, m, k), points (2, m, k), weights (m, k)) -> sums (rows, m)``; owners
are elements, or rows of edges."""

RULES, HIGHER = (4, 6), (6, 10)
"""Gauss points per direction of the rules that are compared, and of those for the cells where the first ones
differ; the parts of a cell where these differ too, beside a kink, begin with the first ones again. (k, l) is
of degrees 2 k - 2 and 2 l - 2 on a triangle. (6, 10) for all takes twice as long on Example 6.1 (n = 64) and
agrees to 3e-10. Of 60 bumps a fiftieth of an edge wide it misses one, these two, and (3, 5) in the first
place nine."""

RINGS = (3, 4)
"""The same for the strain energy of straight triangles where the law varies, as with one over the radius."""

DEPTH, DEEPEST = 9, 40
"""Last stage: times that a cell may be halved in each direction, and one. The second one is that of up to
``CHUNK`` cells where rules differ, and of as many where a coefficient is not resolved although they agree."""

FEW = 16
"""Cells of edges up to which each is cut in 32: less overhead than five rounds of halving."""

VANISHING = 1e-6
"""Size of a row, as a part of the largest one, that is worth no finer rule: it may be all rounding."""


class Integral(NamedTuple):
    """Integrals (rows, owners), what they may be wrong by, and whether that is certain.

    Two rules that agree may both be wrong. It is certain that they are not where the switches of coefficients
    are located with certainty, and coefficients are resolved by the rule on each cell between these, up to
    cells on which what they vary by is worth nothing.
    """

    value: Array
    doubt: Array
    is_certain: bool


def over_triangles(
    body: Body,
    elements: Index,
    integrand: Integrand,
    points: tuple[int, ...] = (),
    coefficients: Iterable[Coefficient] = (),
) -> Integral:
    """Integrals (rows, elements) over triangles, part by part where ``coefficients`` jump or kink.

    ``points`` is the number of Gauss points per direction that is known to suffice, or the two numbers of the
    rules that are compared in the first place; ``RULES`` by default.
    """
    parts = triangle_parts(body, elements, coefficients)
    return _integral(body.points, body.problem, elements, integrand, parts, coefficients, points)


def over_edges(
    edges: Edges,
    integrand: Integrand,
    coefficients: Iterable[Coefficient] = (),
    others: Iterable[AlongEdges] = (),
) -> Integral:
    """Integrals (rows, edges) along edges, part by part where ``coefficients`` jump or kink.

    Edges are split at the zeros of ``others`` too.
    """
    parts, rows = edge_parts(edges, coefficients, others), np.arange(edges.size)
    return _integral(
        lambda rows, shares: edges.at(rows, shares[1]),
        edges.body.problem,
        rows,
        integrand,
        parts,
        coefficients,
    )


def _integral(
    at: Callable[[Index, Array], tuple[Array, Array]],
    problem: ContactProblem,
    owners: Index,
    integrand: Integrand,
    parts: Parts,
    coefficients: Iterable[Coefficient],
    points: tuple[int, ...] = (),
) -> Integral:
    """The sums over the cells of parts, by the ``owners`` of these: triangles or edges.

    ``at`` has points of owners at barycentric coordinates, and their measure per unit of these.
    """
    count, directions, names = parts.owner.size, len(parts.corners) - 1, owners[parts.owner]

    def on_cells(part: Index, low: Array, width: Array, order: int) -> Array:
        x, w = gauss(order)
        shares = _barycentric(low, width, _grid(x, directions))
        weights = np.outer(width**directions * parts.share[part], np.prod(_grid(w, directions), axis=0))
        weights *= np.sum(shares[-2:], axis=0)
        shares = np.einsum("ipm,pmk->imk", parts.corners[:, :, part], shares)
        where, det = at(names[part], shares)
        return integrand(names[part], shares, where, weights * det * problem.measured(where))

    vertices = at(names, parts.corners.transpose(0, 2, 1))[0]
    total, doubt = np.zeros((2, 1, owners.size))
    owner, low, width = np.arange(count), np.zeros((directions, count)), np.ones(count)
    corners = _grid((0, 1), directions)
    sizes = {each: 0.0 for each in coefficients if callable(each) and len(points) != 1}
    is_certain = parts.is_certain
    depth = 0
    while count:
        *lower, higher = HIGHER if depth == 1 else points or RULES
        fine, wrong = _in_chunks(on_cells, owner, low, width, higher), np.zeros(1)
        for order in lower:
            wrong = np.abs(fine - _in_chunks(on_cells, owner, low, width, order))
        if depth == 0:
            scale = np.sum(np.abs(fine), axis=1, keepdims=True)
            scale = np.maximum(scale, VANISHING * np.max(scale))
        wrong = np.broadcast_to(wrong, fine.shape)
        split = np.any(wrong > ROUNDING * scale, axis=0)
        split &= depth < DEPTH or (np.count_nonzero(split) <= CHUNK and depth < DEEPEST)
        place = np.einsum("dmv,vmk->dmk", vertices[:, owner], _barycentric(low, width, corners))
        for coefficient in sizes:
            size, share = sizes[coefficient], width**directions
            is_seen, sizes[coefficient] = resolved(coefficient, place, higher, size, share)
            if depth == 0 or (np.count_nonzero(~is_seen) <= CHUNK and depth < DEEPEST):
                split |= ~is_seen
            is_certain &= bool(np.all(is_seen | split))
        of = parts.owner[owner[~split]]
        total, doubt = (
            sums + np.array([np.bincount(of, row[~split], owners.size) for row in rows])
            for sums, rows in ((total, fine), (doubt, wrong))
        )
        if not np.any(split):
            break
        # first the same cells by higher rules; a jump on an edge is found in few rounds
        halvings = min(depth, 1) * (5 if directions == 1 and np.count_nonzero(split) < FEW else 1)
        places = _grid(np.arange(2**halvings), directions)
        width = width[split] / 2**halvings
        low = (low[:, None, split] + places[..., None] * width).reshape(directions, -1)
        owner, width = (np.tile(each, places.shape[1]) for each in (owner[split], width))
        depth += max(halvings, 1)
    return Integral(total, doubt, is_certain)


def _grid(values: ArrayLike, directions: int) -> Array:
    """(directions, k) values in each direction."""
    return np.stack(np.meshgrid(*[values] * directions, indexing="ij")).reshape(directions, -1)


def _barycentric(low: Array, width: Array, places: Array) -> Array:
    """(2 or 3, m, k) coordinates in parts of places (directions, k) in cells."""
    *radius, s = low[..., None] + width[:, None] * places[:, None]
    r = np.prod(radius, axis=0)
    return np.stack([*(1 - one for one in radius), r * (1 - s), r * s])


def _in_chunks(on_cells: Callable[..., Array], owner: Index, low: Array, width: Array, order: int) -> Array:
    checkpoint()
    size = CHUNK // order
    parts = [slice(i, i + size) for i in range(0, owner.size, size)]
    return np.hstack([on_cells(owner[part], low[:, part], width[part], order) for part in parts])


@lru_cache
def gauss(points: int) -> tuple[Array, Array]:
    """Points and weights of Gauss's rule on (0, 1); not to be written to."""
    x, w = np.polynomial.legendre.leggauss(points)
    return (1 + x) / 2, w / 2
