"""What is compared: uniform, h-adaptive and metric meshes of orders 1 and 2, relocation, what is attainable.

Each method yields its meshes as dicts with ``nodes`` (of displacements, so with the middles of edges at order
2), ``error``, and where they mean something ``seconds`` (processor time to this mesh, model build included)
and ``status``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm
from best_mesh import adaptive as plain
from best_mesh.cases import EQUATIONS_61, Case, next_mesh
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.remeshing import Solved, metric_start, remeshed_problem
from rmesh_nlp.problem import ContactProblem
from rows import Row, Store, timed

UNIFORM, ADAPTIVE = "uniform", "h-adaptive"
METRIC, LOOP = "metric", "metric, adaptive loop"
RELOCATED, REMESHED, ATTAINABLE = "relocated", "remeshed, relocated", "attainable"

Rows = Iterator[Row]
Method = Callable[[], Rows]
Task = tuple[int, str, int, Method]
"""Order, method, size and how to measure it."""

REFERENCE, FINE = "reference", (1500, 3000)
"""Method and vertices of the meshes that an energy is extrapolated from."""


def measure(store: Store, case: str, order: int, method: str, size: int, rows: Method) -> None:
    """Keep the rows of a method, if it was not measured before."""
    store.measure({"case": case, "order": order, "method": method, "size": size}, rows)


def measured(store: Store, case: Case, tasks: Callable[[Case], Iterable[Task]]) -> None:
    """Measure what is missing of a case, its energy first."""
    if case.slope is None and np.isnan(case.known):
        measure(store, case.name, 2, REFERENCE, 0, partial(energies, case.problem(case.sizes[0])))
        case = replace(case, known=limit(store.rows, case.name)[0])
    for task in tasks(case):
        measure(store, case.name, *task)


def energies(problem: ContactProblem) -> Rows:
    """Energies of the contact solutions of two meshes made for order 2.

    Not the assessed ones: over a curved obstacle in the interior, stand-offs are the larger error there.
    """
    solved = Solved.of(replace(problem, order=2, exact=None, reference=None))
    for vertices in FINE:
        solved = metric_start(solved, vertices).solved
        yield {"nodes": unknowns(solved.problem), "error": solved.state.energy, "status": "energy"}


def limit(rows: Sequence[Row], case: str) -> tuple[float, float]:
    """The energy that those of two meshes tend to like one over the square of the nodes, and its doubt."""
    meshes = [
        (row["nodes"], row["error"]) for row in rows if (row["case"], row["method"]) == (case, REFERENCE)
    ]
    if len(meshes) < 2:
        return float("nan"), float("nan")
    (before, higher), (last, least) = meshes
    rest = (higher - least) / ((last / before) ** 2 - 1)
    return least - rest, abs(rest)


def warm_up() -> None:
    """Solve once, so that loading libraries is nobody's cost."""
    mesh = MeshTri().refined(2)
    for order in (1, 2):
        list(plain.adaptive(EQUATIONS_61, mesh, order, 100))
    rm.solve(EXAMPLES["6.1"](n=8, delta="none"), remesh=True)


def by_scikit_fem(
    case: Case, size: int, order: int, loop: Callable[..., Iterator[plain.Solved]], most: int
) -> Rows:
    """Refinement of a mesh by a loop of scikit-fem, uniform or h-adaptive, up to a number of nodes."""
    mesh = case.problem(size).mesh
    for end in loop(case.equations, MeshTri(mesh.p, mesh.t), order, most):
        yield {"nodes": end.nodes, "error": case.error_of(end), "seconds": end.seconds}


def refined(case: Case, size: int, order: int, most: int) -> Rows:
    """Local refinement by the package to at least a number of nodes, without a time."""
    problem = case.problem(size, order)
    yield _row(case, problem)
    while unknowns(problem) < most:
        problem = next_mesh(problem)
        yield _row(case, problem)


def uniform(case: Case, size: int, order: int = 1) -> Rows:
    """The mesh as given; the time is that of scikit-fem where it has the problem, else of the package."""
    problem = case.problem(size, order)
    if case.equations is None:
        _, seconds = timed(Solved.of, problem)
    else:
        seconds = plain.solve(case.equations, MeshTri(problem.mesh.p, problem.mesh.t), order).seconds
    yield {**_row(case, problem), "seconds": seconds}


def attainable(case: Case, size: int) -> Rows:
    """The least interpolation error of as many triangles as the given mesh has."""
    mesh = case.problem(size).mesh
    yield {"nodes": mesh.p.shape[1], "error": case.least(mesh.t.shape[1])}


def metric_loop(case: Case, most: int) -> Rows:
    """An adaptive loop of Mmg with the recovered metric: one round per size, each four times the last."""
    problem, ratio, spent = case.problem(case.sizes[0]), float("nan"), 0.0
    while unknowns(problem) <= most:
        solved, seconds = timed(Solved.of, problem)
        spent += seconds
        yield {**_row(case, problem), "seconds": spent}
        size = 4 * unknowns(problem)
        (problem, ratio), seconds = timed(remeshed_problem, problem, solved.regions, size, ratio, 0.2)
        spent += seconds


def metric(case: Case, size: int) -> Rows:
    """Mmg with the recovered metric to as many nodes as given; no node is relocated."""
    problem = case.problem(size)
    start, seconds = timed(lambda: metric_start(Solved.of(problem), unknowns(problem)))
    yield {**_row(case, start.solved.problem), "seconds": seconds}


def relocated(case: Case, size: int, order: int, remesh: bool) -> Rows:
    """Relocation without move limits, on the mesh as given or on one for the solution."""
    problem = case.problem(size, order)
    solution, seconds = timed(rm.solve, problem, remesh=remesh)
    final = replace(solution.problem, mesh=solution.mesh, quadrature=problem.quadrature, reference=None)
    row, status = _row(case, final), solution.status.value
    yield {**row, "seconds": unassessed(seconds, solution), "status": status}


def unassessed(seconds: float, solution: rm.Solution) -> float:
    """Seconds of a solve without the share of its assessment."""
    record = solution.record()
    return seconds * (1 - record["audit_time_s"] / record["wall_time_s"])


def unknowns(problem: ContactProblem) -> int:
    """Number of displacement nodes."""
    return int(DisplacementSpace(problem).n_nodes)


def _row(case: Case, problem: ContactProblem) -> Row:
    return {"nodes": unknowns(problem), "error": case.error(problem)}
