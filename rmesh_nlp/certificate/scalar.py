"""The equilibrated flux of a scalar problem, with contact on a boundary or an obstacle in the interior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.equilibration import Balance, TraceSpace, balance, obstacle_balance
from rmesh_nlp.certificate.field import (
    EquilibratedField,
    Guess,
    Loads,
    doubtful_work,
    end_values,
    gradients,
    loads,
)
from rmesh_nlp.certificate.integrals import over_triangles
from rmesh_nlp.certificate.raviart_thomas import RaviartThomas
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.laws import Laplace


def equilibrated_flux(
    problem: ContactProblem, skeleton: Skeleton, conditions: Conditions, guess: Guess, max_steps: int
) -> EquilibratedField:
    """The flux of largest dual energy, or nearly so: see :mod:`rmesh_nlp.certificate.equilibration`."""
    load = loads(problem, skeleton)
    conductivity = np.zeros(skeleton.triangles.shape[1])
    for law, part in problem.regions:
        assert isinstance(law, Laplace)
        conductivity[part] = law.conductivity
    mean = load.moments[0].sum(axis=0)
    slope = None if np.all(load.constant) else 12 * load.moments[0] - 4 * mean
    elements = RaviartThomas(skeleton, conductivity, mean, slope)
    space = TraceSpace(skeleton, conditions)
    nothing = np.zeros(mean.size)
    obstacle_work, obstacle_gap, obstacle_doubt = nothing, nothing, 0.0
    if problem.obstacle.boundary is Place.INTERIOR:
        sign, psi = problem.obstacle.normal[0], over_triangles(problem.obstacle.offset, _corners(skeleton))
        found, force = obstacle_balance(
            space, elements, sign, psi.moments.sum(axis=0), _touching(skeleton, guess.pressure)
        )
        elements = replace(elements, load=mean + sign * force)
        area = skeleton.areas
        obstacle_work = -area * force * psi.moments.sum(axis=0)
        u_mean = guess.displacement[0][skeleton.triangles].mean(axis=0)
        obstacle_gap = area * force * sign * u_mean - obstacle_work
        obstacle_doubt = float(np.sum(area * force * psi.doubt.sum(axis=0)))
    else:
        pressure = end_values(guess.pressure, skeleton, conditions.contact).mean(axis=0, keepdims=True)
        none = np.zeros((0, conditions.contact.size))
        base = np.zeros((1, 1, skeleton.ends.shape[1]))
        found = balance(space, elements.stiffness, elements.source, base, pressure, none, max_steps)
    return _field(elements, load, mean, found, guess, obstacle_work, obstacle_gap, obstacle_doubt)


def _field(
    elements: RaviartThomas,
    load: Loads,
    mean: Array,
    found: Balance,
    guess: Guess,
    obstacle_work: Array,
    obstacle_gap: Array,
    obstacle_doubt: float,
) -> EquilibratedField:
    skeleton, k = elements.skeleton, elements.conductivity
    flux = elements.flux(found.traces)
    slope = gradients(guess.displacement, skeleton)[0]
    forces = elements.outflow(flux)
    total = skeleton.areas * elements.load
    scale = max(float(np.max(np.abs(forces), initial=0.0)), float(np.max(np.abs(total), initial=0.0)), 1e-300)
    linear = 12 * load.moments[0] - 3 * mean  # at the vertices: the best linear approximation
    beyond = np.maximum(load.square - np.sum(load.moments[0] * linear, axis=0), 0.0)
    remainder = np.where(load.constant, 0.0, beyond)
    u = guess.displacement
    return EquilibratedField(
        values=flux,
        energy=elements.energy(flux),
        defect=np.sqrt(2 * elements.energy(flux - k * slope)),
        forces=forces,
        balance=found,
        residual=float(np.max(np.abs(forces.sum(axis=1) + total), initial=0.0)) / scale,
        load_remainder=np.sqrt(skeleton.areas * remainder),
        load_work=np.zeros(mean.size),  # a linear displacement does not feel what is left
        load_doubt=doubtful_work(load.doubt, u, skeleton),
        gradient_by_energy=1 / np.sqrt(k),
        obstacle_work=obstacle_work,
        obstacle_gap=obstacle_gap,
        obstacle_doubt=obstacle_doubt,
    )


def _corners(skeleton: Skeleton) -> Array:
    return np.asarray(skeleton.nodes[:, skeleton.triangles])


def _touching(skeleton: Skeleton, pressure: Array) -> NDArray[np.bool_]:
    """Elements that the computed solution holds on the obstacle: those all of whose nodes are."""
    return np.asarray(np.all(pressure[skeleton.triangles] > 0, axis=0))
