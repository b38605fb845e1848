"""The metric start: solve, recover second derivatives, remesh in the best metric, and once more.

A mesh of a given number of nodes whose triangles suit the solution. Relocation begins there: it moves nodes but
keeps the connectivity, which bounds what it can gain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.errors import BadInputError, ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.interpolation_error import LARGEST_ASPECT, errors
from rmesh_nlp.fem.metric import Metric, best_metric
from rmesh_nlp.fem.recovery import Recovered, second_derivatives
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes.mmg import remeshed
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import on_mesh
from rmesh_nlp.problem.lines import line_facets

ROUNDS = 4
"""Most rounds on meshes of the final size."""

WORTHWHILE = 0.05
"""Fall of the energy in a round, in parts of the error that is left, for another round to follow."""

GROWTH = 4.0
"""Factor by which the nodes may grow in number in a round: a coarse mesh knows little of what a fine one needs."""

EXACT, ROUGH = 0.02, 0.2
"""Relative differences from a number of nodes on the way there, and at the end ..."""

TRIALS = 6
"""... and runs of Mmg to come that near."""

FLATTER = 0.7
"""Factor of the largest aspect ratio after a mesh with too small an angle."""


@dataclass(frozen=True)
class Solved:
    """A problem on a mesh with its contact solution and what was recovered from it."""

    solver: ContactSolver
    state: Equilibrium

    @property
    def problem(self) -> ContactProblem:
        """On its mesh."""
        return self.solver.problem

    @staticmethod
    def of(problem: ContactProblem) -> Solved:
        """Solve a problem on the mesh as given."""
        solver = ContactSolver(problem)
        return Solved(solver, solver.solve(np.asarray(problem.mesh.p)))

    def recovered(self) -> tuple[Recovered, ...]:
        """Second derivatives of the displacement."""
        displacement, space = self.solver.displacement.values(self.state.u), self.solver.discretisation.space
        return second_derivatives(self.problem, displacement[:, space.number])


def interpolation_errors(problem: ContactProblem, regions: tuple[Recovered, ...]) -> Array:
    """(elements,) estimated errors in the energy of a mesh, from recovered second derivatives."""
    found = np.zeros(problem.mesh.t.shape[1])
    corners = np.asarray(problem.mesh.p)[:, problem.triangles]
    for region in regions:
        found[region.elements] = errors(region.law, corners[:, :, region.elements], region.in_elements)
    return found


@dataclass(frozen=True)
class MetricStart:
    """Where the rounds ended: numbers of nodes and energies of all of them, and the estimated error at the end."""

    solved: Solved
    error: float
    nodes: tuple[int, ...]
    energies: tuple[float, ...]


def metric_start(first: Solved, nodes: int, is_late: Callable[[], bool] = lambda: False) -> MetricStart:
    """Remesh the domain of a problem with a number of nodes, up to two percent, in the best metric.

    Rounds go on until the energy hardly falls; the mesh of least energy counts. Once ``is_late`` no round follows.

    Raises
    ------
    BadInputError
        If mmgpy is not installed, Mmg gives up, or no mesh has the least angle of the motion.
    ProblemError
        If the contact problem cannot be solved on a new mesh.
    """
    here, ratio, best = first, float("nan"), None
    done: list[Solved] = []
    for size in _sizes(first.problem.mesh.p.shape[1], nodes):
        regions = here.recovered()
        problem, ratio = remeshed_problem(
            here.problem, regions, size, ratio, EXACT if size == nodes else ROUGH
        )
        there = Solved.of(problem)
        if there.state.status is not Status.CONVERGED:
            raise ProblemError(
                "mesh", f"the contact solve failed on a mesh of {problem.mesh.p.shape[1]} nodes"
            )
        done.append(there)
        if size == nodes:
            fall = np.inf if best is None else best.state.energy - there.state.energy
            best = there if fall > 0 else best
            if is_late() or fall < WORTHWHILE * float(
                interpolation_errors(there.problem, there.recovered()).sum()
            ):
                break
        here = there
    assert best is not None
    error = float(interpolation_errors(best.problem, best.recovered()).sum())
    counts = tuple(int(one.problem.mesh.p.shape[1]) for one in done)
    return MetricStart(best, error, counts, tuple(one.state.energy for one in done))


def _sizes(now: int, last: int) -> list[int]:
    """Numbers of nodes of the rounds."""
    found = []
    while now * GROWTH < last:
        now = int(now * GROWTH)
        found.append(now)
    return [*found, *[last] * ROUNDS]


def remeshed_problem(
    problem: ContactProblem,
    regions: Sequence[Recovered],
    nodes: int,
    ratio: float = float("nan"),
    tolerance: float = EXACT,
) -> tuple[ContactProblem, float]:
    """The problem on a mesh of a number of nodes, best for second derivatives that were recovered on its own.

    ``ratio`` is that of the triangles of the metric to the nodes of the mesh, which is returned as well: known
    from another mesh it saves runs of Mmg.
    """
    mesh, X = problem.mesh, np.asarray(problem.mesh.p)
    aspect, angle = LARGEST_ASPECT, problem.motion.min_angle
    if angle > 0:  # the least angle of an equilateral triangle that is stretched across an edge
        aspect = min(aspect, 1 / (np.sqrt(3) * np.tan(np.radians(angle) / 2)))
    while True:
        metric = best_metric(X, regions, aspect)
        if np.isnan(ratio):
            ratio = mesh.t.shape[1] / mesh.p.shape[1]
        found: ContactProblem | None = None
        for _ in range(TRIALS):
            trial = _remeshed(problem, metric.with_triangles(ratio * nodes))
            count = trial.mesh.p.shape[1]
            if found is None or abs(count - nodes) < abs(found.mesh.p.shape[1] - nodes):
                found, best_ratio = trial, ratio
            if abs(count - nodes) <= tolerance * nodes:
                break
            ratio *= nodes / count
        assert found is not None
        if angle == 0 or np.min(least_angles(found.mesh.p, found.triangles)) >= angle:
            return found, best_ratio
        if aspect == 1.0:
            raise BadInputError(
                f"Mmg makes no mesh of {nodes} nodes whose angles are at least {angle:g} degrees"
            )
        aspect = max(FLATTER * aspect, 1.0)


def _remeshed(problem: ContactProblem, metric: Metric) -> ContactProblem:
    """The problem on a mesh that Mmg makes for a metric at its nodes; nodes that cannot move stay."""
    mesh, motion = problem.mesh, problem.motion
    numbers = [*motion.numbers, *(load.node for load in problem.point_loads)]
    fixed = np.union1d(np.flatnonzero(MeshMap.of(problem).mobility == Mobility.PINNED), numbers).astype(
        np.int64
    )
    new = remeshed(mesh, metric.tensors, line_facets(problem), fixed, _sagitta(problem))
    there = cKDTree(new.p.T).query(mesh.p[:, numbers].T)[1] if numbers else []
    number = dict(zip(numbers, map(int, there), strict=True))
    places: dict[str, Any] = {
        rule: tuple(one if isinstance(one, str) else number[one] for one in getattr(motion, rule))
        for rule in ("pinned", "slides", "free")
    }
    tied = tuple((number[a], number[b]) for a, b in motion.tied)
    loads = tuple(replace(load, node=number[load.node]) for load in problem.point_loads)
    found = on_mesh(problem, new, replace(motion, tied=tied, **places), point_loads=loads)
    if not Body(found, np.asarray(found.mesh.p)).is_upright():
        raise BadInputError("Mmg's mesh folds where its nodes are put on the curves: take more nodes")
    return found


def _sagitta(problem: ContactProblem) -> float | None:
    """The largest height of an arc over its edge; None without curves."""
    heights = []
    for name, curve in problem.motion.curves.items():
        a, b = np.asarray(problem.mesh.p)[:, problem.mesh.facets[:, problem.mesh.boundaries[name]]].transpose(
            1, 0, 2
        )
        middle = (a + b) / 2
        heights.append(np.linalg.norm(curve.at(curve.nearest(middle)) - middle, axis=0).max())
    return max(map(float, heights), default=None)
