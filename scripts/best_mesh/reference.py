"""Reference solutions by local refinement: the least energy of a domain, and errors element by element."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.tri import Triangulation

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.fem.stress import gradients
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, signed_areas
from rmesh_nlp.problem.refining import locally_refined
from rmesh_nlp.programs.refinement import edge_gains, marked


@dataclass(frozen=True)
class Reference:
    """A solution on a locally refined mesh, and the energy that such meshes tend to."""

    problem: ContactProblem
    values: np.ndarray
    energy: float
    limit: float


def reference(problem: ContactProblem, nodes: int) -> Reference:
    """Refine where new nodes gain most, to a number of nodes; the polygon of the mesh stays.

    The energy is extrapolated from the last mesh and the one that had half as many nodes, with the rate of
    optimal meshes, one over the number of nodes.
    """
    here = replace(problem, motion=Motion(None), exact=None, reference=None)
    found: list[tuple[int, float]] = []
    while True:
        model = ContactModel(here)
        state = model.solve(here.mesh.p)
        found.append((int(here.mesh.p.shape[1]), state.energy))
        if found[-1][0] >= nodes:
            break
        here = locally_refined(here, marked(edge_gains(here)))
    last, energy = found[-1]
    before, higher = next((one for one in reversed(found) if one[0] <= last / 2), found[0])
    limit = energy - (higher - energy) * before / (last - before)
    return Reference(here, model.displacement.values(state.u), energy, limit)


def local_errors(problem: ContactProblem, fine: Reference) -> np.ndarray:
    """(elements,) half the squared energy norm of the difference to a finer solution.

    Gradients are constant on the elements of both meshes; an element of the finer one counts where its
    centroid is.
    """
    nodes, triangles = np.asarray(problem.mesh.p), problem.triangles
    model = ContactModel(problem)
    own = gradients(problem, nodes, model.displacement.values(model.solve(nodes).u))
    there = np.asarray(fine.problem.mesh.p)
    centroids = there[:, fine.problem.triangles].mean(axis=1)
    element = np.asarray(Triangulation(*nodes, triangles.T).get_trifinder()(*centroids))
    difference = gradients(fine.problem, there, fine.values) - own[..., element]
    energy = _density(fine.problem, difference) * signed_areas(there, fine.problem.triangles)
    inside = element >= 0
    return np.bincount(element[inside], energy[inside], triangles.shape[1])


def _density(problem: ContactProblem, gradient: np.ndarray) -> np.ndarray:
    result = np.zeros(gradient.shape[-1])
    for law, elements in problem.regions:
        g = gradient[..., elements]
        if isinstance(law, Laplace):
            result[elements] = law.conductivity * (g[0] ** 2).sum(axis=0) / 2
            continue
        strain = (g + np.swapaxes(g, 0, 1)) / 2
        trace = strain[0, 0] + strain[1, 1]
        result[elements] = law.in_plane_lambda * trace**2 / 2 + law.lame_mu * (strain**2).sum(axis=(0, 1))
    return result
