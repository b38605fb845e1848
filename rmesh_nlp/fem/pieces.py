"""Pieces of straight triangles and edges on which coefficients are smooth, as expressions of the corners.

They follow the nodes, so that a rule on each of them has nothing to gain by a node that goes past a jump. The
assessment has pieces as numbers, and of switches of any kind: :mod:`rmesh_nlp.assessment.parts`.
"""

from __future__ import annotations

from collections.abc import Sequence

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
    """The cell's rule on each of its pieces between the affine switches of coefficients.

    Where a switch has no zero in the cell it makes pieces without measure.
    """
    corners = ca.horzsplit(ca.SX.eye(cell.X.shape[1]))
    pieces: list[Piece] = [([ca.vertcat(0, corner) for corner in corners], ca.SX(1))]
    for switch in cuts(cell, coefficients, degree):
        pieces = [part for piece in pieces for part in _cut(_valued(piece, cell, switch))]
    rule = list(cell.rule(degree))
    return [
        (ca.horzcat(*corners)[1:, :] @ points, share * weight)
        for corners, share in pieces
        for points, weight in rule
    ]


def _valued(piece: Piece, cell: Straight, switch: ca.Function) -> Piece:
    """The same piece with the values of a switch."""
    corners = [ca.vertcat(switch(*ca.vertsplit(cell.X @ corner[1:])), corner[1:]) for corner in piece[0]]
    return corners, piece[1]


def _cut(piece: Piece) -> list[Piece]:
    """Two pieces of an edge, three of a triangle, where the switch has one sign on each.

    In a triangle p is a corner between whose opposite ones the switch has no zero.
    """
    corners, share = piece
    if len(corners) == 2:
        zero, at = _zero(*corners)
        return [([corners[0], zero], at * share), ([zero, corners[1]], (1 - at) * share)]
    p, q, r = corners
    is_first, is_second = q[0] * r[0] >= 0, p[0] * r[0] >= 0
    p, q, r = (
        ca.if_else(is_first, a, ca.if_else(is_second, b, c)) for a, b, c in ((p, q, r), (q, r, p), (r, p, q))
    )
    (on_q, to_q), (on_r, to_r) = _zero(p, q), _zero(p, r)
    three = [p, on_q, on_r], [on_q, q, r], [on_q, r, on_r]
    return list(zip(three, [to_q * to_r * share, (1 - to_q) * share, to_q * (1 - to_r) * share], strict=True))


def _zero(a: Expression, b: Expression) -> tuple[Expression, Expression]:
    """The zero of the switch between two corners, a where there is none, and how far it is on the way."""
    has_zero = a[0] * b[0] < 0
    at = ca.if_else(has_zero, a[0] / ca.if_else(has_zero, a[0] - b[0], 1), 0)  # derivatives are numbers too
    return (1 - at) * a + at * b, at
