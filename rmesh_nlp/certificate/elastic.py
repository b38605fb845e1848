"""The equilibrated stress of an elastic problem."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.equilibration import LocalSystems, balance
from rmesh_nlp.certificate.field import (
    EquilibratedField,
    Guess,
    Loads,
    doubtful_work,
    end_values,
    gradients,
    work,
)
from rmesh_nlp.certificate.johnson_mercier import MASS, JohnsonMercier, thirds
from rmesh_nlp.certificate.johnson_mercier import gradients as slopes
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
    balanced, remainder = simplified(load, skeleton)
    elements = JohnsonMercier(skeleton, lam, mu, balanced)
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
    softest = np.minimum(2 * mu, 2 * (lam + mu))
    return EquilibratedField(
        values=stress.mean(axis=(0, 1)),
        energy=elements.energy(stress),
        defect=np.sqrt(2 * elements.energy(correction)),
        forces=forces,
        balance=found,
        residual=residual(elements, stress, forces),
        load_remainder=remainder,
        load_work=np.where(
            load.constant, 0.0, work(load.moments, u, skeleton) - _work(balanced, u, skeleton)
        ),
        load_doubt=doubtful_work(load.doubt, u, skeleton),
        gradient_by_energy=korn(skeleton) / np.sqrt(softest),
        obstacle_work=np.zeros(mu.size),
        obstacle_gap=np.zeros(mu.size),
    )


def simplified(load: Loads, skeleton: Skeleton) -> tuple[Array, Array]:
    """A body force that is constant on each third of an element, and what it leaves out.

    It has the same force and moment on each element.

    Returns
    -------
    balanced : (2, 3 thirds, elements) array
    remainder : (elements,) array
        L2 norm of the body force less the simplified one.
    """
    means = load.moments.sum(axis=1, keepdims=True)
    linear = 12 * load.moments - 3 * means  # values at the vertices of the best linear approximation
    shares = (np.ones((3, 3)) * 4 - 3 * np.eye(3)) / 9  # of the vertices at the barycentres of the thirds
    flat = np.einsum("ij,cje->cie", shares, linear)
    corners = skeleton.nodes[:, skeleton.triangles]
    arms = corners - skeleton.centres[:, None]
    third_arms = np.einsum("ij,cje->cie", shares, arms)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = np.einsum("dc,cie->die", turn, arms)
    turned_thirds = np.einsum("dc,cie->die", turn, third_arms)
    moment = np.einsum("cie,cie->e", load.moments, turned)
    missing = moment - np.einsum("cie,cie->e", flat, turned_thirds) / 3
    flat = flat + missing / (np.sum(turned_thirds**2, axis=(0, 1)) / 3) * turned_thirds
    beyond_linear = np.maximum(load.square - np.sum(load.moments * linear, axis=(0, 1)), 0.0)
    on_thirds = np.einsum("ijk,cke->cije", _vertices_of_thirds(), linear) - flat[:, :, None]
    beyond_flat = np.einsum("cile,lm,cime->e", on_thirds, MASS, on_thirds, optimize=True) / 3
    remainder = np.sqrt(skeleton.areas) * (np.sqrt(beyond_linear) + np.sqrt(np.maximum(beyond_flat, 0.0)))
    flat[:, :, load.constant] = means[:, :, load.constant]
    return flat, np.where(load.constant, 0.0, remainder)


def _vertices_of_thirds() -> Array:
    """(3 thirds, 3 vertices, 3) barycentric coordinates of the vertices of the thirds."""
    corners = np.eye(3)
    return np.stack([np.stack([corners[j], corners[k], np.full(3, 1 / 3)]) for j, k in AFTER])


def _work(balanced: Array, u: Array, skeleton: Skeleton) -> Array:
    """(elements,) work of the simplified body force on a displacement."""
    shares = (np.ones((3, 3)) * 4 - 3 * np.eye(3)) / 9
    local = np.einsum("ij,cje->cie", shares, u[:, skeleton.triangles])
    return np.asarray(np.sum(balanced * local, axis=(0, 1)) * skeleton.areas / 3)


def _stress_of(u: Array, skeleton: Skeleton, lam: Array, mu: Array) -> Array:
    """(1, 1, 3, elements) stress xx, yy, xy of a piecewise linear displacement."""
    slope = gradients(u, skeleton)
    trace = lam * (slope[0, 0] + slope[1, 1])
    rows = [trace + 2 * mu * slope[0, 0], trace + 2 * mu * slope[1, 1], mu * (slope[0, 1] + slope[1, 0])]
    return np.stack(rows)[None, None]


def _edge_forces(stress: Array, skeleton: Skeleton) -> Array:
    """(elements, 12) forces of a constant stress (3, elements), as the elements count them."""
    through = np.stack([_traction(stress, skeleton.normals[:, i]) for i in range(3)])
    return np.repeat(through[:, None], 2, axis=1).reshape(12, -1).T


def residual(elements: JohnsonMercier, stress: Array, forces: Array) -> float:
    """Largest violation of equilibrium, measured on the stress itself, relative to the largest force.

    Divergence on each third, tractions between the thirds, and tractions on the edges, which
    must be those that the edges exchange.
    """
    skeleton = elements.skeleton
    corners = thirds(skeleton.nodes[:, skeleton.triangles])  # (2, vertices, thirds, elements)
    slope = slopes(corners)
    xx, yy, xy = np.moveaxis(stress, 2, 0)
    divergence = np.stack(
        [
            np.einsum("lie,ile->ie", slope[0], xx) + np.einsum("lie,ile->ie", slope[1], xy),
            np.einsum("lie,ile->ie", slope[0], xy) + np.einsum("lie,ile->ie", slope[1], yy),
        ]
    )
    area = skeleton.areas
    inside = np.abs(divergence + elements.load) * area / 3
    worst = float(np.max(inside, initial=0.0))
    largest = max(float(np.max(np.abs(forces), initial=0.0)), float(np.max(np.abs(elements.load) * area)))
    normals = skeleton.normals
    for i, (j, k) in enumerate(AFTER):
        for end in range(2):
            found = _traction(stress[i, end], normals[:, i])
            wanted = forces.reshape(-1, 3, 2, 2)[:, i, end].T
            worst = max(worst, float(np.max(np.abs(found - wanted))))
        along = corners[:, 2, i] - skeleton.nodes[:, skeleton.triangles[i]]
        across = np.stack([along[1], -along[0]])
        # vertex i belongs to thirds j (as its second corner) and k (as its first)
        for one, two in ((stress[j, 1], stress[k, 0]), (stress[j, 2], stress[k, 2])):
            worst = max(worst, float(np.max(np.abs(_traction(one - two, across)))))
    return worst / max(largest, 1e-300)


def _traction(stress: Array, normal: Array) -> Array:
    """(2, elements) product of stresses (3, elements) and vectors."""
    return np.stack(
        [stress[0] * normal[0] + stress[2] * normal[1], stress[2] * normal[0] + stress[1] * normal[1]]
    )
