"""Gaps that hold along contact edges, and not at their nodes only.

A displacement that is linear on the edges keeps a convex foundation out of the body at the nodes, and lets it
pass in between: by ``k h^2 / 8`` on an edge of length h at a curvature k. To first order the energy is too
low by ``k p h^3 / 12`` at a pressure p, and relocation can gain by making edges longer. Here every node keeps
off by as much as its edges need; then the admissible displacements of the mesh are admissible for the
continuous problem, and an energy below the exact one is impossible on the same domain.

The arc of a foundation above its chord on the edge e is ``a = max(I d - d, 0)``, d its distance and I d the
interpolant at the ends. At the node i it asks for twice ``sum_e int_e phi_i a / sum_e int_e phi_i``, with
phi_i the hat function. For a parabola and edges of lengths h and l that is ``k (h^2 - h l + l^2) / 6``, at
least ``k max(h, l)^2 / 8``: enough for both edges, smooth in the positions, and of second order. Where the
foundation is concave gaps at nodes suffice already, and nothing is added.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.fem.fields import Index
from rmesh_nlp.problem import ContactProblem, Obstacle, Place

DEGREE = 7
"""Degree of the Gauss rule along an edge."""

ENOUGH = 2.0
"""How many times the mean height of the arcs a node keeps off: the least that is enough for any two edges."""


POWER = 4
"""In the interior a node keeps off by the norm with this power of the mean heights on its edges: at least
their largest. Inside a triangle a paraboloid rises above its interpolant by ``k h^2 / 6``, on an edge by
``k h^2 / 8``; twice the mean height is ``k h^2 / 6``."""

TINY = 1e-200
"""Added below the root, which has no derivative at zero."""

SMALL = 0.35
"""Height of an arc, relative to the root mean square along its edge, below which it counts less; the least of
a parabola is 0.396 of that."""

ROUNDING = 1e-14
"""Height over the length of an edge that is rounding."""

STRAIGHT = 1e-9
"""Height of an arc over the largest distance of its foundation up to which it is rounding."""


def with_edge_gaps(problem: ContactProblem) -> ContactProblem:
    """The problem with gaps that hold along edges wherever a foundation rises above a chord of its edges.

    It is returned as it is if none does.
    """
    chosen = tuple(
        replace(obstacle, gap="edge") if _rises(problem, obstacle) else obstacle
        for obstacle in problem.obstacles
    )
    return problem if chosen == problem.obstacles else replace(problem, obstacle=chosen)


def _rises(problem: ContactProblem, obstacle: Obstacle) -> bool:
    if obstacle.gap == "edge":
        return False
    ends = problem.mesh.p[:, edges_of(problem, obstacle)]
    at_ends = [obstacle.distances(ends[:, i]) for i in range(2)]
    size = max(float(np.max(np.abs(distance), initial=0.0)) for distance in at_ends)
    for t in (0.25, 0.5, 0.75):
        chord = (1 - t) * at_ends[0] + t * at_ends[1]
        arc = chord - obstacle.distances((1 - t) * ends[:, 0] + t * ends[:, 1])
        if np.max(arc, initial=0.0) > STRAIGHT * size:
            return True
    return False


def edges_of(problem: ContactProblem, obstacle: Obstacle) -> Index:
    """(2, edges) node numbers of the edges of a contact boundary, or of all edges for the interior."""
    facets = np.asarray(problem.mesh.facets, dtype=np.int64)
    if isinstance(obstacle.boundary, Place):
        return facets
    return facets[:, np.asarray(problem.mesh.boundaries[obstacle.boundary])]


def edge_gap_function(obstacle: Obstacle, components: int, sides: int) -> ca.Function:
    """``(X_e, u_i) -> (0, gap)`` of one contact node and its neighbours on ``sides`` contact edges.

    Parameters
    ----------
    obstacle : Obstacle
    components : int
        Of the displacement u_i of the node.
    sides : int
        The columns of X_e (2, 1 + sides) are the node and its neighbours.
    """
    X, u = ca.SX.sym("X", 2, 1 + sides), ca.SX.sym("u", components)
    here = obstacle.distance(X[0, 0], X[1, 0])
    points, weights = get_quadrature_line(DEGREE)
    interior = isinstance(obstacle.boundary, Place)
    height = weight = largest = 0
    for side in range(1, 1 + sides):
        step = X[:, side] - X[:, 0]
        length, there = ca.norm_2(step), obstacle.distance(X[0, side], X[1, side])
        above = [
            (1 - t) * here + t * there - obstacle.distance(X[0, 0] + t * step[0], X[1, 0] + t * step[1])
            for t in points.ravel()
        ]
        arcs = ca.dot(weights * (1 - points.ravel()), _positive_parts(ca.vertcat(*above), length))
        height, weight = height + length * arcs, weight + length / 2
        largest += (2 * arcs) ** POWER
    off = ENOUGH * ((largest + TINY) ** (1 / POWER) if interior else height / weight)
    gap = ca.dot(obstacle.direction(X[0, 0], X[1, 0]), u) + here - off
    return ca.Function("edge_gap", [ca.vec(X), u], [0, gap])


def _positive_parts(heights: ca.SX, length: ca.SX) -> ca.SX:
    """``max(a, 0)`` of the heights a of one edge, rounded off where a is small beside the others.

    Where an edge spans an inflection some heights change sign, and a kink there would stop Newton's method
    and interior points. A height below ``SMALL`` times the root mean square of all is taken less, by a smooth
    step with two continuous derivatives; those of a parabola are all larger. So on an edge within which the
    foundation turns some penetration is left: half of the arc in one of 466 random problems
    (``scripts/soak_truth.py``, seed 13092).
    """
    small = SMALL**2 * ca.sumsqr(heights) / heights.numel() + (ROUNDING * length) ** 2
    r = ca.fmin(heights**2 / small, 1)
    return ca.if_else(heights > 0, heights * r**3 * (10 - 15 * r + 6 * r**2), 0)
