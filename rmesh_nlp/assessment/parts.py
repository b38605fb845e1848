"""Parts of triangles and edges on which coefficients are smooth: between the zeros of their switches.

A switch (:mod:`rmesh_nlp.problem.switches`) that is affine is zero at one point of a straight edge, and on
one line through a straight triangle, which is split along it. Others are sampled: an edge is split where
their sign changes between samples, a triangle is refined there, and then split along the chord. Polynomials
along straight edges are followed with certainty, by the signs of their Bernstein coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import comb

from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude
from rmesh_nlp.fem.bernstein import SIDES, to_coefficients
from rmesh_nlp.problem.body import Body, Edges
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.switches import switches

AlongEdges = tuple[Callable[[Index, Array], Array], int | None]
"""A function ``(edges (m,), s (m, k)) -> values (m, k)``, and its degree in s if it is a polynomial."""

OnPoints = tuple[Callable[[Array], Array], int | None]
"""A function ``points (2, ...) -> values (...)``, and its degree if it is a polynomial."""

SAMPLES = 32
"""Pieces of an edge between whose ends the sign of a switch that is no polynomial is compared. Triangles are
refined around the zeros of such a switch until their edges are such pieces."""

PROVED = 1e-10
"""Relative difference that is none where a bound is guaranteed: of forces in equilibrium, of the measures of
the domain, of a switch at a node, which is zero, and of a part that is empty."""


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


def _switches_of(coefficients: Iterable[Coefficient]) -> tuple[list[OnPoints], bool]:
    """All switches of coefficients, and whether there can be no others."""
    switching = [each for each in map(switches, coefficients) if each is not None]
    functions: list[OnPoints] = [
        (partial(each, number), degree) for each in switching for number, degree in enumerate(each.degrees)
    ]
    return functions, all(each.are_all for each in switching)


def edge_parts(
    edges: Edges, coefficients: Iterable[Coefficient], others: Iterable[AlongEdges] = ()
) -> EdgeParts:
    """The pieces of edges between the zeros of coefficients' switches, and of ``others``."""
    owner, begin = np.arange(edges.size), np.zeros(edges.size)
    switched, is_certain = _switches_of(coefficients)

    def along(switch: Callable[[Array], Array], rows: Index, s: Array) -> Array:
        return switch(edges.at(rows, s)[0])

    functions: list[AlongEdges] = [
        *others,
        *((partial(along, switch), degree if edges.are_straight else None) for switch, degree in switched),
    ]
    for function, degree in functions if edges.size else ():
        rows, s, certain = _zeros_along(function, edges.size, degree)
        owner, begin, is_certain = np.append(owner, rows), np.append(begin, s), is_certain and certain
    order = np.lexsort((begin, owner))
    owner, begin = owner[order], begin[order]
    end = np.append(begin[1:], 1.0)
    end[np.append(np.diff(owner) > 0, True)] = 1.0
    kept = end > begin
    return EdgeParts(owner[kept], begin[kept], end[kept], is_certain)


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
    while rows.size and width > ROUNDING:
        values = value(rows, low[:, None] + width * share)
        scale = max(scale, magnitude(values))
        values = np.where(np.abs(values) <= PROVED * scale, 0.0, values)
        coefficients = values @ to_bernstein.T
        none, single = _one_sign(coefficients), _one_sign(np.diff(coefficients, axis=1))
        # a piece that begins at a zero is a part of its own
        for chosen, last in ((~none & single, low + width), ((values[:, 0] == 0) & (low > 0), low)):
            at, begin = np.append(at, rows[chosen]), np.append(begin, low[chosen])
            end = np.append(end, last[chosen])
        open_ones = ~(none | single)
        width = width / 2
        rows, low = np.tile(rows[open_ones], 2), np.append(low[open_ones], low[open_ones] + width)
    first = np.sign(value(at, begin[:, None])[:, 0]) if at.size else begin
    while np.any(end - begin > np.finfo(float).eps):
        middle = (begin + end) / 2
        is_low = value(at, middle[:, None])[:, 0] * first > 0
        begin, end = np.where(is_low, middle, begin), np.where(is_low, end, middle)
    return at, (begin + end) / 2, degree is not None and rows.size == 0


def _one_sign(values: Array) -> Mask:
    return np.all(values >= 0, axis=-1) | np.all(values <= 0, axis=-1)


def _to_bernstein(degree: int) -> Array:
    """(degree + 1, degree + 1) Bernstein coefficients of a polynomial by its values at equal distances."""
    s, k = np.linspace(0, 1, degree + 1)[:, None], np.arange(degree + 1)
    return np.linalg.inv(comb(degree, k) * s**k * (1 - s) ** (degree - k))


def triangle_parts(body: Body, elements: Index, coefficients: Iterable[Coefficient]) -> TriangleParts:
    """The pieces of triangles between the zeros of the switches of coefficients."""
    owner, corners = np.arange(elements.size), np.zeros((3, 3, elements.size))
    for turn in range(3):
        corners[(body.apex[elements] + turn) % 3, turn, owner] = 1.0
    switched, is_certain = _switches_of(coefficients)

    def on_parts(switch: Callable[[Array], Array], owner: Index, barycentric: Array) -> Array:
        """Values (points, parts) at barycentric coordinates (3, points, parts)."""
        return switch(body.points(elements[owner], barycentric.transpose(0, 2, 1))[0]).T

    for switch, degree in switched:
        value = partial(on_parts, switch)
        tiny = PROVED * magnitude(value(owner, corners))
        bends = body.is_curved[elements] | (degree is None or degree > 1)
        width = 1.0
        while np.any(bends) and width > 1 / SAMPLES:
            meets = bends[owner] & _have_two_signs(value(owner, _with_middles(corners)), tiny)
            owner, corners = _refined(owner, corners, meets)
            width = width / 2
        quadratic = to_coefficients(2, 3) @ value(owner, _with_middles(corners))
        is_certain &= degree is not None and degree <= 2
        is_certain &= not np.any(bends[owner] & _have_two_signs(quadratic, tiny))
        owner, corners = _cut(owner, corners, quadratic[:3], tiny)
    return TriangleParts(owner, corners, np.abs(np.linalg.det(corners.transpose(2, 0, 1))), is_certain)


def _have_two_signs(values: Array, tiny: float) -> Mask:
    return (np.min(values, axis=0) < -tiny) & (np.max(values, axis=0) > tiny)


def _with_middles(corners: Array) -> Array:
    """(3, 6, parts) corners and the middles of sides."""
    middles = [(corners[:, a] + corners[:, b]) / 2 for a, b in SIDES[3]]
    return np.concatenate([corners, np.stack(middles, axis=1)], axis=1)


def _refined(owner: Index, corners: Array, chosen: Mask) -> tuple[Index, Array]:
    """Some of the parts in four similar ones."""
    a, b, c, ab, bc, ca = _with_middles(corners[:, :, chosen]).transpose(1, 0, 2)
    four = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return (
        np.concatenate([owner[~chosen], *[owner[chosen]] * 4]),
        np.concatenate([corners[:, :, ~chosen], *four], axis=2),
    )


def _cut(owner: Index, corners: Array, values: Array, tiny: float) -> tuple[Index, Array]:
    """Parts with values of two signs in three, along the line where their linear function is zero."""
    chosen = _have_two_signs(values, tiny)
    values, part = np.where(np.abs(values) <= tiny, 0.0, values)[:, chosen], corners[:, :, chosen]
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
    return owner[area > PROVED], corners[:, :, area > PROVED]
