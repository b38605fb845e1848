"""hr: refine where the energy gains most, relocate, repeat, to a given number of nodes or error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.cascade import CascadeSettings, cascade
from rmesh_nlp.models.flips import POOR, energy_of, flip_edges, mean_around, mended
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import edge_gains, marked, regularised
from rmesh_nlp.models.regularised_descent import descend
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.problem.contact_problem import locally_refined
from rmesh_nlp.settings import check_positive

EFFECTIVITY = 0.65
"""Sum of the edge gains over the error of the energy, on Example 6.1 refined locally (0.60 to 0.73)."""


@dataclass(frozen=True)
class Stage:
    """A mesh of hr: the problem on it, its energy, the estimated error of the energy, what was done."""

    problem: ContactProblem
    energy: float
    error_estimate: float
    iterations: int
    flips: int


def hr(
    problem: ContactProblem,
    *,
    nodes: int | None = None,
    error: float | None = None,
    flips: bool = True,
    settings: CascadeSettings | None = None,
    max_stages: int = 20,
) -> tuple[Stage, ...]:
    """Relocate, then refine, flip and relocate in turn; all meshes, coarsest first.

    Over curved foundations gaps hold along edges (:mod:`rmesh_nlp.fem.edge_gaps`).

    The problem is without move limits. It ends with the first mesh that has so many ``nodes``, or an
    estimated ``error`` of the energy that is at most this; one of them must be given.
    """
    if nodes is None and error is None:
        raise BadInputError("hr needs a number of nodes or an error to end with")
    check_positive(nodes=nodes, error=error, max_stages=max_stages)
    if problem.motion.delta is not None:
        raise BadInputError('hr needs a problem without move limits: delta = "none"')
    chosen = settings or CascadeSettings()
    problem = with_edge_gaps(problem)
    first = cascade(problem, chosen)
    given = np.asarray(problem.mesh.p)
    here = _at(problem, first.energy.relocation.nodes(first.q))
    stages = [_stage(here, sum(level.iterations for level in first.levels), 0)]
    while len(stages) < max_stages:
        last = stages[-1]
        enough = nodes is not None and last.problem.mesh.p.shape[1] >= nodes
        if enough or (error is not None and last.error_estimate <= error):
            break
        here = locally_refined(last.problem, marked(edge_gains(last.problem)))
        given = _with_new_nodes(given, last.problem, here)
        gain, count = float(edge_gains(here).sum()) / EFFECTIVITY, 0
        here, iterations = _relocated(here, given, gain, chosen)
        if flips:
            result = flip_edges(here, gain)
            here, count = result.problem, result.flips
            here, more = _relocated(here, given, gain, chosen)
            iterations += more
        stages.append(_stage(here, iterations, count))
    return tuple(stages)


def _with_new_nodes(given: Array, coarse: ContactProblem, fine: ContactProblem) -> Array:
    """Where the nodes of a locally refined mesh would be on the mesh as given: new ones amid their edges."""
    mesh, n = coarse.mesh, given.shape[1]
    tree = cKDTree(mesh.p[:, mesh.facets].mean(axis=1).T)
    _, edge = tree.query(np.asarray(fine.mesh.p)[:, n:].T)
    return np.hstack([given, given[:, mesh.facets[:, edge]].mean(axis=1)])


def reference_as_given(given: Array, triangles: NDArray) -> Array:
    """(2, 3, elements) what elements are compared with: their nodes where they were on the mesh as given.

    If every stage were measured against the one before, elements would degenerate from stage to stage. One
    that is flat or inverted there is compared with an equilateral triangle of the mean area around.
    """
    areas = signed_areas(given, triangles)
    around = mean_around(triangles, np.maximum(areas, 0.0), given.shape[1])[triangles].mean(axis=0)
    return mended(given, triangles, areas < POOR * around, around)


def _relocated(
    problem: ContactProblem, given: Array, gain: float, settings: CascadeSettings
) -> tuple[ContactProblem, int]:
    problem = replace(problem, reference=reference_as_given(given, problem.triangles))
    objective = regularised(gain, settings.regularisation, settings.distortion)
    energy = ReducedEnergy.of(ContactSolver(problem), objective)
    q = np.zeros(energy.relocation.n_q)
    result = descend(
        energy,
        q,
        approximate=True,
        gain_tolerance=settings.end,
        reference=energy(q).value + gain,
        max_iterations=settings.brief,
    )
    return _at(problem, energy.relocation.nodes(result.x)), result.iterations


def _at(problem: ContactProblem, positions: Array) -> ContactProblem:
    return replace(problem, mesh=relocated_mesh(problem.mesh, positions))


def _stage(problem: ContactProblem, iterations: int, flips: int) -> Stage:
    error = float(edge_gains(problem).sum()) / EFFECTIVITY
    return Stage(replace(problem, reference=None), energy_of(problem), error, iterations, flips)
