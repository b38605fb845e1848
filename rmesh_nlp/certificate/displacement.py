"""The energy of a computed displacement, and whether it is admissible: then it bounds the least energy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.assessment.energy import friction_energy
from rmesh_nlp.certificate.conditions import DEVIATION, SAMPLE_POINTS, Conditions
from rmesh_nlp.certificate.integrals import Loads, values_at
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Motion, Place
from rmesh_nlp.problem.body import Body, Edges
from rmesh_nlp.problem.coefficients import Coefficient

GIVEN = "the given displacement is not linear on every edge"
"""Of a fault that no stand-off removes."""

LATTICE = 4
"""Parts of an edge of the lattice in a triangle on which an obstacle in the interior is looked at."""


@dataclass(frozen=True)
class Potential:
    """J(u) of a piecewise linear displacement, and its parts."""

    energy: float  # J(u), friction included
    norm: float  # energy norm of u, the root of twice the strain energy
    friction: Array  # (contact edges,), integrals of the friction bound times the slip
    traction_doubt: float  # what quadrature of the tractions may have changed


def potential(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, load: Loads, strain: float, u: Array
) -> Potential:
    """The potential energy of a displacement ``u`` (components, nodes) with a known strain energy."""
    along = u[:, skeleton.along(skeleton.order)]
    traction = float(np.sum(conditions.traction * along * skeleton.lengths))
    size = np.abs(along) + np.max(np.abs(u), initial=0.0)
    friction = np.zeros(conditions.contact.size)
    if problem.frictional:
        straight = replace(problem, motion=Motion(None)) if problem.motion.curves else problem
        body = Body(straight, skeleton.nodes)
        for part in conditions.parts:
            at_edges = along[:, :, part.edges]
            friction[part.place] = friction_energy(Edges(body, part.edges), part.obstacle, at_edges)[0]
    return Potential(
        strain - load.work(u, skeleton) - traction + float(np.sum(friction)),
        float(np.sqrt(2 * strain)),
        friction,
        float(np.sum(conditions.traction_doubt * size * skeleton.lengths)),
    )


def displacement_faults(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, displacement: Array
) -> tuple[str, ...]:
    """Reasons why the displacement is not known to be admissible; none if it is."""
    faults = []
    if conditions.given_error > DEVIATION:
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
    inside = [o for o in problem.obstacles if o.boundary is Place.INTERIOR]
    found = [(o, skeleton.triangles, _LATTICE_POINTS) for o in inside]
    found += [(part.obstacle, skeleton.ends[:, part.edges], SAMPLE_POINTS) for part in conditions.parts]
    size = float(np.max(np.abs(displacement), initial=0.0))
    depths = [0.0]
    for obstacle, cells, points in found:
        if cells.size:
            along = np.einsum("c,cve->ve", obstacle.normal, displacement[:, cells])
            depths.append(_depth(obstacle.offset, skeleton.nodes[:, cells], along, points, size))
    return max(depths)


def _depth(offset: Coefficient, corners: Array, along: Array, points: Array, size: float) -> float:
    samples = values_at(offset, corners, points)
    gap = samples + points.T @ along
    small = DEVIATION * max(size, float(np.max(np.abs(samples))))
    if len(points) == 2:
        top = bends = np.diff(samples, 2, axis=0)
        share = 1 / 2  # what a kink halfway between two samples lies below them
    else:
        one, two, across = bends = np.einsum("k,kdpe->dpe", (1.0, -2.0, 1.0), samples[_TRIPLES])
        mixed = (one + two - across) / 2
        top = (one + two) / 2 + np.hypot((one - two) / 2, mixed)  # larger eigenvalue
        share = 1.0
    concave = np.max(top, axis=0) <= small
    between = share * np.max(np.abs(bends).reshape(-1, samples.shape[1]), axis=0)
    vertices = np.argmax(points, axis=1)
    least = np.where(concave, np.min(gap[vertices], axis=0), np.min(gap, axis=0) - between)
    depth = float(np.max(-least))
    return depth if depth > small else 0.0


_PLACES = [(i, j) for i in range(LATTICE + 1) for j in range(LATTICE + 1 - i)]
_LATTICE_POINTS = np.array([[LATTICE - i - j, i, j] for i, j in _PLACES]).T / LATTICE
_TRIPLES = np.array(
    [
        [
            [_PLACES.index((i + k * di, j + k * dj)) for i, j in _PLACES if i * j and i + j < LATTICE]
            for di, dj in ((1, 0), (0, 1), (1, -1))
        ]
        for k in (1, 0, -1)
    ]
)
"""(3, 3 directions, inner points) numbers of the points of second differences."""
