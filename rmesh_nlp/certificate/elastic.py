"""The equilibrated stress of an elastic problem."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.equilibration import balance
from rmesh_nlp.certificate.field import (
    EquilibratedField,
    Guess,
    Loads,
    doubtful_work,
    end_values,
    gradients,
)
from rmesh_nlp.certificate.hybrid import LocalSystems
from rmesh_nlp.certificate.johnson_mercier import JohnsonMercier, divergence, jumps, thirds, traction
from rmesh_nlp.certificate.oscillation import korn
from rmesh_nlp.certificate.skeleton import AFTER, Skeleton
from rmesh_nlp.certificate.traces import TraceSpace
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Elastic


def equilibrated_stress(
    problem: ContactProblem,
    skeleton: Skeleton,
    conditions: Conditions,
    load: Loads,
    guess: Guess,
    products: int,
) -> EquilibratedField:
    """The stress of largest dual energy, or nearly so: see :mod:`rmesh_nlp.certificate.equilibration`."""
    lam, mu = np.zeros((2, skeleton.triangles.shape[1]))
    for law, part in problem.regions:
        assert isinstance(law, Elastic)
        lam[part], mu[part] = law.in_plane_lambda, law.lame_mu
    means = load.moments.sum(axis=1, keepdims=True)
    linear = 12 * load.moments - 3 * means  # at the vertices: the best linear approximation
    linear[:, :, load.constant] = means[:, :, load.constant]
    elements = JohnsonMercier(skeleton, lam, mu, linear)
    space = TraceSpace(skeleton, conditions)
    pressure, friction = (
        end_values(nodal, skeleton, conditions.contact) for nodal in (guess.pressure, guess.friction)
    )
    u = guess.displacement
    computed = _stress_of(u, skeleton, lam, mu)
    exerted = _edge_forces(computed[0, 0], skeleton)
    local = LocalSystems(elements.stiffness, elements.source - exerted, space.base(u))
    found = balance(space, local, pressure, friction, products)
    coefficients = elements.coefficients(found.traces)
    correction = elements.stress(coefficients)
    stress, forces = computed + correction, exerted + elements.forces(coefficients)
    mean = stress[:, 3:].mean(axis=(0, 1))  # exact for quadratic stresses
    beyond = np.maximum(load.square - np.sum(load.moments * linear, axis=(0, 1)), 0.0)
    softest = np.minimum(2 * mu, 2 * (lam + mu))
    return EquilibratedField(
        values=mean,
        energy=elements.energy(stress),
        defect=np.sqrt(2 * elements.energy(correction)),
        variation=np.sqrt(2 * elements.energy(stress - mean)),
        forces=forces,
        balance=found,
        residual=residual(elements, stress, forces),
        load_remainder=np.sqrt(skeleton.areas * np.where(load.constant, 0.0, beyond)),
        load_doubt=doubtful_work(load.doubt, u, skeleton),
        gradient_by_energy=korn(skeleton) / np.sqrt(softest),
        obstacle_work=np.zeros(mu.size),
        obstacle_gap=np.zeros(mu.size),
    )


def _stress_of(u: Array, skeleton: Skeleton, lam: Array, mu: Array) -> Array:
    """(1, 1, 3, elements) stress xx, yy, xy of a piecewise linear displacement."""
    slope = gradients(u, skeleton)
    trace = lam * (slope[0, 0] + slope[1, 1])
    rows = [trace + 2 * mu * slope[0, 0], trace + 2 * mu * slope[1, 1], mu * (slope[0, 1] + slope[1, 0])]
    return np.stack(rows)[None, None]


def _edge_forces(stress: Array, skeleton: Skeleton) -> Array:
    """(elements, 12) forces of a constant stress (3, elements), as the elements count them."""
    through = np.stack([traction(stress, skeleton.normals[:, i]) for i in range(3)])
    return np.repeat(through[:, None], 2, axis=1).reshape(12, -1).T


def residual(elements: JohnsonMercier, stress: Array, forces: Array) -> float:
    """Largest violation of equilibrium, measured on the stress itself, relative to the largest force.

    Divergence on each third, tractions between the thirds, and tractions on the edges, which
    must be linear and those that the edges exchange.
    """
    skeleton = elements.skeleton
    corners = skeleton.nodes[:, skeleton.triangles]
    load, area = elements.load, skeleton.areas
    centre = load.mean(axis=1)
    wanted = np.stack([np.stack([load[:, j], load[:, k], centre], axis=1) for j, k in AFTER], axis=2)
    violations = [(divergence(stress, thirds(corners)) + wanted) * area / 3, *jumps(stress, corners)]
    exchanged = forces.reshape(-1, 3, 2, 2)
    for i in range(3):
        for end in range(2):
            found = traction(stress[i, end], skeleton.normals[:, i])
            violations.append(found - exchanged[:, i, end].T)
    largest = max(float(np.max(np.abs(forces), initial=0.0)), float(np.max(np.abs(load) * area)), 1e-300)
    return max(float(np.max(np.abs(part), initial=0.0)) for part in violations) / largest
