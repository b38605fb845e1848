"""Whether a contact problem makes sense: checked once, when it is stated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.geometry import overlapping, signed_areas
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.problem.obstacle import Place
from rmesh_nlp.problem.statement import Statement


def check(problem: Statement) -> None:
    """Raise a ProblemError if a problem contradicts itself."""
    _check_names(problem)
    _check_laws(problem)
    _check_components(problem)
    for node in problem.motion.numbers:
        if not 0 <= node < problem.mesh.p.shape[1]:
            last = problem.mesh.p.shape[1] - 1
            raise ProblemError("motion", f"the motion names node {node}; nodes run from 0 to {last}")
    try:
        held, value = problem.held()
    except ValueError as error:
        raise ProblemError("dirichlet", str(error)) from error
    _check_held(problem, held)
    _check_friction(problem, held, value)
    _check_obstacle(problem)


def _check_obstacle(problem: Statement) -> None:
    nodes, obstacle = problem.contact_nodes, problem.obstacle
    if obstacle.boundary is Place.NOWHERE:
        return
    if nodes.size == 0:
        raise ProblemError("obstacle", "no node of the contact set is free to move: it is held as a whole")
    where = problem.mesh.p[:, nodes]
    for part, coefficient in (("obstacle", obstacle.offset), ("friction", obstacle.friction)):
        what = "the friction bound" if part == "friction" else "the obstacle"
        try:
            values = on_points(coefficient, where, what)
        except ValueError as error:
            raise ProblemError(part, str(error)) from error
        if part == "friction" and np.min(values) < 0:
            node = nodes[np.argmin(values)]
            raise ProblemError(part, f"{what} must not be negative, got {np.min(values)} at node {node}")


def _check_names(problem: Statement) -> None:
    mesh = problem.mesh
    if type(mesh).__name__ != "MeshTri1":
        raise ProblemError(
            "mesh", f"the mesh must be a skfem.MeshTri of first order, got {type(mesh).__name__}"
        )
    if not np.all(np.abs(signed_areas(mesh.p, mesh.t)) > 0):
        bad = int(np.flatnonzero(~(np.abs(signed_areas(mesh.p, mesh.t)) > 0))[0])
        raise ProblemError("mesh", f"element {bad} of the mesh has no area")
    edge = overlapping(problem.triangles)
    if edge is not None:
        raise ProblemError("mesh", f"the mesh is folded at the edge between nodes {edge[0]} and {edge[1]}")
    if not problem.dirichlet:
        raise ProblemError(
            "dirichlet", "at least one boundary must be held (dirichlet), or the energy has no minimum"
        )
    known = sorted(mesh.boundaries or {})
    used = [("dirichlet", d if isinstance(d, str) else d.boundary) for d in problem.dirichlet]
    used += [("tractions", t.boundary) for t in problem.tractions]
    used += [("motion", name) for name in problem.motion.names]
    if isinstance(problem.obstacle.boundary, str):
        used.append(("obstacle", problem.obstacle.boundary))
    for part, name in used:
        if name not in known:
            has = ", ".join(known) or "none"
            raise ProblemError(part, f"the mesh has no boundary named {name!r}; it has {has}")
        if np.size(mesh.boundaries[name]) == 0:
            raise ProblemError(part, f"the boundary {name!r} of the mesh is empty")


def _check_laws(problem: Statement) -> None:
    if not isinstance(problem.law, Mapping):
        return
    known = sorted(problem.mesh.subdomains or {})
    count = np.zeros(problem.mesh.t.shape[1], dtype=int)
    for name in problem.law:
        if name not in known:
            has = ", ".join(known) or "none"
            raise ProblemError("law", f"the mesh has no subdomain named {name!r}; it has {has}")
        count[np.asarray(problem.mesh.subdomains[name])] += 1
    if np.any(count != 1):
        bad = int(np.flatnonzero(count != 1)[0])
        raise ProblemError("law", f"element {bad} has {count[bad]} laws: every element needs exactly one")
    if len({law.components for law in problem.laws}) != 1:
        raise ProblemError("law", "the laws of the subdomains mix scalar and elastic problems")


def _check_components(problem: Statement) -> None:
    n, obstacle = problem.components, problem.obstacle
    if obstacle.boundary is not Place.NOWHERE and len(obstacle.normal) != n:
        raise ProblemError(
            "obstacle",
            f"the contact normal {obstacle.normal} has {len(obstacle.normal)} components, "
            f"the displacement has {n}",
        )
    for traction in problem.tractions:
        if len(traction.value) != n:
            raise ProblemError(
                "tractions", f"traction {traction.value} on {traction.boundary!r} needs {n} values"
            )
    for support in problem.supports:
        if len(support.value) != n:
            raise ProblemError(
                "dirichlet",
                f"the displacement {support.value} given on {support.boundary!r} needs {n} values",
            )


def _check_friction(problem: Statement, held: NDArray[np.bool_], value: Array) -> None:
    """With friction a contact node may be held along the tangent at zero, and not otherwise."""
    if not problem.frictional:
        return
    nodes = problem.contact_nodes
    oblique = np.all(np.array(problem.obstacle.normal) != 0)
    bad = nodes[np.any(held[:, nodes] & (oblique | (value[:, nodes] != 0)), axis=0)]
    if bad.size:
        raise ProblemError(
            "friction",
            f"contact node {bad[0]} has friction and one given displacement component: with friction it must "
            "be zero and along the tangent",
        )


def _check_held(problem: Statement, held: NDArray[np.bool_]) -> None:
    """Every connected part of the mesh must be held against all rigid motions."""
    mesh = problem.mesh
    n_nodes = mesh.p.shape[1]
    edges = sp.coo_array((np.ones(mesh.facets.shape[1]), tuple(mesh.facets)), shape=(n_nodes, n_nodes))
    _, part = connected_components(edges, directed=False)
    for number in np.unique(part[mesh.t[0]]):
        nodes = np.flatnonzero(part == number)
        x, y = mesh.p[:, nodes] - mesh.p[:, nodes].mean(axis=1, keepdims=True)
        one, zero = np.ones(nodes.size), np.zeros(nodes.size)
        size = max(float(np.max(np.abs([x, y]))), 1e-300)
        modes = [[one]] if problem.components == 1 else [[one, zero], [zero, one], [-y / size, x / size]]
        rows = np.array([np.concatenate(mode)[held[:, nodes].ravel()] for mode in modes])
        if np.linalg.matrix_rank(rows, tol=1e-9) < len(modes):
            raise ProblemError(
                "dirichlet",
                f"the part of the mesh with node {nodes[0]} can still move as a rigid body: the given "
                "displacements must prevent it, contact alone does not",
            )
