"""What is compared: given, h-adaptive and metric meshes, quadratic elements, relocation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from skfem import MeshTri

import rmesh_nlp as rm
from best_mesh import adaptive as plain
from best_mesh.cases import EQUATIONS_61, Case, next_mesh
from best_mesh.rows import ADAPTIVE, ATTAINABLE, GIVEN, LOOP, METRIC, QUADRATIC, Row
from peer_solvers import unassessed
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.remeshing import GROWTH, ROUGH, Solved, metric_start, remeshed_problem
from rmesh_nlp.problem import ContactProblem


def warm_up() -> None:
    """Solve once, so that loading libraries is nobody's cost."""
    mesh = MeshTri().refined(2)
    for order in (1, 2):
        list(plain.adaptive(EQUATIONS_61, mesh, order, 100))
    rm.solve(EXAMPLES["6.1"](n=8, delta="none"), remesh=True)


def given(case: Case, size: int) -> Iterator[Row]:
    """Linear elements on the mesh as given, and quadratic ones where scikit-fem has the problem."""
    problem = case.problem(size)
    if case.equations is None:
        began = time.process_time()
        Solved.of(problem)
        seconds = time.process_time() - began
    else:
        mesh = MeshTri(problem.mesh.p, problem.mesh.t)
        seconds = plain.solve(case.equations, mesh, 1).seconds
        found = plain.solve(case.equations, mesh, 2)
        yield Row(case.name, QUADRATIC, size, found.nodes, case.error_of(found), found.seconds)
    yield Row(case.name, GIVEN, size, _nodes(problem), case.error(problem), seconds)


def attainable(case: Case, size: int) -> Iterator[Row]:
    """The least interpolation error of as many triangles as the given mesh has."""
    fine, mesh = case.reference(), case.problem(size).mesh
    known = f"energy known to {fine.doubt:.1e}"
    yield Row(case.name, ATTAINABLE, size, mesh.p.shape[1], fine.least(mesh.t.shape[1]), status=known)


def h_adaptive(case: Case, most: int) -> Iterator[Row]:
    """Local refinement of the coarsest mesh by scikit-fem's plain loop.

    Problems that it does not have are refined by the package, without a time.
    """
    problem = case.problem(case.sizes[0])
    if case.equations is not None:
        mesh = MeshTri(problem.mesh.p, problem.mesh.t)
        for found in plain.adaptive(case.equations, mesh, 1, most):
            yield Row(case.name, ADAPTIVE, most, found.nodes, case.error_of(found), found.seconds)
        return
    while _nodes(problem) <= most:
        yield Row(case.name, ADAPTIVE, most, _nodes(problem), case.error(problem))
        problem = next_mesh(problem)


def metric_loop(case: Case, most: int) -> Iterator[Row]:
    """An adaptive loop of Mmg with the recovered metric: one round per size, each several times the last."""
    problem, ratio, seconds = case.problem(case.sizes[0]), float("nan"), 0.0
    while _nodes(problem) <= most:
        began = time.process_time()
        solved = Solved.of(problem)
        seconds += time.process_time() - began
        yield Row(case.name, LOOP, most, _nodes(problem), case.error(problem), seconds)
        began = time.process_time()
        size = int(GROWTH * _nodes(problem))
        problem, ratio = remeshed_problem(problem, solved.regions, size, ratio, ROUGH)
        seconds += time.process_time() - began


def metric(case: Case, size: int) -> Iterator[Row]:
    """Mmg with the recovered metric to as many nodes as given; no node is relocated."""
    problem = case.problem(size)
    began = time.process_time()
    found = metric_start(Solved.of(problem), _nodes(problem)).solved.problem
    seconds = time.process_time() - began
    yield Row(case.name, METRIC, size, _nodes(found), case.error(found), seconds)


def relocated(case: Case, method: str, size: int, remesh: bool) -> Iterator[Row]:
    """Relocation without move limits, on the mesh as given or on one for the solution."""
    final, seconds, status = by_default(case.problem(size), remesh)
    yield Row(case.name, method, size, _nodes(final), case.error(final), seconds, status)


def by_default(problem: ContactProblem, remesh: bool) -> tuple[ContactProblem, float, str]:
    """The problem on the mesh that ``auto`` ends with, seconds without the assessment, and the status."""
    began = time.process_time()
    solution = rm.solve(problem, remesh=remesh)
    seconds = unassessed(time.process_time() - began, solution)
    final = replace(solution.problem, mesh=solution.mesh, quadrature=problem.quadrature, reference=None)
    return final, seconds, solution.status.value


def _nodes(problem: ContactProblem) -> int:
    return int(problem.mesh.p.shape[1])
