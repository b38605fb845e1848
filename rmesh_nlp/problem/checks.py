"""Whether a contact problem makes sense: checked once, when it is made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature_line, get_quadrature_tri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import members_of
from rmesh_nlp.problem.coefficients import MIDPOINT, Coefficient, on_points
from rmesh_nlp.problem.data import ContactSet, ProblemData
from rmesh_nlp.problem.motion import RULES
from rmesh_nlp.problem.obstacle import NO_NORMAL, Place
from rmesh_nlp.problem.rigid import NO_MOTION, rigid_motions, seen_by_contact

CLOSED = 1e-10
"""Part of the distances below which a given gap is zero, by rounding."""

FOUND = 1e-5
"""Part of the extent of the body by which an optimised design may violate it: the tolerance of a solve."""

INDEPENDENT = 1e-6
"""Least singular value of the normals of foundations that one node can keep off from."""

ORDERS = (1, 2)
"""Orders of displacements that there are."""

HIGHEST_DEGREE = 19
"""Highest degree of scikit-fem's rules for triangles; its points stand for those of higher ones."""

RULE_NAMES, LARGEST_DEGREE = ("auto", MIDPOINT), 50
"""What a quadrature rule may be. Of higher degrees the points are so many that an energy takes minutes."""

LEAST_DEGREE_ON_EDGES = 4
"""That of the rule for tractions."""


def check(problem: ProblemData) -> None:
    """Raise a ProblemError if a problem contradicts itself."""
    if type(problem.order) is not int or problem.order not in ORDERS:
        raise ProblemError("order", f"the order of displacements must be 1 or 2, got {problem.order!r}")
    rule = problem.quadrature
    if rule not in RULE_NAMES and not (type(rule) is int and 1 <= rule <= LARGEST_DEGREE):
        said = f"quadrature must be 'auto', 'midpoint' or a degree from 1 to {LARGEST_DEGREE}, got {rule!r}"
        raise ProblemError("quadrature", said)
    _check_mesh(problem)
    check_names(problem)
    _check_laws(problem)
    _check_components(problem)
    _check_functions(problem)
    _check_friction(problem)
    _check_contact_edges(problem)
    for contact in problem.contact_sets:
        _check_given_gaps(problem, contact)
        if contact.nodes.size == 0:
            raise ProblemError("obstacle", "no node of the contact set is free to move: all are fixed")
    _check_shared_nodes(problem)
    _check_rigid_motions(problem)


def _check_mesh(problem: ProblemData) -> None:
    mesh = problem.mesh
    if type(mesh).__name__ != "MeshTri1":
        said = f"the mesh must be a skfem.MeshTri of first order, got {type(mesh).__name__}"
        raise ProblemError("mesh", said)
    if wrong := fault(mesh):
        raise ProblemError("mesh", wrong)


def check_names(problem: ProblemData) -> None:
    """Raise a ProblemError if a part of the problem names a boundary that the mesh has not."""
    if not problem.dirichlet and not problem.obstacles:
        said = "at least one boundary must be held (dirichlet), or the energy has no minimum"
        raise ProblemError("dirichlet", said)
    motion, places = problem.motion, [obstacle.boundary for obstacle in problem.obstacles]
    used: list[tuple[str, str | int, Any]] = [
        *(("dirichlet", support.boundary, support.boundary) for support in problem.supports),
        *(("tractions", traction.boundary, traction.boundary) for traction in problem.tractions),
        *(("design", shape.name, shape.boundary) for shape in problem.shapes),
        *(("curves", name, name) for name in motion.curves),
        *(("motion", rule, place) for rule in RULES for place in getattr(motion, rule)),
        *(("boundary", number, place) for number, place in enumerate(places)),
    ]
    named = [(part, which, name) for part, which, name in used if isinstance(name, str)]
    for part, which, name in named:
        if members_of("boundary", name, problem.mesh.boundaries, part, which).size == 0:
            raise ProblemError(part, f"the boundary {name!r} of the mesh is empty", which)


def _check_contact_edges(problem: ProblemData) -> None:
    """Contact is on the outer boundary: names may stand for lines inside the body as well."""
    mesh = problem.mesh
    for number, obstacle in enumerate(problem.obstacles):
        if isinstance(obstacle.boundary, str):
            for edge in np.setdiff1d(mesh.boundaries[obstacle.boundary], mesh.boundary_facets()):
                a, b = mesh.facets[:, edge]
                said = f"{obstacle.boundary!r} has an edge inside the body, between nodes {a} and {b}"
                raise ProblemError("boundary", f"{said}: contact is on the outer boundary", number)


def _check_laws(problem: ProblemData) -> None:
    if not isinstance(problem.law, Mapping):
        return
    count = np.zeros(problem.mesh.t.shape[1], dtype=int)
    for name in problem.law:
        count[members_of("subdomain", name, problem.mesh.subdomains, "subdomain", name)] += 1
    for element in np.flatnonzero(count != 1):
        said = f"element {element} has {count[element]} laws: every element needs exactly one"
        raise ProblemError("law", said)
    if len({law.components for law in problem.laws}) != 1:
        raise ProblemError("law", "the laws of the subdomains mix scalar and elastic problems")


def _check_components(problem: ProblemData) -> None:
    n, last = problem.components, problem.mesh.p.shape[1] - 1
    for node in problem.motion.numbers:
        if not 0 <= node <= last:
            raise ProblemError("motion", f"the motion names node {node}; nodes run from 0 to {last}")
    for number, load in enumerate(problem.point_loads):
        if not 0 <= load.node <= last:
            said = f"a point load names node {load.node}, which the mesh has not"
            raise ProblemError("point_loads", said, number)
        if not np.all(np.isfinite(load.force)):
            said = f"the point load {load.force} at node {load.node} is not finite"
            raise ProblemError("point_loads", said, number)
    for number, obstacle in enumerate(problem.obstacles):
        if n == 1 and obstacle.level is not None:
            raise ProblemError("obstacle", "a circle or a curve needs an elastic body", number)
    normals = [obstacle.normal for obstacle in problem.obstacles]
    forces = [load.force for load in problem.point_loads]
    given: list[tuple[str, str | int, str, Sequence[Any]]] = [
        *(("obstacle", k, f"the contact normal {normal}", normal) for k, normal in enumerate(normals)),
        *(("point_loads", k, f"the point load {force}", force) for k, force in enumerate(forces)),
        *(
            ("tractions", t.boundary, f"the traction {t.value} on {t.boundary!r}", t.value)
            for t in problem.tractions
        ),
        *(
            ("dirichlet", s.boundary, f"the displacement {s.value} given on {s.boundary!r}", s.value)
            for s in problem.supports
        ),
    ]
    for part, which, what, values in given:
        if len(values) != n:
            said = f"{what} has {len(values)} components: it needs {n} value{'s' * (n > 1)}"
            raise ProblemError(part, said, which)


def _check_functions(problem: ProblemData) -> None:
    """Functions of position must take symbols, and be finite where they are evaluated on the given mesh.

    These are its nodes and the points of its quadrature rules.
    """
    for part, value, points, what, name in _functions(problem):
        try:
            values = on_points(value, points if callable(value) else points[:, :1], what)
        except ValueError as error:
            raise ProblemError(part, str(error), name) from error
        if part in ("friction", "coulomb") and np.min(values) < 0:
            k = int(np.argmin(values))
            place = f"({points[0, k]:.6g}, {points[1, k]:.6g})"
            raise ProblemError(part, f"{what} must not be negative, got {values[k]:.6g} at {place}", name)


def _functions(problem: ProblemData) -> Iterator[tuple[str, Coefficient, Array, str, str | int]]:
    """Part of the problem, coefficient, points (2, n), description, and which of several."""
    laws = problem.law if isinstance(problem.law, Mapping) else {"": problem.law}
    for (name, law), (_, elements) in zip(laws.items(), problem.regions, strict=True):
        points, of = _inside(problem, elements), f" of {name!r}" if name else ""
        what = "source" if law.components == 1 else "body force"
        for text, value in _components(what, law.load):
            yield "law", value, points, f"{text}{of}", name
    for traction in problem.tractions:
        points, on = _along(problem, traction.boundary), traction.boundary
        for text, value in _components("traction", traction.value):
            yield "tractions", value, points, f"{text} on {on!r}", on
    for support in problem.supports:
        points, on = _along(problem, support.boundary), support.boundary
        for given in support.value:
            if given is not None:
                yield "dirichlet", given, points, f"the displacement given on {on!r}", on
    for number, obstacle in enumerate(problem.obstacles):
        place = obstacle.boundary
        points = _inside(problem, ...) if isinstance(place, Place) else _along(problem, place)
        gap = obstacle.offset if obstacle.level is None else obstacle.distance
        yield "obstacle", gap, points, "the obstacle", number
        yield "friction", obstacle.friction, points, "the friction bound", number
        yield "coulomb", obstacle.coulomb, points, "Coulomb's coefficient", number


def _components(what: str, values: tuple[Coefficient, ...]) -> list[tuple[str, Coefficient]]:
    """Names and values of the components of a load."""
    if len(values) == 1:
        return [(f"the {what}", values[0])]
    return [(f"component {i} of the {what}", value) for i, value in enumerate(values, 1)]


def _inside(problem: ProblemData, elements: Any) -> Array:
    """The nodes of some elements and their quadrature points for loads, (2, points)."""
    local = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5]])
    if isinstance(problem.rule, int):
        local, _ = get_quadrature_tri(min(problem.rule, HIGHEST_DEGREE))
    return _nodes_and_points(problem.mesh.p, problem.mesh.t[:, elements], local)


def _along(problem: ProblemData, boundary: str) -> Array:
    """The nodes of a boundary and its quadrature points for tractions, (2, points)."""
    degree = problem.rule if isinstance(problem.rule, int) else 0
    local, _ = get_quadrature_line(max(degree, LEAST_DEGREE_ON_EDGES))
    return _nodes_and_points(problem.mesh.p, problem.mesh.facets[:, problem.mesh.boundaries[boundary]], local)


def _nodes_and_points(p: Array, cells: NDArray, local: Array) -> Array:
    weights = np.vstack([1 - local.sum(axis=0), local])
    return np.hstack([p[:, np.unique(cells)], np.einsum("cae,an->cen", p[:, cells], weights).reshape(2, -1)])


def _check_friction(problem: ProblemData) -> None:
    """With friction a contact node may be fixed along the tangent at zero, and not otherwise."""
    held, value = problem.held
    for part in problem.contact_sets:
        if not part.obstacle.frictional:
            continue
        nodes = part.nodes
        oblique = np.all(np.abs(part.obstacle.normals(problem.mesh.p[:, nodes])) > NO_NORMAL, axis=0)
        for node in nodes[np.any(held[:, nodes] & (oblique | (value[:, nodes] != 0)), axis=0)]:
            raise ProblemError(
                "friction",
                f"contact node {node} has friction and one given displacement component: with friction it "
                "must be zero and along the tangent",
            )


def _check_given_gaps(problem: ProblemData, contact: ContactSet) -> None:
    """Where given displacements fix the gap it must not be negative: no displacement would be admissible."""
    nodes, gap, scale = problem.given_gaps(contact)
    if nodes.size == 0:
        return
    worst = int(np.argmin(gap))
    least = -CLOSED * scale
    if problem.numbers:  # of a design that an optimiser has found
        least -= FOUND * float(np.max(np.ptp(problem.mesh.p, axis=1)))
    if gap[worst] < least:
        x, y = problem.mesh.p[:, nodes[worst]]
        raise ProblemError(
            "obstacle",
            f"no displacement is admissible: that given at node {nodes[worst]}, ({x:.6g}, {y:.6g}), makes "
            f"its gap {gap[worst]:.6g}",
        )


def _check_shared_nodes(problem: ProblemData) -> None:
    """A node may meet two foundations if it can obey both gaps, and without friction."""
    nodes, count = np.unique(problem.contact_nodes, return_counts=True)
    held, _ = problem.held
    for node, number in zip(nodes[count > 1], count[count > 1], strict=True):
        meeting = [part.obstacle for part in problem.contact_sets if node in part.nodes]
        normals = np.hstack([obstacle.normals(problem.mesh.p[:, [node]]) for obstacle in meeting])
        said = f"node {node} belongs to {number} contact boundaries"
        if number > 2 or np.linalg.matrix_rank(normals[~held[:, node]], tol=INDEPENDENT) < number:
            said += " and cannot obey all their gaps: end one of them before it"
            raise ProblemError("obstacle", said)
        if any(obstacle.frictional for obstacle in meeting):
            raise ProblemError("friction", f"{said}, one of them with friction: end one of them before it")


def _check_rigid_motions(problem: ProblemData) -> None:
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
