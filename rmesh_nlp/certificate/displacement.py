"""The energy of a computed displacement, and whether it is admissible: then it bounds the least energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.certificate.conditions import ROUNDING, SAMPLE_POINTS, Conditions
from rmesh_nlp.certificate.integrals import Loads, edge_rule, values_at, work
from rmesh_nlp.certificate.skeleton import Skeleton, gradients
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.laws import Laplace

FRICTION_POINTS = 12
"""Gauss points on each part of a contact edge on which the slip has one sign."""


@dataclass(frozen=True)
class Potential:
    """J(u) and its parts.

    Attributes
    ----------
    energy : float
        J(u), friction included.
    norm : float
        Energy norm of u, the root of twice the strain energy.
    friction : (contact edges,) array
        Integrals of the friction bound times the slip.
    traction_doubt : float
        What quadrature of the tractions may have changed.
    """

    energy: float
    norm: float
    friction: Array
    traction_doubt: float


def potential(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, load: Loads, displacement: Array
) -> Potential:
    """The potential energy of a piecewise linear displacement (components, nodes)."""
    slope = gradients(displacement, skeleton)
    strain = 0.0
    for law, elements in problem.regions:
        part, area = slope[..., elements], skeleton.areas[elements]
        if isinstance(law, Laplace):
            strain += 0.5 * law.conductivity * float(np.sum(part**2 * area))
            continue
        sym = (part + part.transpose(1, 0, 2)) / 2
        trace = part[0, 0] + part[1, 1]
        density = 0.5 * law.in_plane_lambda * trace**2 + law.lame_mu * np.sum(sym**2, axis=(0, 1))
        strain += float(np.sum(density * area))
    of_load = float(np.sum(work(load.moments, displacement, skeleton)))
    ends = displacement[:, skeleton.ends]
    traction = float(np.sum(conditions.traction * ends * skeleton.lengths))
    friction = _friction(problem, skeleton, conditions, displacement)
    largest = float(np.max(np.abs(displacement), initial=0.0))
    doubt = float(np.sum(conditions.traction_doubt * (np.abs(ends) + largest) * skeleton.lengths))
    return Potential(
        strain - of_load - traction + float(np.sum(friction)), float(np.sqrt(2 * strain)), friction, doubt
    )


def _friction(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, displacement: Array
) -> Array:
    """Integrals of the bound times |slip|, on each side of the point where a linear slip changes sign."""
    contact = conditions.contact
    if not problem.frictional:
        return np.zeros(contact.size)
    corners = skeleton.nodes[:, skeleton.ends[:, contact]]
    a, b = np.einsum("ej,jme->me", conditions.axes[:, 0], displacement[:, skeleton.ends[:, contact]])
    turn = np.where(a * b < 0, np.abs(a) / np.maximum(np.abs(a) + np.abs(b), 1e-300), 1.0)
    point = corners[:, 0] + turn * (corners[:, 1] - corners[:, 0])
    total = np.zeros(contact.size)
    barycentric, weights = edge_rule(FRICTION_POINTS)
    for start, stop, share, first, last in (
        (corners[:, 0], point, turn, a, np.where(a * b < 0, 0.0, b)),
        (point, corners[:, 1], 1 - turn, np.zeros_like(b), b),
    ):
        ends = np.stack([start, stop], axis=1)
        bound = np.zeros((barycentric.shape[1], contact.size))
        for part in conditions.parts:
            bound[:, part.place] = values_at(part.obstacle.friction, ends[:, :, part.place], barycentric)
        slip = np.abs(barycentric.T @ np.stack([first, last]))
        total += share * (weights @ (bound * slip))
    return np.asarray(total * skeleton.lengths[contact])


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
