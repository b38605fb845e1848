"""Edge flips that lower the energy at frozen nodal values.

The energy of a mesh is the minimum over its nodal values, so
``J(new mesh, new solution) <= J(new mesh, old solution) < J(old mesh, old solution)``: flips by energy are
monotone. (S. Rippa, Minimal roughness property of the Delaunay triangulation, CAGD 7 (1990) 489-497, shows
that the Delaunay mesh is the best for given values only without a load.)

Nodes, the outer boundary, interfaces and named parts stay; contact and friction are terms of nodes and
boundary edges, which flips do not touch.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.distortion import reference_shapes
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.flips import flipped
from rmesh_nlp.meshes.geometry import shape_quality
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.problem.coefficients import is_nonzero
from rmesh_nlp.problem.lines import line_facets
from rmesh_nlp.vectorised import columnwise

POOR = 0.2
"""Shape (1 if equilateral), and area over the mean around, below which a triangle of the mesh as given is no
reference for the flipped one between the same nodes."""

LEAST_GAIN = 1e-6
"""Least gain of a flip, in parts of what is to be gained: rounding must not flip an edge back and forth."""

LEAST_ROUND = 2e-3
"""Part of what is to be gained that a round of flips and relocation must give for another one to follow."""


@dataclass(frozen=True)
class FlippedProblem:
    """A problem on the same nodes with other edges; triangles keep their places in the list.

    ``changed`` triangles are others than before. ``gain`` is the decrease of the energy at the nodal values
    before, a lower bound of the decrease.
    """

    problem: ContactProblem
    flips: int
    changed: int
    gain: float


def flip_edges(problem: ContactProblem, gain_to_be_had: float) -> FlippedProblem:
    """Flip edges of the mesh of a problem as long as that lowers its energy at frozen nodal values.

    No triangle is made with a smaller angle than the motion asks for, or a smaller area than its part of the
    mean reference area around its nodes.
    """
    mesh, triangles = problem.mesh, problem.triangles
    model = ContactSolver(problem)
    values = model.displacement.values(model.solve(mesh.p).u)
    energies = ElementEnergies(problem, np.asarray(mesh.p), values)
    result = flipped(
        mesh.p,
        triangles,
        mesh.facets[:, line_facets(problem)],
        energies,
        least_gain=LEAST_GAIN * gain_to_be_had,
        allowed=Allowed(problem),
    )
    if result.flips == 0:
        return FlippedProblem(problem, 0, 0, 0.0)
    changed = np.any(np.sort(result.triangles, axis=0) != np.sort(triangles, axis=0), axis=0)
    new = with_triangles(problem, result.triangles)
    return FlippedProblem(new, result.flips, int(changed.sum()), result.gain)


class Allowed:
    """Which triangles between the nodes of a problem have the angle and area that its motion asks for."""

    def __init__(self, problem: ContactProblem) -> None:
        self._nodes, self._motion = np.asarray(problem.mesh.p), problem.motion
        shapes = reference_shapes(problem)
        a, b = shapes[:, 1] - shapes[:, 0], shapes[:, 2] - shapes[:, 0]
        self._around = mean_around(problem.triangles, (a[0] * b[1] - a[1] * b[0]) / 2, self._nodes.shape[1])

    def __call__(self, triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
        """For triangles (3, n), counter-clockwise."""
        least = self._motion.min_area_fraction * self._around[triangles].mean(axis=0)
        good = signed_areas(self._nodes, triangles) >= least
        if self._motion.min_angle > 0:
            good &= least_angles(self._nodes, triangles) >= self._motion.min_angle
        return np.asarray(good)


def mean_around(triangles: NDArray, values: Array, nodes: int) -> Array:
    """(nodes,) mean of the values (elements,) of the triangles at each node."""
    weights = (np.tile(w, 3) for w in (values, np.ones(values.size)))
    total, count = (np.bincount(triangles.ravel(), w, nodes) for w in weights)
    return np.asarray(total / np.maximum(count, 1))


def shapes_as_given(given: ContactProblem, triangles: NDArray) -> Array:
    """(2, 3, elements) triangles that those of a flipped mesh are compared with, on the mesh as given.

    A triangle is compared with the one between the same nodes where they were; if that is flat or inverted,
    with an equilateral one as large as the mean of the given ones around its nodes.
    """
    p, own = np.asarray(given.mesh.p), given.triangles
    around = mean_around(own, signed_areas(p, own), p.shape[1])[triangles].mean(axis=0)
    known = {tuple(t) for t in np.sort(own, axis=0).T.tolist()}
    new = np.array([tuple(t) not in known for t in np.sort(triangles, axis=0).T.tolist()])
    poor = (shape_quality(p, triangles) < POOR) | (signed_areas(p, triangles) < POOR * around)
    return mended(p, triangles, new & poor, around)


def mended(nodes: Array, triangles: NDArray, poor: NDArray[np.bool_], areas: Array) -> Array:
    """(2, 3, elements) triangles; in the places of poor ones equilateral ones of some areas (elements,)."""
    shapes = np.array(nodes[:, triangles])
    corner = np.array([[0.0, 1.0, 0.5], [0.0, 0.0, np.sqrt(3) / 2]])
    shapes[:, :, poor] = corner[:, :, None] * np.sqrt(4 / np.sqrt(3) * areas[poor])
    return shapes


def with_triangles(problem: ContactProblem, triangles: NDArray) -> ContactProblem:
    """The problem on the same nodes with other triangles in the places of its own; names are kept."""
    mesh = problem.mesh
    boundaries = {name: mesh.facets[:, np.asarray(f)].T for name, f in (mesh.boundaries or {}).items()}
    subdomains = {name: np.asarray(e) for name, e in (mesh.subdomains or {}).items()}
    return replace(problem, mesh=from_arrays(mesh.p.T, triangles.T, boundaries, subdomains))


@dataclass(frozen=True)
class Round:
    """One round of flips and relocation: numbers of flips and changed triangles, energies after both."""

    flips: int
    changed: int
    flipped: float
    relocated: float


def energy_of(problem: ContactProblem) -> float:
    """The energy of a problem on its mesh."""
    return ContactSolver(problem).solve(problem.mesh.p).energy


def flips_and_moves(
    problem: ContactProblem,
    gain: float,
    relocate: Callable[[ContactProblem], ContactProblem],
    *,
    given: ContactProblem,
    rounds: int = 8,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[ContactProblem, tuple[Round, ...]]:
    """Flip edges of a relocated mesh and relocate its nodes in turn, until neither gains or ``stop`` says so.

    ``relocate`` takes a problem to itself with its nodes moved. ``gain`` is the error of the energy of the
    mesh as ``given``: what there was to gain. Distortion is measured against that mesh in every round.
    """
    done: list[Round] = []
    energy = energy_of(problem)
    for _ in range(rounds):
        result = flip_edges(problem, gain)
        if result.flips == 0:
            break
        flipped_energy = energy_of(result.problem)
        shapes = shapes_as_given(given, result.problem.triangles)
        moved = relocate(replace(result.problem, reference=shapes))
        relocated = energy_of(moved)
        kept = moved if relocated < flipped_energy else result.problem
        problem = replace(kept, reference=shapes)
        now = min(relocated, flipped_energy)
        done.append(Round(result.flips, result.changed, flipped_energy, now))
        if energy - now < LEAST_ROUND * gain or stop():
            break
        energy = now
    return problem, tuple(done)


class ElementEnergies:
    """Energy of any triangle between nodes (2, n), displacements (components, n) frozen.

    Each triangle has the law of the element in whose place it is.
    """

    def __init__(self, problem: ContactProblem, nodes: Array, values: Array) -> None:
        self._nodes, self._values = nodes, values
        self._functions = []
        self._law = np.zeros(problem.mesh.t.shape[1], dtype=np.int64)
        for number, (law, elements) in enumerate(problem.regions):
            self._law[elements] = number
            functions = [strain_energy(law)]
            if any(is_nonzero(component) for component in law.load):
                functions.append(plain(*load_energy(law, problem.rule)))
            self._functions.append(functions)

    def at(self, values: Array) -> ElementEnergies:
        """The same with other nodal values."""
        other = copy(self)
        other._values = values
        return other

    def __call__(self, triangles: NDArray, elements: NDArray) -> Array:
        """Energies of ``triangles`` (3, n) in the places of ``elements`` (n,)."""
        result, law = np.zeros(triangles.shape[1]), self._law[elements]
        for number, functions in enumerate(self._functions):
            here = np.flatnonzero(law == number)
            if here.size == 0:
                continue
            # (3 * components, n) values of both fields, node by node
            columns = [
                np.moveaxis(field[:, triangles[:, here]], 0, 1).reshape(-1, here.size)
                for field in (self._nodes, self._values)
            ]
            for function in functions:
                result[here] += columnwise(function, here.size)(columns)[0].ravel()
        return result
