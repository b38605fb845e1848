"""The metric start: solve, recover derivatives, remesh in the best metric, and again.

Relocation begins on a mesh whose triangles suit the solution: it keeps the connectivity, which bounds what
it can gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.errors import BadInputError, ProblemError
from rmesh_nlp.evaluation import Array, Index, largest_side
from rmesh_nlp.fem.interpolation_error import LARGEST_ASPECT
from rmesh_nlp.fem.metric import Metric, best_metric
from rmesh_nlp.fem.recovery import Recovered, interpolation_error, recovered
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.geometry import edges_on, named_by_user, nodes_of, pieces_of
from rmesh_nlp.meshes.mmg import LARGEST, remeshed
from rmesh_nlp.optimize.budget import StoppedError
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import renumbered
from rmesh_nlp.problem.lines import bent, line_facets
from rmesh_nlp.problem.pairs import edges_of_pair, paired

ROUNDS = 3
"""Rounds: with two the estimated error is 2 to 8 % larger, with more it hardly changes."""

EXACT, ROUGH = 0.02, 0.2
"""Relative differences from the number of nodes that are aimed at, and above which, in whole nodes, they are
an error."""

TRIALS = 12
"""Runs of Mmg to come that near, by proportion."""

FLATTER = 0.7
"""Factor of the largest aspect ratio after a mesh with too small an angle; at one, of the differences in
density."""

CLOSER = (1.0, 0.5, 0.25, 0.125)
"""Parts of the largest sagitta that new edges on curves may have, until none cuts through its triangle: flat
triangles along an arc allow less than those of the given mesh."""

EVEN = 0.1
"""Least part of these differences before they are dropped."""


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
        return Solved(solver, solver.given)

    @cached_property
    def regions(self) -> tuple[Recovered, ...]:
        """The derivatives that the displacement lacks."""
        displacement, space = self.solver.displacement.values(self.state.u), self.solver.discretisation.space
        return recovered(space, self.problem.mesh.p, displacement)

    @cached_property
    def error(self) -> float:
        """Estimated error of the energy: that of interpolation."""
        return interpolation_error(self.problem.mesh.p, self.problem.triangles, self.regions)


@dataclass(frozen=True)
class MetricStart:
    """Where the rounds ended, and the numbers of nodes and energies of all of them."""

    solved: Solved
    nodes: tuple[int, ...]
    energies: tuple[float, ...]


def metric_start(first: Solved, nodes: int) -> MetricStart:
    """Remesh the domain of a problem with a number of nodes, up to two percent, in the best metric.

    There are three rounds, or as many as time allows; the mesh of least energy counts.

    Raises
    ------
    BadInputError
        If mmgpy is not installed, Mmg gives up, or no mesh has the number of nodes, the least angle of the
        motion, or nodes that the problem needs.
    ProblemError
        If the contact problem cannot be solved on a new mesh.
    StoppedError
        If time is over before there is a mesh.
    """
    if nodes > LARGEST:
        raise BadInputError(f"a new mesh may have up to {LARGEST} nodes, got {nodes}")
    if not first.problem.has_energy:
        raise BadInputError("the best mesh is that of least energy: with Coulomb friction none is minimised")
    current, ratio, off, done = first, float("nan"), sagitta(first.problem), list[Solved]()
    for _ in range(ROUNDS):
        try:
            problem, ratio = remeshed_problem(current.problem, current.regions, nodes, ratio, off)
            current = _solved(problem)
        except (BadInputError, StoppedError):
            if not done:
                raise
            break
        done.append(current)
    best = min(done, key=lambda solved: solved.state.energy)
    counts = tuple(solved.problem.n_vertices for solved in done)
    return MetricStart(best, counts, tuple(solved.state.energy for solved in done))


def _solved(problem: ContactProblem) -> Solved:
    solved = Solved.of(problem)
    if solved.state.status is not Status.CONVERGED:
        count = problem.n_vertices
        raise ProblemError("mesh", f"the contact problem was not solved on a new mesh of {count} nodes")
    return solved


def remeshed_problem(
    problem: ContactProblem,
    regions: Sequence[Recovered],
    nodes: int,
    ratio: float = float("nan"),
    off: float | None = None,
) -> tuple[ContactProblem, float]:
    """The problem on a mesh of a number of nodes, the best for derivatives recovered on its own.

    ``ratio`` is that of the triangles of the metric to the nodes of the mesh, which is returned as well:
    known from another mesh it saves runs of Mmg. Arcs are at most ``off`` above their edges, by default as on
    the mesh of the problem.
    """
    off = sagitta(problem) if off is None else off
    X, angle, aspect, even = problem.mesh.p, problem.motion.min_angle, LARGEST_ASPECT, 1.0
    if angle > 0:  # the least angle of an equilateral triangle that is stretched across an edge
        aspect = min(aspect, 1 / (np.sqrt(3) * np.tan(np.radians(angle) / 2)))
    metric = best_metric(X, regions, aspect)
    if np.isnan(ratio):
        ratio = problem.mesh.nelements / X.shape[1]
    while True:
        candidate, ratio = _with_nodes(problem, metric, nodes, ratio, off)
        if angle == 0 or np.min(least_angles(candidate.mesh.p, candidate.triangles)) >= angle:
            return candidate, ratio
        if even == 0:
            raise BadInputError(
                f"Mmg makes no mesh of {nodes} nodes with angles of {angle:g} degrees or more"
            )
        if aspect > 1:
            aspect = max(FLATTER * aspect, 1.0)
            metric = best_metric(X, regions, aspect)
        else:
            even = FLATTER * even if FLATTER * even > EVEN else 0.0
            metric = metric.evened(FLATTER if even > 0 else 0.0)


def _with_nodes(
    problem: ContactProblem, metric: Metric, nodes: int, ratio: float, off: float
) -> tuple[ContactProblem, float]:
    """The problem on the mesh nearest to a number of nodes, and the ratio that gave it."""
    candidates: list[tuple[int, float, ContactProblem]] = []
    for _ in range(TRIALS):
        made = _remeshed(problem, metric.with_triangles(ratio * nodes), off)
        count = made.mesh.p.shape[1]
        candidates.append((abs(count - nodes), ratio, made))
        if abs(count - nodes) <= EXACT * nodes:
            break
        ratio = ratio * nodes / count
    off, ratio, best = min(candidates, key=lambda candidate: candidate[0])
    if off > np.ceil(ROUGH * nodes):
        nearest = best.mesh.p.shape[1]
        raise BadInputError(f"Mmg makes no mesh of {nodes} nodes of this domain: the nearest has {nearest}")
    return best, ratio


def _remeshed(problem: ContactProblem, metric: Metric, off: float) -> ContactProblem:
    """The problem on a mesh that Mmg makes for a metric at its nodes; nodes that cannot move stay.

    Pairs are closed for it, and open again.
    """
    mesh, now = _closed(problem)
    tensors = np.array([np.bincount(now, row) for row in metric.tensors]) / np.bincount(now)
    pinned = np.flatnonzero(MeshMap.of(problem).mobility == Mobility.PINNED)
    numbers = [*pinned, *problem.motion.numbers, *(load.node for load in problem.point_loads)]
    fixed, size = np.unique(now[numbers]), largest_side(mesh.p)
    for closer in CLOSER if off else CLOSER[:1]:
        new = remeshed(mesh, tensors, line_facets(mesh), fixed, closer * off)
        try:
            carried = _carried_over(problem, new)
        except ProblemError as error:
            said = f"no problem on Mmg's mesh of {new.p.shape[1]} nodes: {error}"
            continue
        if Body(carried, carried.mesh.p).is_upright() and sagitta(carried) <= off + 1e-9 * size:
            return carried
        said = f"Mmg's mesh of {new.p.shape[1]} nodes is too coarse for the curves: take more"
    raise BadInputError(said)


def _closed(problem: ContactProblem) -> tuple[MeshTri, Index]:
    """The mesh with one node in the place of the two of a pair, and the new number of each old one."""
    mesh, boundaries = problem.mesh, named_by_user(problem.mesh.boundaries)
    for pair in problem.pairs:
        for name, facets in boundaries.items():
            if name not in pair and np.isin(edges_of_pair(mesh, *pair), facets).any():
                raise BadInputError(f"remeshing mixes the sides of {pair} for {name!r}: leave them out")
    number = pieces_of(problem.matches, mesh.p.shape[1])
    edges = {name: number[mesh.facets[:, facets]].T for name, facets in boundaries.items()}
    p = mesh.p[:, np.unique(number, return_index=True)[1]]
    return named(MeshTri(p, number[mesh.t]), edges, mesh.subdomains), number


def _carried_over(problem: ContactProblem, new: MeshTri) -> ContactProblem:
    """The problem on a new mesh, which has the nodes of the old one that the problem names."""
    curves = problem.motion.curves
    new = paired(bent(new, curves), problem.obstacles, curves)[0]
    nearest = cKDTree(_places(new)).query(_places(problem.mesh))[1]
    return renumbered(problem, new, dict(enumerate(nearest.tolist())))


def _places(mesh: MeshTri) -> Array:
    """(nodes, 2 + names) positions, and whether a node is on each boundary: which one of a pair it is."""
    names = sorted(named_by_user(mesh.boundaries))
    on = (np.bincount(nodes_of(mesh, name), minlength=mesh.p.shape[1]) for name in names)
    return np.vstack([mesh.p, *on]).T


def sagitta(problem: ContactProblem) -> float:
    """The largest height of an arc over its edge; 0 without curves."""
    heights, mesh = [], problem.mesh
    for name, curve in problem.motion.curves.items():
        middle = mesh.p[:, edges_on(mesh, name)].mean(axis=1)
        heights.append(np.linalg.norm(curve.at(curve.nearest(middle)) - middle, axis=0).max())
    return max(map(float, heights), default=0.0)
