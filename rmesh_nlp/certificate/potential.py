"""The potential energy of a displacement, with every term integrated as exactly as it can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.field import Loads, gradients, work
from rmesh_nlp.certificate.integrals import edge_rule, values_at
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
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
