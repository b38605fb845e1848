"""The equilibrated flux of a scalar problem, with contact on a boundary or an obstacle in the interior."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.conditions import Conditions, NotCertifiableError
from rmesh_nlp.certificate.equilibration import balance
from rmesh_nlp.certificate.field import (
    EquilibratedField,
    Guess,
    Loads,
    doubtful_work,
    end_values,
    gradients,
)
from rmesh_nlp.certificate.hybrid import InteriorObstacle, LocalSystems
from rmesh_nlp.certificate.integrals import over_triangles
from rmesh_nlp.certificate.raviart_thomas import RaviartThomas
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.certificate.traces import TraceSpace
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.laws import Laplace


def equilibrated_flux(
    problem: ContactProblem,
    skeleton: Skeleton,
    conditions: Conditions,
    load: Loads,
    guess: Guess,
    products: int,
) -> EquilibratedField:
    """The flux of largest dual energy, or nearly so: see :mod:`rmesh_nlp.certificate.equilibration`."""
    area = skeleton.areas
    conductivity = np.zeros(area.size)
    for law, part in problem.regions:
        assert isinstance(law, Laplace)
        conductivity[part] = law.conductivity
    mean = load.moments[0].sum(axis=0)
    linear = 12 * load.moments[0] - 3 * mean  # at the vertices: the best linear approximation
    linear[:, load.constant] = mean[load.constant]
    inside = [obstacle for obstacle in problem.obstacles if obstacle.boundary is Place.INTERIOR]
    if len(inside) > 1:
        raise NotCertifiableError("there are two obstacles in the interior")
    elements = RaviartThomas(skeleton, conductivity, linear, bool(inside))
    space = TraceSpace(skeleton, conditions)
    u = guess.displacement
    computed = elements.constant(conductivity * gradients(u, skeleton)[0])
    exerted = elements.forces(computed)
    local = LocalSystems(elements.stiffness, elements.source - exerted, space.base(u))
    interior, gap, offset, doubt = None, np.zeros((area.size, 3)), np.zeros((area.size, 3)), 0.0
    if inside:
        sign = inside[0].normal[0]
        below = over_triangles(inside[0].offset, skeleton.nodes[:, skeleton.triangles])
        offset = below.moments.T
        at_vertices = u[0][skeleton.triangles].T
        gap = offset + sign * (at_vertices + at_vertices.sum(axis=1, keepdims=True)) / 12
        touching = guess.pressure[skeleton.triangles].T > 0
        interior = InteriorObstacle(sign, gap, (linear * area).T, touching)
    pressure = end_values(guess.pressure, skeleton, conditions.contact)
    found = balance(space, local, pressure, np.zeros_like(pressure), products, interior)
    correction = elements.coefficients(found.traces)
    flux, reaction = computed + correction, found.obstacle_force
    forces = elements.forces(flux)
    balanced = (linear * area).T
    if interior:
        balanced = balanced + interior.sign * reaction
        doubt = float(np.sum(reaction * below.doubt.T))
    scale = max(float(np.max(np.abs(forces[:, :6]), initial=0.0)), float(np.max(np.abs(balanced))), 1e-300)
    out = [np.abs(forces[:, :6].sum(axis=1) / 2 + balanced.mean(axis=1))]
    if interior:
        out.append(np.max(np.abs(forces[:, 6:] - balanced), axis=1))
    beyond = np.maximum(load.square - np.sum(load.moments[0] * linear, axis=0), 0.0)
    return EquilibratedField(
        values=elements.mean(flux),
        energy=elements.energy(flux),
        defect=np.sqrt(2 * np.maximum(elements.energy(correction), 0.0)),
        variation=np.sqrt(np.maximum(elements.variation(correction), 0.0)),
        forces=forces[:, :6],
        balance=found,
        residual=float(np.max(out)) / scale,
        load_remainder=np.sqrt(area * np.where(load.constant, 0.0, beyond)),
        load_doubt=doubtful_work(load.doubt, u, skeleton),
        gradient_by_energy=1 / np.sqrt(conductivity),
        obstacle_work=-np.sum(reaction * offset, axis=1),
        obstacle_gap=np.sum(reaction * gap, axis=1),
        obstacle_doubt=doubt,
    )
