"""Whether a contact problem makes sense: checked once, when it is made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import Place, ProblemError, contradicting
from rmesh_nlp.evaluation import ROUNDING, Array, cross, largest_side, magnitude
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, edges_on, members_of
from rmesh_nlp.optimize.activity import BOUND_OF_AN_NLP
from rmesh_nlp.problem.coefficients import Coefficient, on_points
from rmesh_nlp.problem.data import ContactSet, ProblemData
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.motion import RULES
from rmesh_nlp.problem.quadrature import MIDPOINT, line_rule, traction_degree, triangle_rule
from rmesh_nlp.problem.rigid import in_words, kernel, rigid_motions, seen_by_contact, tool_of

RULE_NAMES, LARGEST_DEGREE = ("auto", MIDPOINT), 50
"""What a quadrature rule may be. Of higher degrees the points are so many that an energy takes minutes."""


def check(problem: ProblemData) -> None:
    """Raise a ProblemError if a problem contradicts itself."""
    if type(problem.order) is not int or problem.order not in (1, 2):
        raise ProblemError("order", f"the order of displacements must be 1 or 2, got {problem.order!r}")
    rule = problem.quadrature
    if rule not in RULE_NAMES and not (type(rule) is int and 1 <= rule <= LARGEST_DEGREE):
        raise ProblemError(
            "quadrature",
            f"quadrature must be 'auto', 'midpoint' or a degree from 1 to {LARGEST_DEGREE}, got {rule!r}",
        )
    if wrong := fault(problem.mesh):
        raise ProblemError("mesh", wrong)
    check_names(problem)
    _check_laws(problem)
    _check_values(problem)
    _check_contact_values(problem)
    _check_friction(problem)
    _check_tools(problem)
    _check_contact_edges(problem)
    for contact in problem.contact_sets:
        _check_given_gaps(problem, contact)
        if contact.nodes.size == 0:
            raise ProblemError(
                ("contact", contact.number, "boundary"),
                "no node of the contact set is free to move: all are fixed",
            )
    _check_shared_nodes(problem)
    _check_rigid_motions(problem)


def check_pairs(problem: ProblemData) -> None:
    """Raise a ProblemError if the mesh is none, or a pair not there or of a problem that has none."""
    if (kind := type(problem.mesh).__name__) != "MeshTri1":
        raise ProblemError("mesh", f"the mesh must be a skfem.MeshTri of first order, got {kind}")
    if problem.pairs:
        check_names(problem)
    for number, obstacle in enumerate(problem.obstacles):
        if obstacle.other and (problem.components == 1 or problem.shapes):
            reason = "cannot be moved by the shape of a design" if problem.shapes else "needs an elastic body"
            raise ProblemError(("contact", number), f"a pair of boundaries {reason}")


def check_names(problem: ProblemData) -> None:
    """Raise a ProblemError if a part of the problem names a boundary that the mesh has not."""
    if not problem.dirichlet and not problem.obstacles:
        raise ProblemError(
            "dirichlet",
            "at least one boundary must be held (dirichlet), or the energy has no minimum",
        )
    motion, places = problem.motion, [obstacle.boundary for obstacle in problem.obstacles]
    used: list[tuple[Any, Place]] = [
        *((support.boundary, ("dirichlet", support.boundary)) for support in problem.supports),
        *((traction.boundary, ("tractions", traction.boundary)) for traction in problem.tractions),
        *((shape.boundary, ("design", "shapes", shape.name, "boundary")) for shape in problem.shapes),
        *((name, ("curves", name)) for name in motion.curves),
        *((place, ("motion", rule)) for rule in RULES for place in getattr(motion, rule)),
        *((place, ("contact", number, "boundary")) for number, place in enumerate(places)),
        *((one.other or one.boundary, ("contact", number)) for number, one in enumerate(problem.obstacles)),
    ]
    for name, place in used:
        if isinstance(name, str) and members_of("boundary", name, problem.mesh.boundaries, place).size == 0:
            raise ProblemError(place, f"the boundary {name!r} of the mesh is empty")
    last = problem.n_vertices - 1
    for node in motion.numbers:
        if not 0 <= node <= last:
            raise ProblemError("motion", f"the motion names node {node}; nodes run from 0 to {last}")


def _check_contact_edges(problem: ProblemData) -> None:
    """Contact is on the outer boundary: names may stand for lines inside the body as well."""
    mesh = problem.mesh
    for number, obstacle in enumerate(problem.obstacles):
        if isinstance(obstacle.boundary, str):
            for edge in np.setdiff1d(mesh.boundaries[obstacle.boundary], mesh.boundary_facets()):
                a, b = mesh.facets[:, edge]
                raise ProblemError(
                    ("contact", number, "boundary"),
                    f"{obstacle.boundary!r} has an edge inside the body, between nodes {a} and {b}"
                    ": contact is on the outer boundary",
                )


def _check_laws(problem: ProblemData) -> None:
    if isinstance(problem.law, Mapping):
        _check_regions(problem, problem.law)
    node = int(np.argmin(problem.mesh.p[0]))
    if problem.axisymmetric and problem.mesh.p[0, node] < 0 and not problem.on_axis[node]:
        raise ProblemError(
            "mesh",
            f"a body of revolution has x = r >= 0, got {problem.mesh.p[0, node]:.6g} at node {node}",
        )


def _check_regions(problem: ProblemData, laws: Mapping[str, Law]) -> None:
    count = np.zeros(problem.mesh.nelements, dtype=int)
    for name in laws:
        count[members_of("subdomain", name, problem.mesh.subdomains, ("materials", name))] += 1
    for element in np.flatnonzero(count != 1):
        raise ProblemError(
            "materials",
            f"element {element} has {count[element]} laws: every element needs exactly one",
        )
    if len({law.components for law in problem.laws}) != 1:
        raise ProblemError("materials", "the laws of the subdomains mix scalar and elastic problems")
    if len({(law.measure, law.axisymmetric) for law in problem.laws}) != 1:
        raise ProblemError("materials", "the laws of the subdomains mix bodies of revolution and plane ones")


def _check_values(problem: ProblemData) -> None:
    """What is given per component has as many as the displacement, finite where it is evaluated."""
    n = problem.components
    for place, what, values, points in _given(problem):
        if len(values) != n:
            raise ProblemError(
                place,
                f"{what}, {values}, has {len(values)} components: it needs {n} value{'s' * (n > 1)}",
            )
        for i, value in enumerate(values, 1):
            if value is not None or place[0] != "dirichlet":  # else it is free
                _values(place, value, points, what if n == 1 else f"component {i} of {what}")


def _given(problem: ProblemData) -> Iterator[tuple[Place, str, Sequence[Coefficient | None], Array]]:
    """Place in the problem, description, a value per component, and points (2, n)."""
    for (name, law), (_, elements) in zip(problem.laws_by_name.items(), problem.regions, strict=True):
        key = "source" if law.components == 1 else "body_force"
        place, of = (("materials", name, key), f" of {name!r}") if name else (("material", key), "")
        yield place, f"the {key.replace('_', ' ')}{of}", law.load, _inside(problem, elements)
    for traction in problem.tractions:
        on = traction.boundary
        yield ("tractions", on), f"the traction on {on!r}", traction.value, _along(problem, on)
    for support in problem.supports:
        on = support.boundary
        yield ("dirichlet", on), f"the displacement given on {on!r}", support.value, _along(problem, on)
    for number, load in enumerate(problem.point_loads):
        if not 0 <= load.node < problem.n_vertices:
            raise ProblemError(
                ("point_loads", number),
                f"a point load names node {load.node}, which the mesh has not",
            )
        what, point = f"the point load at node {load.node}", problem.mesh.p[:, [load.node]]
        yield ("point_loads", number, "force"), what, load.force, point
    for number, obstacle in enumerate(problem.obstacles):
        if obstacle.level is None:
            yield ("contact", number), "the contact normal", obstacle.normal, problem.mesh.p[:, :1]
        elif problem.components == 1:
            raise ProblemError(("contact", number), "a circle or a curve needs an elastic body")


def _check_contact_values(problem: ProblemData) -> None:
    """Foundations are finite where gaps hold or are integrated, friction is not negative there."""
    for number, obstacle in enumerate(problem.obstacles):
        on = obstacle.boundary
        of, points = "", _inside(problem, ...)
        if isinstance(on, str):
            of, points = f" on {on!r}", _along(problem, on)
        _values(("contact", number), obstacle.clearance, points, f"the obstacle{of}")
        friction = ("friction", f"the friction bound{of}", obstacle.friction)
        for key, what, value in (friction, ("coulomb", f"Coulomb's coefficient{of}", obstacle.coulomb)):
            values = _values(("contact", number, key), value, points, what)
            least = int(np.argmin(values))
            if values[least] < 0:
                x, y = points[:, least]
                raise ProblemError(
                    ("contact", number, key),
                    f"{what} must not be negative, got {values[least]:.6g} at ({x:.6g}, {y:.6g})",
                )


def _values(place: Place, value: Coefficient, points: Array, what: str) -> Array:
    """Values (n,) at ``points`` (2, n); functions of position must take symbols, and be finite there."""
    with contradicting(place):
        values = on_points(value, points, what)
    return values


def _inside(problem: ProblemData, elements: Any) -> Array:
    """The nodes of some elements and their quadrature points for loads, (2, points)."""
    return _nodes_and_points(problem.mesh.p, problem.mesh.t[:, elements], triangle_rule(problem.rule)[0])


def _along(problem: ProblemData, boundary: str) -> Array:
    """The nodes of a boundary and its quadrature points for tractions, (2, points)."""
    edges = edges_on(problem.mesh, boundary)
    return _nodes_and_points(problem.mesh.p, edges, line_rule(traction_degree(problem.rule))[0])


def _nodes_and_points(p: Array, cells: NDArray, local: Array) -> Array:
    return np.hstack([p[:, np.unique(cells)], np.einsum("cae,an->cen", p[:, cells], local).reshape(2, -1)])


def _check_friction(problem: ProblemData) -> None:
    """With friction a contact node may be fixed along the tangent at zero, and not otherwise."""
    held, value = problem.held
    for part in problem.contact_sets:
        if not part.obstacle.friction_law:
            continue
        nodes, bodies = part.nodes, part.carriers(part.nodes)
        oblique = np.all(np.abs(part.obstacle.normals(problem.mesh.p[:, nodes])) > ROUNDING, axis=0)
        bodies = bodies[np.all(bodies < held.shape[1], axis=1)]
        wrong = [np.any(held[:, at] & (oblique | (value[:, at] != 0)), axis=0) for at in bodies]
        for node in nodes[np.any(wrong, axis=0)]:
            raise ProblemError(
                ("contact", part.number, "friction"),
                f"contact node {node} has friction and one given displacement component: with friction it "
                "must be zero and along the tangent",
            )


def _check_tools(problem: ProblemData) -> None:
    """A tool meets one node that is held at most: gaps of two would depend on its displacement alone.

    With friction a given displacement of a foundation must not rub.
    """
    held, _ = problem.held
    for part in problem.contact_sets:
        obstacle, nodes, place = part.obstacle, part.nodes, ("contact", part.number)
        fixed = nodes[np.all(held[:, nodes], axis=0)]
        if problem.axisymmetric and (any(obstacle.moves[:1]) or any((obstacle.displacement or ())[:1])):
            raise ProblemError(place, "a tool on a body of revolution moves along y, the axis, only")
        if obstacle.force is not None and fixed.size > 1:
            on = repr(obstacle.boundary)
            raise ProblemError(
                (*place, "boundary"),
                f"the displacements of nodes {fixed[0]} and {fixed[1]} of {on} are given; "
                "a tool meets one such node at most: end the contact boundary before them",
            )
        if obstacle.displacement is not None and obstacle.friction_law:
            moved = np.array(obstacle.displacement)
            along = cross(moved[:, None], obstacle.normals(problem.mesh.p[:, nodes]))
            if magnitude(along) > ROUNDING * magnitude(moved):
                raise ProblemError(
                    (*place, "displacement"),
                    f"with friction a foundation can be moved along its normal only, not by {moved}: "
                    "move what holds the body the other way (dirichlet), or press it by a force",
                )


def _check_given_gaps(problem: ProblemData, contact: ContactSet) -> None:
    """Where given displacements fix the gap it must not be negative: no displacement would be admissible."""
    nodes, gap, scale = problem.given_gaps(contact)
    if nodes.size == 0:
        return
    worst = int(np.argmin(gap))
    least = -ROUNDING * scale
    if problem.numbers:  # of a design to which an interior point has brought it
        least -= BOUND_OF_AN_NLP * largest_side(problem.mesh.p)
    if gap[worst] < least:
        x, y = problem.mesh.p[:, nodes[worst]]
        raise ProblemError(
            ("contact", contact.number),
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
        if number > 2 or np.linalg.matrix_rank(normals[~held[:, node]], tol=SEVEN_DIGITS) < number:
            said += " and cannot obey all their gaps: end one before it, or name one boundary of both"
            raise ProblemError("contact", said)
        if any(obstacle.friction_law for obstacle in meeting):
            raise ProblemError("contact", f"{said}, one of them with friction: end one of them before it")


def _check_rigid_motions(problem: ProblemData) -> None:
    """Given displacements, or contact with them, must prevent every rigid motion of every part.

    Whether contact does so under the load, and in one place only, is a matter of the forces:
    :mod:`rmesh_nlp.contact.active_set`.
    """
    motions = rigid_motions(problem)
    if len(free := kernel(seen_by_contact(problem, motions))):
        if (tool := tool_of(problem, free[0])) is not None:
            raise ProblemError(
                ("contact", tool, "move"),
                f"contact does not prevent a {in_words(problem, free[0])}: move it across its face only",
            )
        raise ProblemError(
            "dirichlet",
            f"the mesh can still move as a rigid body, by {in_words(problem, free[0])}: the given "
            "displacements must prevent it, and contact does not",
        )
