"""Outer objectives of contact forces: quantities of the pressure on a contact boundary.

The pressure at a contact vertex is the mean ``F_v / omega_v`` of :mod:`rmesh_nlp.fem.contact_pressure`: the
force there, of order 2 with half of those at the edges beside it, over half the length of these edges, which
move with the nodes. Integrals over the boundary are sums with the same weights, so that a pressure that is
constant has exactly its own integral. Vertices whose gap is given have no part in them, but in ``resultant``.
The values of a record differ from these means by a step along the boundary, at its ends and where lengths of
edges differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.evaluation import Expression, Index
from rmesh_nlp.fem.cells import Straight
from rmesh_nlp.fem.contact_pressure import ends, may_slip
from rmesh_nlp.fem.edge_gaps import patches
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import Field, Fields, Forces
from rmesh_nlp.fem.functional import Functional, Groups
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.problem.coefficients import OPEN
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.design import symbol
from rmesh_nlp.settings import check_positive


def level_pressure(boundary: str, *, name: str = "level pressure") -> Objective:
    """The integral of ``(p - mean p)^2``, the mean over the contact boundary: zero for a uniform pressure.

    It is ``sum F_v^2 / omega_v - (sum F_v)^2 / sum omega_v``.
    """

    def quantity(on: Fields) -> Functional:
        squares = vertex_groups(on, boundary, lambda share, force: force**2 / share)
        total = vertex_groups(on, boundary, lambda _, force: force)
        length = vertex_groups(on, boundary, lambda share, _: share)
        return Functional(squares, (total, length), lambda s: -(s[0] ** 2) / s[1])

    return Term(name, quantity, minimised_only=True).alone


def resultant(boundary: str, *, name: str = "resultant") -> Objective:
    """The integral of the contact pressure, in N/m: of all normal forces, and those at shared vertices.

    At a vertex that contact shares with a support the pressure continues from the nodes beside it
    (:func:`rmesh_nlp.fem.contact_pressure.force_at_end`).
    """

    def quantity(on: Fields) -> Groups:
        part, normal = contact_on(on.space, boundary), ca.SX.sym("lambda")
        return _integral(on, part, part.nodes, [_forces_on(on, boundary).normal], normal, normal)

    return Term(name, quantity).alone


def shear(boundary: str, *, name: str = "shear") -> Objective:
    """The integral of the tangential stress on a contact boundary with friction, in N/m.

    It is the friction on the body, positive along the normal of the foundation turned by -90 degrees. Nodes
    whose tangential displacement is given have no part in it.
    """

    def quantity(on: Fields) -> Groups:
        forces, part = _forces_on(on, boundary), contact_on(on.space, boundary)
        if not part.obstacle.friction_law:
            raise BadInputError(f"{name}: contact on {boundary!r} is without friction")
        minus, plus = ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
        free = part.nodes[may_slip(on.space, part.number)]
        return _integral(on, part, free, forces[1:], ca.vertcat(minus, plus), plus - minus)

    return Term(name, quantity).alone


LARGEST = "max-pressure"
"""The word of the largest pressure, as an objective and as a constraint."""


def level_name(boundary: str) -> str:
    """The design variable that stands for the largest pressure of a boundary."""
    return f"largest_pressure_on_{boundary}"


def largest_pressure(boundary: str, *, name: str = "largest pressure") -> Objective:
    """The largest pressure at a contact vertex; minimised by the level that it stays below.

    On a problem without that level it is the largest value itself.
    """

    def quantity(on: Fields) -> Functional:
        level, design = level_name(boundary), on.positions.design
        if design is not None and level in design.names:
            function = ca.Function("level", [symbol(level)], [symbol(level), NO_ROWS])
            return Functional([on.group(function, [design.of((level,), 1)])])
        groups = vertex_groups(on, boundary, lambda share, force: force / share)
        each = [[group.some(np.array([k]))] for group in groups for k in range(group.size)]
        return Functional([], tuple(each), lambda s: reduce(ca.fmax, ca.vertsplit(s)))

    return Term(name, quantity, minimised_only=True, level_of=boundary).alone


def contact_length(boundary: str, reference: float, *, name: str = "contact length") -> Objective:
    """The length on which the body presses, smoothed: the integral of ``p^2 / (p^2 + P^2)``.

    As the reference pressure P tends to 0 it rises to the sum of omega_v over all vertices that press, up to
    half an edge from the length of contact of a record at either end. It is continuously differentiable where
    a node begins to press.

    Parameters
    ----------
    boundary : str
        A contact boundary.
    reference : float
        P, a pressure well below those on most of the contact, in units of stress.
    name : str
        What tables and messages call it.
    """
    with located(name):
        check_positive(reference=reference)

    def value(share: Expression, force: Expression) -> Expression:
        return share * force**2 / (force**2 + (reference * share) ** 2)

    return Term(name, lambda on: vertex_groups(on, boundary, value)).alone


def peak_pressure(
    boundary: str, reference: float, *, exponent: int = 8, name: str = "peak pressure"
) -> Objective:
    """The peak of the contact pressure, smoothed: the mean of ``(pressure / reference)^exponent``.

    The mean is over the length of the contact boundary on the initial mesh, with the weights omega_v.
    ``reference * value**(1 / exponent)`` lies between the mean and the peak; it is not taken as the
    objective itself, since the minimisers are the same.

    Parameters
    ----------
    boundary : str
        A contact boundary.
    reference : float
        A pressure of the size that is expected, in units of stress.
    exponent : int
        At least 3, so that second derivatives are continuous; the larger, the closer to the peak.
    name : str
        What tables and messages call it.
    """
    with located(name):
        check_positive(reference=reference)
    if not exponent >= 3:
        raise BadInputError(f"{name}: the exponent must be at least 3, got {exponent}")

    def quantity(on: Fields) -> Groups:
        length = on.space.extent(contact_edges(on.problem, contact_on(on.space, boundary).obstacle))

        def value(share: Expression, force: Expression) -> Expression:
            return share / length * (force / (share * reference)) ** exponent

        return vertex_groups(on, boundary, value)

    return Term(name, quantity).alone


def _integral(
    on: Fields, part: ContactSet, nodes: Index, forces: Sequence[Field], symbols: ca.SX, force: ca.SX
) -> Groups:
    """The sum of ``force(symbols)`` over contact nodes (n,), and of that at shared vertices.

    ``symbols`` are the values of ``forces`` at a node.
    """
    fields = [field.component(part.number) for field in forces]
    function = ca.Function("force", ca.vertsplit(symbols), [force])
    at_node = ca.Function("force", ca.vertsplit(symbols), [force, NO_ROWS])
    groups = [on.group(at_node, [field.at(nodes[None]) for field in fields])]
    for end in ends(on.space, part.number):
        X = ca.SX.sym("X", 2, len(end.vertices))
        columns = [ca.SX.sym("lambda", end.nodes.size) for _ in fields]
        beside = (function(*values) for values in zip(*map(ca.vertsplit, columns), strict=True))
        shared = end.force(on.space)(X, ca.vertcat(*beside))
        shared = ca.fmax(shared, 0) if len(fields) == 1 else shared
        at_end = ca.Function("force_at_end", [ca.vec(X), *columns], [shared, NO_ROWS])
        local = [field.at(end.nodes[:, None]) for field in fields]
        groups.append(on.group(at_end, [on.positions.at(np.array(end.vertices)[:, None]), *local]))
    return groups


def vertex_groups(
    on: Fields, boundary: str, value: Callable[[Expression, Expression], Expression], row: int | None = None
) -> Groups:
    """The sum of ``value(omega_v, F_v)`` over the vertices of a contact boundary; rows from ``row`` on."""
    part, groups = contact_on(on.space, boundary), []
    normal = _forces_on(on, boundary).normal.component(part.number)
    edge = Straight(2, 1, 1, on.problem.measure)
    hat = edge.function("hat", edge.integral(lambda x, y, value, n: value, edge.rule(1)))
    for patch in patches(on.space, part):
        if patch.at_edge:
            continue
        first, *others = patch.vertices
        edges = [on.space.nodes_at(first, other) for other in others] if on.space.order == 2 else []
        X, force = ca.SX.sym("X", 2, 1 + len(others)), ca.SX.sym("lambda", 1 + len(edges))
        share = sum(hat(ca.vec(X[:, [a, b]]), ca.DM([1, 0]))[0] for a, b in patch.cells)
        total = ca.dot(ca.DM([1, *([0.5] * len(edges))]), force)
        of_vertex, rows = ca.SX(value(share, total)), None
        if row is not None:
            rows, row = row + np.arange(first.size)[None], row + first.size
        values = [of_vertex, NO_ROWS] if rows is None else [0, of_vertex]
        function = ca.Function("at_vertex", [ca.vec(X), force], values, OPEN)
        local = on.positions.at(patch.vertices), normal.at(np.stack([first, *edges]))
        groups.append(on.group(function, local, rows))
    return groups


def contact_on(space: DisplacementSpace, boundary: str) -> ContactSet:
    """The contact nodes of a boundary, and the obstacle that they may meet."""
    parts = [part for part in space.contact_sets if part.obstacle.boundary == boundary and part.nodes.size]
    if len(parts) == 1:
        return parts[0]
    if parts:
        raise BadInputError(f"{boundary!r} may meet {len(parts)} obstacles: give each a boundary of its own")
    every = space.problem.obstacles
    names = [str(obstacle.boundary) for obstacle in every if isinstance(obstacle.boundary, str)]
    raise BadInputError(
        f"{boundary!r} is not a contact boundary: choose from {', '.join(map(repr, names)) or 'none'}"
    )


def _forces_on(on: Fields, boundary: str) -> Forces:
    if on.forces is None:
        raise BadInputError(f"the forces on {boundary!r} are not known here")
    return on.forces
