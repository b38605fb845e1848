"""The energy of a computed displacement, and whether it is admissible: then it bounds the least energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.assessment.energy import friction_energy
from rmesh_nlp.assessment.parts import ZERO
from rmesh_nlp.certificate.conditions import SAMPLE_POINTS, Conditions
from rmesh_nlp.certificate.integrals import interpolated, values_at
from rmesh_nlp.certificate.polynomials import degree_of, powers
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bernstein import functions
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, Place
from rmesh_nlp.problem.body import Body, Edges

GIVEN = "the given displacement is not"
"""Begins a fault that no stand-off removes."""

KINDS = {1: "linear", 2: "quadratic"}
"""Displacements by their order."""

LATTICE = 4
"""Parts of an edge of the lattice in a triangle on which an obstacle in the interior is looked at."""


def friction_work(problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, u: Array) -> Array:
    """(contact edges,) work of the friction bound on the slip of a displacement ``u`` (components, nodes)."""
    work = np.zeros(conditions.contact.size)
    if problem.frictional:
        body = Body(replace(problem, motion=Motion(None)), skeleton.nodes)
        for part in conditions.parts:
            along = u[:, skeleton.along(skeleton.order)[:, part.edges]]
            work[part.place] = friction_energy(Edges(body, part.edges), part.obstacle, along)[0]
    return work


def displacement_faults(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, displacement: Array
) -> tuple[str, ...]:
    """Reasons why the displacement is not known to be admissible; none if it is."""
    faults = []
    if conditions.given_error > ZERO:
        faults.append(f"upper: {GIVEN} {KINDS[problem.order]} on every edge, and held at nodes only")
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

    The gap is the displacement plus the offset. Where the offset is linear or concave on an edge, a gap that
    is not negative at the ends is so in between. At order 2 a gap none of whose coefficients is negative is
    so where the offset is a parabola. Elsewhere the gap is sampled, and what its second differences allow
    between samples is added.
    """
    along = skeleton.along(skeleton.order)
    places = [
        (obstacle, skeleton.triangles, skeleton.displaced, _LATTICE_POINTS)
        for obstacle in problem.obstacles
        if obstacle.boundary is Place.INTERIOR
    ]
    for part in conditions.parts:
        places.append((part.obstacle, skeleton.ends[:, part.edges], along[:, part.edges], SAMPLE_POINTS))
    size = float(np.max(np.abs(displacement), initial=0.0))
    depths = [
        _depth(obstacle, skeleton.nodes[:, cells], displacement[:, nodes], points, size)
        for obstacle, cells, nodes, points in places
        if cells.size
    ]
    return max(depths, default=0.0)


def _depth(obstacle: Obstacle, corners: Array, u: Array, points: Array, size: float) -> float:
    samples, vertices = values_at(obstacle.offset, corners, points), len(points)
    along = np.einsum("c,cve->ve", obstacle.normal, u)
    order = degree_of(along, vertices)
    small = ZERO * max(size, float(np.max(np.abs(samples))))
    of_offset, error = interpolated(order, samples, points)
    gap = samples + functions(order, points).T @ along
    bends, steepest = _bends(samples if order == 1 else gap)
    # the gap is where its coefficients are, if the offset is of the order, or concave at order 1
    holds = (np.max(steepest, axis=0) if order == 1 else error) <= small
    # between two samples of an edge a kink halfway lies half of a second difference below them
    share = 1 / 2 if vertices == 2 else 1.0
    between = share * np.max(np.abs(bends).reshape(-1, samples.shape[1]), axis=0)
    least = np.where(holds, np.min(along + of_offset, axis=0), np.min(gap, axis=0) - between)
    depth = -float(np.min(least))
    return depth if depth > small else 0.0


def _bends(samples: Array) -> tuple[Array, Array]:
    """Second differences of samples on edges or triangles, and the largest in any direction."""
    if len(samples) == SAMPLE_POINTS.shape[1]:
        bends = np.diff(samples, 2, axis=0)
        return bends, bends
    first, second, across = bends = np.einsum("k,kdpe->dpe", (1.0, -2.0, 1.0), samples[_TRIPLES])
    mixed = (first + second - across) / 2
    return bends, (first + second) / 2 + np.hypot((first - second) / 2, mixed)  # larger eigenvalue


_LATTICE = powers(LATTICE, 3)
_LATTICE_POINTS = _LATTICE.T / LATTICE
_TRIPLES = np.array(
    [
        [
            [_LATTICE.tolist().index(list(point + k * step)) for point in _LATTICE if np.all(point > 0)]
            for step in np.array([[-1, 1, 0], [-1, 0, 1], [0, 1, -1]])
        ]
        for k in (1, 0, -1)
    ]
)
"""(3, 3 directions, inner points) numbers of the points of second differences."""
