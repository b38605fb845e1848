"""Whether a contact problem makes sense: checked once, when it is stated."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import overlapping, signed_areas
from rmesh_nlp.problem.coefficients import at, on_points
from rmesh_nlp.problem.obstacle import Place
from rmesh_nlp.problem.rigid import NO_MOTION, rigid_motions, seen_by_contact
from rmesh_nlp.problem.statement import NO_NORMAL, ContactSet, Statement

ROUNDING = 1e-10
"""Part of the distances below which a gap is zero."""


def check(problem: Statement) -> None:
    """Raise a ProblemError if a problem contradicts itself."""
    _check_names(problem)
    _check_laws(problem)
    _check_components(problem)
    _check_functions(problem)
    for node in problem.motion.numbers:
        if not 0 <= node < problem.mesh.p.shape[1]:
            last = problem.mesh.p.shape[1] - 1
            raise ProblemError("motion", f"the motion names node {node}; nodes run from 0 to {last}")
    try:
        held, value = problem.held()
    except ValueError as error:
        raise ProblemError("dirichlet", str(error)) from error
    _check_friction(problem, held, value)
    _check_obstacle(problem)
    _check_held(problem)


def _check_obstacle(problem: Statement) -> None:
    for contact in problem.contact_sets:
        _check_contact_set(problem, contact)
    _check_shared_nodes(problem)


def _check_contact_set(problem: Statement, contact: ContactSet) -> None:
    nodes, obstacle = contact.nodes, contact.obstacle
    _check_given_gaps(problem, contact)
    if nodes.size == 0:
        raise ProblemError("obstacle", "no node of the contact set is free to move: it is held as a whole")
    where = problem.mesh.p[:, nodes]
    try:
        obstacle.distances(where)
    except ValueError as error:
        raise ProblemError("obstacle", str(error)) from error
    try:
        values = on_points(obstacle.friction, where, "the friction bound")
    except ValueError as error:
        raise ProblemError("friction", str(error)) from error
    if np.min(values) < 0:
        node = nodes[np.argmin(values)]
        raise ProblemError(
            "friction", f"the friction bound must not be negative, got {np.min(values)} at node {node}"
        )


def _check_given_gaps(problem: Statement, contact: ContactSet) -> None:
    """Where given displacements fix the gap it must not be negative: no displacement would be admissible."""
    obstacle = contact.obstacle
    place = obstacle.boundary
    every = np.unique(problem.mesh.t) if isinstance(place, Place) else problem.boundary_nodes((place,))
    nodes = np.setdiff1d(every, contact.nodes)
    if nodes.size == 0:
        return
    where, (held, value) = problem.mesh.p[:, nodes], problem.held()
    try:
        distance = obstacle.distances(where)
    except ValueError as error:
        raise ProblemError("obstacle", str(error)) from error
    along = np.sum(obstacle.normals(where) * np.where(held, value, 0.0)[:, nodes], axis=0)
    gap, scale = distance + along, max(1e-300, np.max(np.abs(distance)), np.max(np.abs(along)))
    if np.min(gap) < -ROUNDING * scale:
        worst = int(np.argmin(gap))
        (x, y), node = where[:, worst], nodes[worst]
        raise ProblemError(
            "obstacle",
            f"no displacement is admissible: that given at node {node}, ({x:.6g}, {y:.6g}), makes "
            f"its gap {gap[worst]:.6g}",
        )


def _check_shared_nodes(problem: Statement) -> None:
    """A node may meet two foundations if it can obey both gaps, and without friction."""
    nodes, count = np.unique(problem.contact_nodes, return_counts=True)
    shared = nodes[count > 1]
    if shared.size == 0:
        return
    held, _ = problem.held()
    for node, number in zip(shared, count[count > 1], strict=True):
        meeting = [part.obstacle for part in problem.contact_sets if node in part.nodes]
        normals = np.hstack([obstacle.normals(problem.mesh.p[:, [node]]) for obstacle in meeting])
        free = normals[~held[:, node]]
        if number > 2 or np.linalg.matrix_rank(free, tol=1e-6) < number:
            raise ProblemError(
                "obstacle",
                f"node {node} belongs to {number} contact boundaries and cannot obey all their gaps: end one "
                "of them before it",
            )
        if any(obstacle.frictional for obstacle in meeting):
            raise ProblemError(
                "friction",
                f"node {node} belongs to {number} contact boundaries, one of them with friction: end one of "
                "them before it",
            )


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
    wrong = fault(mesh)
    if wrong is not None:
        raise ProblemError("mesh", wrong)
    if not problem.dirichlet and not problem.obstacles:
        raise ProblemError(
            "dirichlet", "at least one boundary must be held (dirichlet), or the energy has no minimum"
        )
    known = sorted(mesh.boundaries or {})
    used = [("dirichlet", d if isinstance(d, str) else d.boundary) for d in problem.dirichlet]
    used += [("tractions", t.boundary) for t in problem.tractions]
    used += [("curves" if n in problem.motion.curves else "motion", n) for n in problem.motion.names]
    used += [("obstacle", o.boundary) for o in problem.obstacles if isinstance(o.boundary, str)]
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
    n = problem.components
    for obstacle in problem.obstacles:
        if len(obstacle.normal) != n:
            raise ProblemError(
                "obstacle",
                f"the contact normal {obstacle.normal} has {len(obstacle.normal)} components, "
                f"the displacement has {n}",
            )
    for load in problem.point_loads:
        if not 0 <= load.node < problem.mesh.p.shape[1]:
            raise ProblemError("tractions", f"a point load names node {load.node}, which the mesh has not")
        if len(load.force) != n or not np.all(np.isfinite(load.force)):
            raise ProblemError(
                "tractions", f"the point load {load.force} at node {load.node} needs {n} finite values"
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


def _check_functions(problem: Statement) -> None:
    """Every load takes symbols: supports and obstacles are evaluated anyway."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    loads = [("law", value) for law in problem.laws for value in law.load]
    loads += [("tractions", value) for traction in problem.tractions for value in traction.value]
    for part, value in loads:
        try:
            at(value, x, y)
        except ValueError as error:
            raise ProblemError(part, str(error)) from error


def _check_friction(problem: Statement, held: NDArray[np.bool_], value: Array) -> None:
    """With friction a contact node may be held along the tangent at zero, and not otherwise."""
    if not problem.frictional:
        return
    for part in problem.contact_sets:
        if not part.obstacle.frictional:
            continue
        nodes = part.nodes
        oblique = np.all(np.abs(part.obstacle.normals(problem.mesh.p[:, nodes])) > NO_NORMAL, axis=0)
        bad = nodes[np.any(held[:, nodes] & (oblique | (value[:, nodes] != 0)), axis=0)]
        if bad.size:
            raise ProblemError(
                "friction",
                f"contact node {bad[0]} has friction and one given displacement component: with friction it "
                "must be zero and along the tangent",
            )


def _check_held(problem: Statement) -> None:
    """Given displacements, or contact with them, must prevent every rigid motion of every part.

    Whether contact does so under the load, and in one place only, is a matter of the forces:
    :mod:`rmesh_nlp.contact.floating`.
    """
    motions = rigid_motions(problem)
    gaps = seen_by_contact(problem, motions)
    if np.linalg.matrix_rank(gaps, tol=NO_MOTION) < len(motions):
        node = int(np.flatnonzero(np.any(motions != 0, axis=(0, 1)))[0])
        raise ProblemError(
            "dirichlet",
            f"the part of the mesh with node {node} can still move as a rigid body: the given "
            "displacements must prevent it, and contact does not",
        )
