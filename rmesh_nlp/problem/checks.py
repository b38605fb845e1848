"""Whether a contact problem makes sense: checked once, when it is stated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature_line, get_quadrature_tri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import overlapping, signed_areas
from rmesh_nlp.problem.coefficients import Coefficient, on_points
from rmesh_nlp.problem.obstacle import NO_NORMAL, Place
from rmesh_nlp.problem.rigid import NO_MOTION, rigid_motions, seen_by_contact

if TYPE_CHECKING:
    from rmesh_nlp.problem.contact_problem import ContactProblem, ContactSet

ROUNDING = 1e-10
"""Part of the distances below which a gap is zero."""

HIGHEST_DEGREE = 19
"""Highest degree of scikit-fem's rules for triangles; its points stand for those of higher ones."""

LEAST_DEGREE_ON_EDGES = 4
"""That of the rule for tractions."""


def check(problem: ContactProblem) -> None:
    """Raise a ProblemError if a problem contradicts itself."""
    _check_names(problem)
    _check_laws(problem)
    _check_components(problem)
    _check_functions(problem)
    for node in problem.motion.numbers:
        if not 0 <= node < problem.mesh.p.shape[1]:
            last = problem.mesh.p.shape[1] - 1
            raise ProblemError("motion", f"the motion names node {node}; nodes run from 0 to {last}")
    held, value = problem.held()
    _check_friction(problem, held, value)
    _check_obstacle(problem)
    _check_held(problem)


def check_unknowns(problem: ContactProblem) -> None:
    """Raise a ProblemError if there is nothing to solve for; such a problem may still be refined."""
    if np.all(problem.held()[0][:, np.unique(problem.mesh.t)]):
        raise ProblemError("dirichlet", "every displacement is given: leave some node free")


def _check_obstacle(problem: ContactProblem) -> None:
    for contact in problem.contact_sets:
        _check_contact_set(problem, contact)
    _check_shared_nodes(problem)


def _check_contact_set(problem: ContactProblem, contact: ContactSet) -> None:
    _check_given_gaps(problem, contact)
    if contact.nodes.size == 0:
        raise ProblemError("obstacle", "no node of the contact set is free to move: it is held as a whole")


def _check_given_gaps(problem: ContactProblem, contact: ContactSet) -> None:
    """Where given displacements fix the gap it must not be negative: no displacement would be admissible."""
    obstacle = contact.obstacle
    place = obstacle.boundary
    every = np.unique(problem.mesh.t) if isinstance(place, Place) else problem.boundary_nodes((place,))
    nodes = np.setdiff1d(every, contact.nodes)
    if nodes.size == 0:
        return
    where, (held, value) = problem.mesh.p[:, nodes], problem.held()
    distance = obstacle.distances(where)
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


def _check_shared_nodes(problem: ContactProblem) -> None:
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


def _check_names(problem: ContactProblem) -> None:
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


def _check_laws(problem: ContactProblem) -> None:
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


def _check_components(problem: ContactProblem) -> None:
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


def _check_functions(problem: ContactProblem) -> None:
    """Functions of position must take symbols, and be finite where they are evaluated on the given mesh.

    These are its nodes and the points of its quadrature rules.
    """
    laws = problem.law if isinstance(problem.law, Mapping) else {"": problem.law}
    for (name, law), (_, elements) in zip(laws.items(), problem.regions, strict=True):
        points, of = _inside(problem, elements), f" of {name!r}" if name else ""
        for what, value in _components("source" if law.components == 1 else "body force", law.load):
            _values("law", value, points, f"{what}{of}", name)
    for traction in problem.tractions:
        points = _along(problem, traction.boundary)
        for what, value in _components("traction", traction.value):
            _values("tractions", value, points, f"{what} on {traction.boundary!r}", traction.boundary)
    for support in problem.supports:
        points = _along(problem, support.boundary)
        for value in (value for value in support.value if value is not None):
            what = f"the displacement given on {support.boundary!r}"
            _values("dirichlet", value, points, what, support.boundary)
    for number, obstacle in enumerate(problem.obstacles):
        if isinstance(obstacle.boundary, Place):
            points = _inside(problem, np.arange(problem.mesh.t.shape[1]))
        else:
            points = _along(problem, obstacle.boundary)
        _values(
            "obstacle",
            obstacle.offset if obstacle.level is None else obstacle.distance,
            points,
            "the obstacle",
            number,
        )
        bound = _values("friction", obstacle.friction, points, "the friction bound", number)
        if np.min(bound) < 0:
            k = int(np.argmin(bound))
            place = f"({points[0, k]:.6g}, {points[1, k]:.6g})"
            said = f"the friction bound must not be negative, got {bound[k]:.6g} at {place}"
            raise ProblemError("friction", said, number)


def _components(what: str, values: tuple[Coefficient, ...]) -> list[tuple[str, Coefficient]]:
    """Names and values of the components of a load."""
    if len(values) == 1:
        return [(f"the {what}", values[0])]
    return [(f"component {i} of the {what}", value) for i, value in enumerate(values, 1)]


def _values(part: str, value: Coefficient, points: Array, what: str, name: str | int) -> Array:
    """Values of a coefficient at points (2, points), of a number at the first alone."""
    try:
        return on_points(value, points if callable(value) else points[:, :1], what)
    except ValueError as error:
        raise ProblemError(part, str(error), name) from error


def _inside(problem: ContactProblem, elements: NDArray) -> Array:
    """The nodes of some elements and their quadrature points for loads, (2, points)."""
    p, t = problem.mesh.p, problem.mesh.t[:, elements]
    if isinstance(problem.rule, int):
        local, _ = get_quadrature_tri(min(problem.rule, HIGHEST_DEGREE))
    else:
        local = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5]])
    weights = np.vstack([1 - local.sum(axis=0), local])
    return np.hstack([p[:, np.unique(t)], np.einsum("cae,an->cen", p[:, t], weights).reshape(2, -1)])


def _along(problem: ContactProblem, boundary: str) -> Array:
    """The nodes of a boundary and its quadrature points for tractions, (2, points)."""
    p, edges = problem.mesh.p, problem.mesh.facets[:, problem.mesh.boundaries[boundary]]
    degree = problem.rule if isinstance(problem.rule, int) else 0
    local, _ = get_quadrature_line(max(degree, LEAST_DEGREE_ON_EDGES))
    weights = np.vstack([1 - local, local])
    return np.hstack([p[:, np.unique(edges)], np.einsum("cae,an->cen", p[:, edges], weights).reshape(2, -1)])


def _check_friction(problem: ContactProblem, held: NDArray[np.bool_], value: Array) -> None:
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


def _check_held(problem: ContactProblem) -> None:
    """Given displacements, or contact with them, must prevent every rigid motion of every part.

    Whether contact does so under the load, and in one place only, is a matter of the forces:
    :mod:`rmesh_nlp.contact.active_set`.
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
