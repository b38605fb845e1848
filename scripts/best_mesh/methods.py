"""What is compared: given and h-adaptive meshes, quadratic elements, and relocation in four ways."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from skfem import ElementTriP1, MeshTri

import rmesh_nlp as rm
from best_mesh import adaptive as plain
from best_mesh.cases import LAPLACIAN_61, RULE, Case
from best_mesh.rows import ADAPTIVE, GIVEN, Row
from peer_solvers import unassessed
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.edge_gains import marked
from rmesh_nlp.problem.contact_problem import locally_refined
from rmesh_nlp.solving.solution import Solution


def warm_up() -> None:
    """Solve once, so that loading libraries is nobody's cost."""
    mesh = MeshTri().refined(2)
    list(plain.adaptive(LAPLACIAN_61, mesh, 100))
    plain.quadratic(LAPLACIAN_61, mesh)
    rm.solve(EXAMPLES["6.1"](n=3), "nested")


def given(case: Case, size: int) -> Iterator[Row]:
    """Linear elements on the mesh as given, and quadratic ones where scikit-fem solves it as it is."""
    problem = case.problem(size)
    seconds = float("nan")
    if case.laplacian is not None:
        mesh = MeshTri(problem.mesh.p, problem.mesh.t)
        seconds = plain.solve(case.laplacian, mesh, ElementTriP1(), np.zeros((2, 0))).seconds
        quadratic = plain.quadratic(case.laplacian, mesh)
        error = quadratic.energy - case.exact
        name = "quadratic, given mesh"
        yield Row(case.name, name, str(size), int(quadratic.basis.N), error, quadratic.seconds)
    yield Row(case.name, GIVEN, str(size), int(problem.mesh.p.shape[1]), case.error(problem), seconds)


def h_adaptive(case: Case, most: int) -> Iterator[Row]:
    """Local refinement of the coarsest mesh: scikit-fem's plain loop, or marked by the exact errors."""
    problem = case.problem(case.sizes[0])
    if case.laplacian is not None:
        mesh = MeshTri(problem.mesh.p, problem.mesh.t)
        for found in plain.adaptive(case.laplacian, mesh, most):
            nodes, error = int(found.mesh.p.shape[1]), found.energy - case.exact
            yield Row(case.name, ADAPTIVE, str(most), nodes, error, found.seconds)
        return
    while problem.mesh.p.shape[1] <= most:
        yield Row(case.name, ADAPTIVE, str(most), problem.mesh.p.shape[1], case.error(problem))
        problem = locally_refined(problem, marked(case.local(problem)))


def move_limits(case: Case, size: int) -> Iterator[Row]:
    """Move limits that shrink with the mesh, as in the paper; Example 6.1."""
    problem = replace(EXAMPLES["6.1"](n=size), quadrature=RULE)
    began = time.process_time()
    yield _relocated(case, "relocated, move limits", size, rm.solve(problem, "nested"), began)


def relocated(case: Case, size: int, remesh: bool) -> Iterator[Row]:
    """Relocation without move limits."""
    problem = case.problem(size)
    began = time.process_time()
    solution = rm.solve(problem, remesh=remesh)
    yield _relocated(case, "remeshed, relocated" if remesh else "relocated", size, solution, began)


def _relocated(case: Case, method: str, size: int, solution: Solution, began: float) -> Row:
    seconds = unassessed(time.process_time() - began, solution)
    final = replace(solution.problem, mesh=solution.mesh, quadrature=RULE, reference=None)
    nodes = int(final.mesh.p.shape[1])
    return Row(case.name, method, str(size), nodes, case.error(final), seconds, solution.status.value)
