"""Parts of triangles and edges on which coefficients are smooth: between the zeros of their switches.

A switch (:mod:`rmesh_nlp.problem.switches`) that is affine is zero at one point of a straight edge, and on
one line through a straight triangle, which is split along it. Others are sampled: an edge is split where
their sign changes between samples, a triangle is refined there, and then split along the chord. Polynomials
along straight edges are followed with certainty, by the signs of their Bernstein coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.switches import Switches, switches

Index = NDArray[np.int64]

EdgePoints = Callable[[Index, Array], tuple[Array, Array]]
"""``(edges (m,), s (m, k)) -> points (2, m, k) and lengths per unit of s (m, k)``."""

AlongEdges = tuple[Callable[[Index, Array], Array], int | None]
"""A function ``(edges (m,), s (m, k)) -> values (m, k)``, and its degree in s if it is a polynomial."""

SAMPLES = 32
"""Pieces of an edge between whose ends the sign of a switch that is no polynomial is compared."""

BISECTIONS, HALVINGS = 50, 30
"""Of a piece with one zero, and of one that may have several."""

REFINEMENTS = 5
"""Times that a triangle is refined around the zeros of a switch that is not affine on it."""

ZERO = 1e-12
"""Part of the largest value of a switch below which it is zero: a side on a jump is no part of its own."""


class Geometry(Protocol):
    """Triangles: a :class:`rmesh_nlp.problem.body.Body`, or :class:`Straight` ones."""

    apex: Index
    is_curved: NDArray[np.bool_]

    def points(self, elements: Index, barycentric: Array) -> tuple[Array, Array]:
        """Points (2, m, k) and determinants of the map from the reference triangle, (m, k) or (m, 1)."""


class Straight:
    """Triangles by their corners (2, 3, elements), each of measure one: integrals over them are means."""

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self.apex = np.zeros(corners.shape[2], dtype=np.int64)
        self.is_curved = np.zeros(corners.shape[2], dtype=bool)

    def points(self, elements: Index, barycentric: Array) -> tuple[Array, Array]:
        """See :class:`Geometry`."""
        where = np.einsum("dvm,vmk->dmk", self._corners[:, :, elements], barycentric)
        return where, np.full((elements.size, 1), 2.0)


def straight_edges(corners: Array) -> EdgePoints:
    """Edges by their ends (2, 2, edges), each of length one: integrals along them are means."""

    def at(rows: Index, s: Array) -> tuple[Array, Array]:
        first, last = corners[:, 0, rows, None], corners[:, 1, rows, None]
        return first + s * (last - first), np.ones_like(s)

    return at


@dataclass(frozen=True)
class EdgeParts:
    """Pieces (k,) of edges: their edge, and where they begin and end."""

    owner: Index
    begin: Array
    end: Array
    is_certain: bool


@dataclass(frozen=True)
class TriangleParts:
    """Pieces (k,) of triangles: their triangle, barycentric coordinates (3, 3 corners, k), share of the area.

    The first corner is the apex of a triangle that is whole.
    """

    owner: Index
    corners: Array
    share: Array
    is_certain: bool


def edge_parts(
    at: EdgePoints, size: int, coefficients: Iterable[Coefficient], others: Iterable[AlongEdges] = ()
) -> EdgeParts:
    """The pieces of ``size`` edges between the zeros of coefficients' switches, and of ``others``."""
    owner, begin, is_straight = np.arange(size), np.zeros(size), size > 0 and _are_straight(at, size)
    functions, is_certain = list(others), True
    for one in filter(None, map(switches, coefficients)):
        is_certain &= one.are_all
        for number, degree in enumerate(one.degrees):

            def value(rows: Index, s: Array, one: Switches = one, number: int = number) -> Array:
                return one(number, at(rows, s)[0])

            functions.append((value, degree if is_straight else None))
    edges, zeros = [owner], [begin]
    for function, degree in functions if size else ():
        rows, s, certain = _zeros_along(function, size, degree)
        edges, zeros, is_certain = [*edges, rows], [*zeros, s], is_certain and certain
    owner, begin = np.concatenate(edges), np.concatenate(zeros)
    order = np.lexsort((begin, owner))
    owner, begin = owner[order], begin[order]
    end = np.append(begin[1:], 1.0)
    end[np.append(np.diff(owner) > 0, True)] = 1.0
    kept = end > begin
    return EdgeParts(owner[kept], begin[kept], end[kept], is_certain)


def _are_straight(at: EdgePoints, size: int) -> bool:
    s = np.broadcast_to([0.0, 0.25, 0.5, 1.0], (size, 4))
    points = at(np.arange(size), s)[0]
    chord = points[..., :1] + s * (points[..., 3:] - points[..., :1])
    return bool(np.max(np.abs(points - chord)) <= ZERO * np.max(np.abs(points)))


def _zeros_along(
    value: Callable[[Index, Array], Array], size: int, degree: int | None
) -> tuple[Index, Array, bool]:
    """Edges and places of changes of sign, and whether there are certainly no others.

    ``degree`` is that of a polynomial along each edge: of its pieces those are halved that may have several
    zeros.
    """
    inner, pieces = max(degree or 1, 1), 1 if degree is not None else SAMPLES
    rows, low = np.repeat(np.arange(size), pieces), np.tile(np.arange(pieces) / pieces, size)
    width, share, to_bernstein = 1 / pieces, np.linspace(0, 1, inner + 1), _to_bernstein(inner)
    at, begin, end, scale = rows[:0], low[:0], low[:0], 0.0
    for _ in range(HALVINGS):
        values = value(rows, low[:, None] + width * share)
        scale = max(scale, float(np.max(np.abs(values), initial=0.0)))
        values = np.where(np.abs(values) <= ZERO * scale, 0.0, values)
        coefficients = values @ to_bernstein.T
        none, single = _one_sign(coefficients), _one_sign(np.diff(coefficients, axis=1))
        # a piece that begins at a zero is a part of its own
        for chosen, last in ((~none & single, low + width), ((values[:, 0] == 0) & (low > 0), low)):
            at, begin = np.append(at, rows[chosen]), np.append(begin, low[chosen])
            end = np.append(end, last[chosen])
        open_ones = ~(none | single)
        width = width / 2
        rows, low = np.tile(rows[open_ones], 2), np.append(low[open_ones], low[open_ones] + width)
        if rows.size == 0:
            break
    first = np.sign(value(at, begin[:, None])[:, 0]) if at.size else begin
    for _ in range(BISECTIONS if at.size else 0):
        middle = (begin + end) / 2
        is_low = value(at, middle[:, None])[:, 0] * first > 0
        begin, end = np.where(is_low, middle, begin), np.where(is_low, end, middle)
    return at, (begin + end) / 2, degree is not None and rows.size == 0


def _one_sign(values: Array) -> NDArray[np.bool_]:
    return np.asarray(np.all(values >= 0, axis=-1) | np.all(values <= 0, axis=-1))


def _to_bernstein(degree: int) -> Array:
    """(degree + 1, degree + 1) Bernstein coefficients of a polynomial by its values at equal distances."""
    s, k = np.linspace(0, 1, degree + 1)[:, None], np.arange(degree + 1)
    binomial = np.array([comb(degree, i) for i in k])
    return np.asarray(np.linalg.inv(binomial * s**k * (1 - s) ** (degree - k)))


def triangle_parts(body: Geometry, elements: Index, coefficients: Iterable[Coefficient]) -> TriangleParts:
    """The pieces of triangles between the zeros of the switches of coefficients."""
    owner, corners = np.arange(elements.size), np.zeros((3, 3, elements.size))
    for turn in range(3):
        corners[(body.apex[elements] + turn) % 3, turn, owner] = 1.0
    is_certain, curved = True, body.is_curved[elements]
    for one in filter(None, map(switches, coefficients)):
        is_certain &= one.are_all
        for number, degree in enumerate(one.degrees):

            def value(owner: Index, barycentric: Array, one: Switches = one, number: int = number) -> Array:
                """The switch (points, parts) at barycentric coordinates (3, points, parts)."""
                moved = barycentric.transpose(0, 2, 1)
                return one(number, body.points(elements[owner], moved)[0]).T

            scale = float(np.max(np.abs(value(owner, corners)), initial=0.0))
            for _ in range(REFINEMENTS if degree is None or degree > 1 or np.any(curved) else 0):
                meets = _may_meet(value(owner, _with_middles(corners)), scale)
                meets &= (degree is None or degree > 1) | curved[owner]
                owner, corners = _refined(owner, corners, meets)
            at_corners = value(owner, corners)
            at_corners = np.where(np.abs(at_corners) <= ZERO * scale, 0.0, at_corners)
            is_cut = (np.min(at_corners, axis=0) < 0) & (np.max(at_corners, axis=0) > 0)
            if degree is None or degree > 2:
                is_certain = False
            elif degree == 2 or np.any(curved):
                bends = _may_meet(_quadratic_coefficients(value(owner, _with_middles(corners))), scale)
                is_certain &= not np.any(bends | curved[owner] & is_cut)
            owner, corners = _cut(owner, corners, at_corners, is_cut)
    return TriangleParts(owner, corners, np.abs(np.linalg.det(corners.transpose(2, 0, 1))), is_certain)


def _may_meet(values: Array, scale: float) -> NDArray[np.bool_]:
    """Whether values (k, parts) have two signs."""
    tiny = ZERO * scale
    return np.asarray((np.min(values, axis=0) < -tiny) & (np.max(values, axis=0) > tiny))


def _with_middles(corners: Array) -> Array:
    """(3, 6, parts) corners and the middles of sides."""
    middles = [(corners[:, a] + corners[:, b]) / 2 for a, b in combinations(range(3), 2)]
    return np.concatenate([corners, np.stack(middles, axis=1)], axis=1)


def _quadratic_coefficients(values: Array) -> Array:
    """(6, parts) Bernstein coefficients of quadratics by their values at corners and middles."""
    sides = [
        2 * values[3 + k] - (values[a] + values[b]) / 2 for k, (a, b) in enumerate(combinations(range(3), 2))
    ]
    return np.concatenate([values[:3], np.stack(sides)])


def _refined(owner: Index, corners: Array, chosen: NDArray[np.bool_]) -> tuple[Index, Array]:
    """Some of the parts in four similar ones."""
    if not np.any(chosen):
        return owner, corners
    a, b, c, ab, ac, bc = _with_middles(corners[:, :, chosen]).transpose(1, 0, 2)
    four = [np.stack(part, axis=1) for part in ((a, ab, ac), (ab, b, bc), (ac, bc, c), (ab, bc, ac))]
    return (
        np.concatenate([owner[~chosen], *[owner[chosen]] * 4]),
        np.concatenate([corners[:, :, ~chosen], *four], axis=2),
    )


def _cut(owner: Index, corners: Array, values: Array, chosen: NDArray[np.bool_]) -> tuple[Index, Array]:
    """Some of the parts in three, along the line where the linear function with these values is zero."""
    if not np.any(chosen):
        return owner, corners
    values, part = values[:, chosen], corners[:, :, chosen]
    above = values > 0
    # the corner that is alone on its side; zeros are with those below
    alone = np.argmax(above == (np.count_nonzero(above, axis=0) == 1), axis=0)
    every = np.arange(alone.size)
    p, q, r = (part[:, (alone + turn) % 3, every] for turn in range(3))
    at_p, at_q, at_r = (values[(alone + turn) % 3, every] for turn in range(3))
    on_q, on_r = p + at_p / (at_p - at_q) * (q - p), p + at_p / (at_p - at_r) * (r - p)
    three = [np.stack(corner, axis=1) for corner in ((p, on_q, on_r), (on_q, q, r), (on_q, r, on_r))]
    owner = np.concatenate([owner[~chosen], *[owner[chosen]] * 3])
    corners = np.concatenate([corners[:, :, ~chosen], *three], axis=2)
    area = np.abs(np.linalg.det(corners.transpose(2, 0, 1)))
    return owner[area > ZERO], corners[:, :, area > ZERO]
