"""Whether a computed displacement is admissible, so that its energy bounds the least one from above."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.conditions import ROUNDING, SAMPLE_POINTS, Conditions
from rmesh_nlp.certificate.integrals import values_at
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.coefficients import Coefficient

GIVEN = "the given displacement is not linear on every edge"
"""Of a fault that no stand-off removes."""

LATTICE = 4
"""Parts of an edge of the lattice in a triangle on which an obstacle in the interior is looked at."""


def displacement_faults(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, displacement: Array
) -> tuple[str, ...]:
    """Reasons why the displacement is not known to be admissible; none if it is."""
    faults = []
    if conditions.given_error > ROUNDING:
        faults.append(f"upper: {GIVEN}, and held at nodes only")
    depth = penetration(problem, skeleton, conditions, displacement)
    if depth > 0:
        faults.append(
            f"upper: the gap holds at the nodes only; between them it may be violated by {depth:.2e}"
        )
    return tuple(faults)


def penetration(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, displacement: Array
) -> float:
    """How deep the body may penetrate the obstacle; 0 if it provably does not.

    The gap is the linear displacement plus the offset. Where the offset is linear or concave on an
    edge, a gap that is not negative at the ends is so in between. Elsewhere the offset is sampled,
    and what its second differences allow between samples is added.
    """
    size = float(np.max(np.abs(displacement), initial=0.0))
    depth = 0.0
    for obstacle in problem.obstacles:
        if obstacle.boundary is Place.INTERIOR:
            corners, cells = skeleton.nodes[:, skeleton.triangles], skeleton.triangles
            u = obstacle.normal[0] * displacement[0][cells]
            depth = max(depth, _in_triangles(obstacle.offset, corners, u, size))
    for part in conditions.parts:
        cells = skeleton.ends[:, part.edges]
        u = np.einsum("c,cve->ve", part.obstacle.normal, displacement[:, cells])
        depth = max(depth, _on_edges(part.obstacle.offset, skeleton.nodes[:, cells], u, size))
    return depth


def _on_edges(offset: Coefficient, corners: Array, u: Array, size: float) -> float:
    if u.shape[1] == 0:
        return 0.0
    samples = values_at(offset, corners, SAMPLE_POINTS)
    bend = np.diff(samples, 2, axis=0)
    gap = samples + SAMPLE_POINTS.T @ u
    small = ROUNDING * max(size, float(np.max(np.abs(samples))))
    concave = np.max(bend, axis=0) <= small
    between = np.where(concave, 0.0, np.max(np.abs(bend), axis=0) / 4)
    least = np.where(concave, np.min(gap[[0, -1]], axis=0), np.min(gap, axis=0) - between)
    depth = float(np.max(-least))
    return depth if depth > small else 0.0


def _in_triangles(offset: Coefficient, corners: Array, u: Array, size: float) -> float:
    points = [(i, j) for i in range(LATTICE + 1) for j in range(LATTICE + 1 - i)]
    place = {point: number for number, point in enumerate(points)}
    barycentric = np.array([[LATTICE - i - j, i, j] for i, j in points]).T / LATTICE
    samples = values_at(offset, corners, barycentric)
    gap = samples + barycentric.T @ u
    middle = [(i, j) for i, j in points if i > 0 and j > 0 and i + j < LATTICE]

    def bends(di: int, dj: int) -> Array:
        rows = [
            samples[place[i + di, j + dj]] - 2 * samples[place[i, j]] + samples[place[i - di, j - dj]]
            for i, j in middle
        ]
        return np.array(rows)

    one, two, across = bends(1, 0), bends(0, 1), bends(1, -1)
    mixed = (one + two - across) / 2
    top = (one + two) / 2 + np.hypot((one - two) / 2, mixed)  # larger eigenvalue of the second differences
    small = ROUNDING * max(size, float(np.max(np.abs(samples))))
    concave = np.max(top, axis=0) <= small
    between = np.where(concave, 0.0, np.max(np.abs([one, two, across]), axis=(0, 1)))
    least = np.where(concave, np.min(gap, axis=0), np.min(gap, axis=0) - between)
    depth = float(np.max(-least))
    return depth if depth > small else 0.0
