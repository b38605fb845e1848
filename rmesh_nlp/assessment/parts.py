"""Parts of triangles and edges on which coefficients are smooth: between the zeros of their switches.

A switch (:mod:`rmesh_nlp.problem.switches`) that is affine is zero at one point of a straight edge, and on
one line through a straight triangle, which is split along it; so is one that is affine on each of the parts
that switches before it make. Others are sampled: an edge is split where
their sign changes between samples, a triangle is refined there, and then split along the chord. Polynomials
along straight edges are followed with certainty, by the signs of their Bernstein coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import comb

from rmesh_nlp.evaluation import PROVED, ROUNDING, Array, Index, Mask
from rmesh_nlp.fem.bernstein import functions
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

EXACT = 64 * np.finfo(float).eps
"""Values of a switch up to this part of its largest one on a part are zero, and so small pieces are none."""

INSIDE = np.hstack([np.eye(3), [[1 / 2, 0, 1 / 2], [1 / 2, 1 / 2, 0], [0, 1 / 2, 1 / 2]]])
INSIDE = PROVED + (1 - 3 * PROVED) * INSIDE
"""Barycentric coordinates (3, 6) just inside of a triangle, by which a quadratic function is known."""

TO_QUADRATIC = np.linalg.inv(functions(2, INSIDE).T)


@dataclass(frozen=True)
class Parts:
    """Pieces (k,) of edges or triangles: owner, barycentric coordinates (v, v corners, k), share of it.

    The first corner is the apex of a triangle that is whole, or where a piece of an edge begins.
    """

    owner: Index
    corners: Array
    share: Array
    is_certain: bool


def _switches_of(coefficients: Iterable[Coefficient]) -> list[OnPoints]:
    """All switches of coefficients."""
    return [
        (partial(each, number), degree)
        for each in filter(None, map(switches, coefficients))
        for number, degree in enumerate(each.degrees)
    ]


def edge_parts(edges: Edges, coefficients: Iterable[Coefficient], others: Iterable[AlongEdges] = ()) -> Parts:
    """The pieces of edges between the zeros of coefficients' switches, and of ``others``."""
    owner, begin, end, is_certain = np.arange(edges.size), np.zeros(edges.size), np.ones(edges.size), True

    def along(switch: Callable[[Array], Array], rows: Index, s: Array) -> Array:
        return switch(edges.at(rows, s)[0])

    functions: list[AlongEdges] = [
        *others,
        *(
            (partial(along, switch), degree if edges.are_straight else None)
            for switch, degree in _switches_of(coefficients)
        ),
    ]
    for function, degree in functions if edges.size else ():
        rows, zeros, certain = _zeros_along(function, owner, begin, end, degree)
        owner, begin, is_certain = np.append(owner, rows), np.append(begin, zeros), is_certain and certain
        order = np.lexsort((begin, owner))
        owner, begin = owner[order], begin[order]
        end = np.append(begin[1:], 1.0)
        end[np.append(np.diff(owner) > 0, True)] = 1.0
        kept = end > begin
        owner, begin, end = owner[kept], begin[kept], end[kept]
    corners = np.stack([[1 - begin, 1 - end], [begin, end]])
    return Parts(owner, corners, end - begin, is_certain)


def _zeros_along(
    value: Callable[[Index, Array], Array], owner: Index, begin: Array, end: Array, degree: int | None
) -> tuple[Index, Array, bool]:
    """Edges and places of changes of sign on parts of edges, and whether there are certainly no others.

    ``degree`` is that of a polynomial along each part: of its pieces those are halved that may have several
    zeros, until it is all rounding: about a double zero signs are not certain.
    """
    is_certain = degree is not None
    inner, pieces = max(degree or 1, 1), 1 if degree is not None else SAMPLES
    rows, width = np.repeat(owner, pieces), np.repeat(end - begin, pieces) / pieces
    low = np.repeat(begin, pieces) + width * np.tile(np.arange(pieces), begin.size)
    inside = 0.0 if degree is None else EXACT  # at the ends others may jump
    share, to_bernstein = np.clip(np.linspace(0, 1, inner + 1), inside, 1 - inside), _to_bernstein(inner)
    at, begin, end, most, scale = rows[:0], low[:0], low[:0], SAMPLES * begin.size, 0 * low
    while 0 < rows.size <= most and np.max(width) > ROUNDING:
        values = value(rows, low[:, None] + np.outer(width, share))
        coefficients = values @ to_bernstein.T
        scale = np.maximum(scale, np.max(np.abs(coefficients), axis=1))
        vanishes = np.all(np.abs(coefficients) < PROVED * scale[:, None], axis=1)
        is_certain &= not np.any(vanishes)
        none, single = _one_sign(coefficients) | vanishes, _one_sign(np.diff(coefficients, axis=1))
        # a piece that begins at a zero is a part of its own
        starts = (np.abs(values[:, 0]) <= PROVED * scale) & (low > 0)
        for chosen, first, last in ((~none & single, share[0], share[-1]), (starts, 0, 0)):
            at, begin = np.append(at, rows[chosen]), np.append(begin, (low + first * width)[chosen])
            end = np.append(end, (low + last * width)[chosen])
        is_open = ~(none | single)
        width = np.tile(width[is_open] / 2, 2)
        rows, low, scale = np.tile(rows[is_open], 2), np.tile(low[is_open], 2), np.tile(scale[is_open], 2)
        low[rows.size // 2 :] += width[rows.size // 2 :]
    zeros = _bisected(partial(value, at), begin, end) if at.size else begin
    return at, zeros, is_certain and rows.size == 0


def _bisected(value: Callable[[Array], Array], begin: Array, end: Array) -> Array:
    """(m,) where values (m, k) at places (m, k) first change their sign between two places each."""
    first, every = np.sign(value(begin[:, None])), np.arange(begin.size)
    while np.any(end - begin > np.finfo(float).eps):
        places = begin[:, None] + np.outer(end - begin, np.arange(9) / 8)
        is_low = np.pad(value(places[:, 1:-1]) * first > 0, ((0, 0), (0, 1)))
        before = np.argmin(is_low, axis=1)
        begin, end = places[every, before], places[every, before + 1]
    return (begin + end) / 2


def _one_sign(values: Array) -> Mask:
    return np.all(values >= 0, axis=-1) | np.all(values <= 0, axis=-1)


def _to_bernstein(degree: int) -> Array:
    """(degree + 1, degree + 1) Bernstein coefficients of a polynomial by its values at equal distances."""
    s, k = np.linspace(0, 1, degree + 1)[:, None], np.arange(degree + 1)
    return np.linalg.inv(comb(degree, k) * s**k * (1 - s) ** (degree - k))


def triangle_parts(body: Body, elements: Index, coefficients: Iterable[Coefficient]) -> Parts:
    """The pieces of triangles between the zeros of the switches of coefficients."""
    turned = (body.apex[elements] + np.arange(3)[:, None]) % 3
    owner, corners = np.arange(elements.size), np.eye(3)[turned].transpose(2, 0, 1)
    is_certain = True
    for switch, degree in _switches_of(coefficients):

        def values(owner: Index, places: Array, switch: Callable[[Array], Array] = switch) -> Array:
            return switch(body.points(elements[owner], places)[0])

        def quadratic(owner: Index, corners: Array) -> Array:
            """Bernstein coefficients (6, parts) by values inside of parts: on their sides others may jump."""
            return TO_QUADRATIC @ values(owner, np.einsum("ipm,pk->imk", corners, INSIDE)).T

        bends = body.is_curved[elements] | (degree is None or degree > 1)
        width = 1.0
        while np.any(bends) and width > 1 / SAMPLES:
            owner, corners = refined(
                owner, corners, bends[owner] & _have_two_signs(quadratic(owner, corners))
            )
            width = width / 2
        last = quadratic(owner, corners)
        is_certain &= degree is not None and degree <= 2
        is_certain &= not np.any(bends[owner] & _have_two_signs(last, -PROVED))  # zeros within rounding too
        owner, corners = _cut(owner, corners, last[:3], None if degree == 1 else values)
    return Parts(owner, corners, np.abs(np.linalg.det(corners.transpose(2, 0, 1))), is_certain)


def _have_two_signs(values: Array, least: float = EXACT) -> Mask:
    tiny = least * np.max(np.abs(values), axis=0)
    return (np.min(values, axis=0) < -tiny) & (np.max(values, axis=0) > tiny)


def refined(owner: Index, corners: Array, chosen: Mask) -> tuple[Index, Array]:
    """Some of the parts in four similar ones."""
    a, b, c = corners[:, :, chosen].transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    four = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return (
        np.concatenate([owner[~chosen], *[owner[chosen]] * 4]),
        np.concatenate([corners[:, :, ~chosen], *four], axis=2),
    )


def _cut(
    owner: Index, corners: Array, values: Array, at: Callable[[Index, Array], Array] | None
) -> tuple[Index, Array]:
    """Parts with values of two signs at their corners, along the line between the zeros on their sides.

    ``at`` has the values of owners at places, just inside of parts; without it they are linear.
    """
    chosen, tiny = _have_two_signs(values), EXACT * np.max(np.abs(values), axis=0)
    values, part = np.where(np.abs(values) <= tiny, 0.0, values)[:, chosen], corners[:, :, chosen]
    above = values > 0
    # the corner that is alone on its side; zeros are with those below
    alone = np.argmax(above == (np.count_nonzero(above, axis=0) == 1), axis=0)
    every = np.arange(alone.size)
    p, q, r = (part[:, (alone + turn) % 3, every] for turn in range(3))
    at_p, *at_others = (values[(alone + turn) % 3, every] for turn in range(3))
    begin, ends, first = np.tile(p, 2), np.hstack([q, r]), np.tile(at_p, 2)
    share = first / (first - np.concatenate(at_others))
    if at is not None:
        cut, inside = np.tile(owner[chosen], 2), begin + PROVED * (np.tile(part.mean(axis=1), 2) - begin)
        share = _bisected(
            lambda s: at(cut, inside[..., None] + s * (ends - begin)[..., None]), 0 * share, 0 * share + 1
        )
    on_q, on_r = np.hsplit(begin + share * (ends - begin), 2)
    three = [np.stack(corner, axis=1) for corner in ((p, on_q, on_r), (on_q, q, r), (on_q, r, on_r))]
    owner = np.concatenate([owner[~chosen], *[owner[chosen]] * 3])
    corners = np.concatenate([corners[:, :, ~chosen], *three], axis=2)
    area = np.abs(np.linalg.det(corners.transpose(2, 0, 1)))
    return owner[area > EXACT], corners[:, :, area > EXACT]
