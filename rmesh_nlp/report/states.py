"""A solution on a mesh as pictures need it, before or after the relocation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.active_set import solve, touching_set
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.io.kept_problem import KeptSolution
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.report.foundations import Foundation, foundations
from rmesh_nlp.solving.solution import Solution

Drawable = Solution | KeptSolution
"""What pictures of a relocation are drawn from: a solution, or one that was read back."""

CLOSED = 1e-9
"""A gap below this part of the largest displacement is closed."""


@dataclass(frozen=True)
class State:
    """Fields on one mesh.

    Attributes
    ----------
    problem : ContactProblem
    nodes : (2, nodes) array
    displacement : (components, nodes) array
    pressure : (nodes,) array
    stress : (elements,) array
        Von Mises stress, or the length of the flux of a scalar problem.
    foundations : list of Foundation
    """

    problem: ContactProblem
    nodes: Array
    displacement: Array
    pressure: Array
    stress: Array
    foundations: list[Foundation]

    @property
    def elastic(self) -> bool:
        """Whether the displacement has two components."""
        return self.displacement.shape[0] == 2

    @property
    def size_of_displacement(self) -> Array:
        """u, or its length."""
        return np.linalg.norm(self.displacement, axis=0) if self.elastic else self.displacement[0]

    @property
    def closed(self) -> NDArray[np.bool_]:
        """(elements,) those of an interior contact set whose nodes all touch the obstacle."""
        closed = np.zeros(self.problem.mesh.t.shape[1], dtype=bool)
        for part in self.problem.obstacles:
            if part.boundary is Place.INTERIOR:
                gap = self.displacement[0] + part.distances(self.nodes)
                touching = gap <= CLOSED * np.max(np.abs(self.displacement), initial=0.0)
                closed |= np.all(touching[self.problem.triangles], axis=0)
        return closed


def before(problem: ContactProblem, pressure: Array | None = None) -> State:
    """The contact solution on the mesh as given, by one contact solve.

    A contact ``pressure`` (nodes,) on a similar mesh saves it the search for the nodes that touch.
    """
    model = ContactSolver(problem)
    nodes = np.asarray(problem.mesh.p)
    system = model.system(nodes)
    start = None if pressure is None else touching_set(system, pressure[model.contact_nodes] > 0)
    state = solve(system, start)
    pressure = np.zeros(nodes.shape[1])
    if state.normal_force.size:
        np.add.at(pressure, model.contact_nodes, state.normal_force / nodal_weights(problem, nodes))
    return _state(problem, nodes, model.displacement.values(state.u), pressure)


def after(solution: Drawable) -> State:
    """The solution itself."""
    return _state(
        solution.problem, np.asarray(solution.mesh.p), solution.displacement, np.asarray(solution.pressure)
    )


def _state(problem: ContactProblem, nodes: Array, displacement: Array, pressure: Array) -> State:
    stress = stresses(problem, nodes, displacement)
    size = np.linalg.norm(stress, axis=0) if problem.components == 1 else von_mises(stress)
    return State(problem, nodes, displacement, pressure, size, foundations(problem, nodes))
