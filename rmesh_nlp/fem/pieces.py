"""Pieces of straight triangles and edges on which coefficients are smooth, as expressions of the corners.

They follow the nodes, so that a rule on each of them has nothing to gain by a node that goes past a jump. The
assessment has pieces as numbers, and of switches of any kind: :mod:`rmesh_nlp.assessment.parts`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from rmesh_nlp.evaluation import Expression
from rmesh_nlp.fem.cells import Rule, Straight
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.quadrature import MIDPOINT, is_split
from rmesh_nlp.problem.switches import affine_switches

Piece = tuple[list[Expression], Expression]
"""Corners, each a value of a switch and barycentric coordinates in the cell, and a share of its measure."""


def cuts(cell: Straight, coefficients: Sequence[Coefficient], degree: int | str) -> list[ca.Function]:
    """The affine switches of coefficients at which cells are cut.

    The midpoint rule is taken as it is: its points would be where a coefficient jumps.
    """
    is_cut = degree != MIDPOINT and is_split(coefficients, degree, cell.X.shape[1])
    return affine_switches(coefficients) if is_cut else []


def piecewise(cell: Straight, coefficients: Sequence[Coefficient], degree: int | str) -> Rule:
    """The cell's rule on each of its pieces between the affine switches of coefficients."""
    rule = list(cell.rule(degree))
    return [
        (corners @ points, share * weight)
        for corners, share in pieces_of(cell, cuts(cell, coefficients, degree))
        for points, weight in rule
    ]


def pieces_of(cell: Straight, switches: Sequence[ca.Function]) -> list[tuple[Expression, Expression]]:
    """Barycentric coordinates (corners, corners) of the corners of pieces, one column each, and their shares.

    Where a switch has no zero in the cell it makes pieces without measure.
    """
    corners = ca.horzsplit(ca.SX.eye(cell.X.shape[1]))
    pieces: list[Piece] = [([ca.vertcat(0, corner) for corner in corners], ca.SX(1))]
    for switch in switches:
        pieces = [part for piece in pieces for part in _cut(_valued(piece, cell, switch))]
    return [(ca.horzcat(*corners)[1:, :], share) for corners, share in pieces]


def _valued(piece: Piece, cell: Straight, switch: ca.Function) -> Piece:
    """The same piece with the values of a switch."""
    corners = [ca.vertcat(switch(*ca.vertsplit(cell.X @ corner[1:])), corner[1:]) for corner in piece[0]]
    return corners, piece[1]


def _cut(piece: Piece) -> Iterator[Piece]:
    """Two pieces of an edge, four of a triangle, where the switch has one sign on each.

    A triangle is halved from its middle value to the zero between the other two corners, and each half once
    more on the side that is left.
    """
    corners, share = piece
    if len(corners) == 2:
        yield from _halved(piece, 0, 1)
        return
    for i in (0, 1, 0):
        first, second = corners[i : i + 2]
        ascend = first[0] <= second[0]
        corners[i : i + 2] = ca.if_else(ascend, first, second), ca.if_else(ascend, second, first)
    low, high = _halved((corners, share), 0, 2)
    yield from _halved(low, 0, 1)
    yield from _halved(high, 1, 2)


def _halved(piece: Piece, i: int, j: int) -> Iterator[Piece]:
    """The piece without corner j, then without corner i: the zero on the side between them is in its place.

    Without a zero there it is corner i.
    """
    corners, share = piece
    a, b = corners[i], corners[j]
    has_zero = a[0] * b[0] < 0
    at = ca.if_else(has_zero, a[0] / ca.if_else(has_zero, a[0] - b[0], 1), 0)  # derivatives are numbers too
    zero = (1 - at) * a + at * b
    yield [zero if k == j else corner for k, corner in enumerate(corners)], at * share
    yield [zero if k == i else corner for k, corner in enumerate(corners)], (1 - at) * share
