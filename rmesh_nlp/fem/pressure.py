"""Outer objectives of contact forces: quantities of the pressure on a contact boundary.

The pressure at a contact node is its force over its share of the boundary, ``p_i = lambda_i / omega_i``, with
the weights of (5.9), which move with the nodes. Integrals over the boundary are sums with the same weights,
so that a pressure that is constant has exactly its own integral. Nodes whose displacement is given have no
pressure and no part in the boundary.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Expression, Mask
from rmesh_nlp.fem.bernstein import size
from rmesh_nlp.fem.edge_gaps import patches
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, Fields, Forces
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.meshes.geometry import lengths
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.design import symbol

__all__ = ["contact_length", "largest_pressure", "level_pressure", "peak_pressure", "resultant", "shear"]


def level_pressure(boundary: str, *, name: str = "level pressure") -> Objective:
    """The integral of ``(p - mean p)^2``, the mean over the contact boundary: zero for a uniform pressure.

    It is ``sum lambda_i^2 / omega_i - (sum lambda_i)^2 / sum omega_i``.
    """

    def quantity(on: Fields) -> Functional:
        squares = _groups(on, boundary, lambda share, force: force**2 / share)
        total = _groups(on, boundary, lambda _, force: force)
        length = _groups(on, boundary, lambda share, _: share)
        return Functional(squares, (total, length), lambda s: -(s[0] ** 2) / s[1])

    return Term(name, quantity, minimised_only=True).alone


def resultant(boundary: str, *, name: str = "resultant") -> Objective:
    """The integral of the contact pressure: the sum of all normal forces on a contact boundary, in N/m."""
    return _sum(name, boundary, lambda _, force: force)


def shear(boundary: str, *, name: str = "shear") -> Objective:
    """The integral of the tangential stress on a contact boundary with friction, in N/m.

    It is the friction on the body, positive along the normal of the foundation turned by -90 degrees. Nodes
    whose tangential displacement is given have no part in it.
    """

    def quantity(on: Fields) -> list[ElementGroup]:
        forces, part = _forces_on(on, boundary), contact_on(on.space, boundary)
        if not part.obstacle.frictional:
            raise ValueError(f"{name}: contact on {boundary!r} is without friction")
        minus, plus = ca.SX.sym("mu_minus"), ca.SX.sym("mu_plus")
        function = ca.Function("shear", [minus, plus], [plus - minus, NO_ROWS])
        free = part.nodes[_may_slip(on.space, part)]
        local = (field.component(part.number).at(free[None]) for field in forces[1:])
        return [on.group(function, list(local))]

    return Term(name, quantity).alone


LARGEST = "max-pressure"
"""The word of the largest pressure, as an objective and as a constraint."""


def level_name(boundary: str) -> str:
    """The design variable that stands for the largest pressure of a boundary."""
    return f"largest_pressure_on_{boundary}"


def largest_pressure(boundary: str, *, name: str = "largest pressure") -> Objective:
    """The largest pressure at a contact node; minimised by the level that it stays below.

    On a problem without that level it is the largest value itself.
    """

    def quantity(on: Fields) -> Functional:
        level, design = level_name(boundary), on.positions.design
        if design is not None and level in design.names:
            function = ca.Function("level", [symbol(level)], [symbol(level), NO_ROWS])
            return Functional([on.group(function, [design.of((level,), 1)])])
        groups = _groups(on, boundary, lambda share, force: force / share)
        each = [[group.some(np.array([k]))] for group in groups for k in range(group.size)]
        return Functional([], tuple(each), lambda s: reduce(ca.fmax, ca.vertsplit(s)))

    return Term(name, quantity, minimised_only=True, level_of=boundary).alone


def contact_length(boundary: str, reference: float, *, name: str = "contact length") -> Objective:
    """The length on which the body presses, smoothed: the integral of ``p^2 / (p^2 + P^2)``.

    As the reference pressure P tends to 0 it rises to the length of contact of a record, the sum of omega_i
    over all nodes that press. It is continuously differentiable where a node begins to press.

    Parameters
    ----------
    boundary : str
        A contact boundary.
    reference : float
        P, a pressure well below those on most of the contact, in units of stress.
    name : str
    """
    _check_reference(name, reference)
    return _sum(name, boundary, lambda share, force: share * force**2 / (force**2 + (reference * share) ** 2))


def peak_pressure(
    boundary: str, reference: float, *, exponent: int = 8, name: str = "peak pressure"
) -> Objective:
    """The peak of the contact pressure, smoothed: the mean of ``(pressure / reference)^exponent``.

    The mean is over the length of the contact boundary on the initial mesh, with the weights omega_i.
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
    """
    _check_reference(name, reference)
    if not exponent >= 3:
        raise ValueError(f"{name}: the exponent must be at least 3, got {exponent}")

    def quantity(on: Fields) -> list[ElementGroup]:
        length = float(
            lengths(
                on.problem.mesh.p, contact_edges(on.problem, contact_on(on.space, boundary).obstacle)
            ).sum()
        )

        def value(share: Expression, force: Expression) -> Expression:
            return share / length * (force / (share * reference)) ** exponent

        return _groups(on, boundary, value)

    return Term(name, quantity).alone


def _sum(name: str, boundary: str, value: Callable[[Expression, Expression], Expression]) -> Objective:
    return Term(name, lambda on: _groups(on, boundary, value)).alone


def _groups(
    on: Fields, boundary: str, value: Callable[[Expression, Expression], Expression]
) -> list[ElementGroup]:
    """The sum of ``value(omega_i, lambda_i)`` over the nodes of a contact boundary."""
    part, groups = contact_on(on.space, boundary), []
    normal = _forces_on(on, boundary).normal.component(part.number)
    for patch in patches(on.space, part):
        X, force = ca.SX.sym("X", 2, len(patch.vertices)), ca.SX.sym("lambda")
        share = sum(ca.norm_2(X[:, a] - X[:, b]) for a, b in patch.cells) / size(on.space.order, 2)
        function = ca.Function("at_node", [ca.vec(X), force], [ca.SX(value(share, force)), NO_ROWS])
        local = on.positions.at(patch.vertices), normal.at(part.nodes[None, patch.rows])
        groups.append(on.group(function, local))
    return groups


def _may_slip(space: DisplacementSpace, part: ContactSet) -> Mask:
    """(nodes,) Whether some displacement along the tangent is free."""
    given, _ = space.given()
    obstacle = space.problem.first_obstacles[part.number]
    normals = obstacle.normals(space.points(space.problem.mesh.p)[:, part.nodes])
    return np.any(~given[:, part.nodes] & (np.abs(normals[::-1]) > ROUNDING), axis=0)


def contact_on(space: DisplacementSpace, boundary: str) -> ContactSet:
    """The contact nodes of a boundary, and the obstacle that they may meet."""
    parts = [part for part in space.contact_sets if part.obstacle.boundary == boundary and part.nodes.size]
    if len(parts) == 1:
        return parts[0]
    if parts:
        raise ValueError(f"{boundary!r} may meet {len(parts)} obstacles: give each a boundary of its own")
    every = space.problem.obstacles
    names = [str(obstacle.boundary) for obstacle in every if isinstance(obstacle.boundary, str)]
    raise ValueError(f"{boundary!r} is not a contact boundary: choose from {', '.join(names) or 'none'}")


def _forces_on(on: Fields, boundary: str) -> Forces:
    if on.forces is None:
        raise ValueError(f"the forces on {boundary!r} are not known here")
    return on.forces


def _check_reference(name: str, reference: float) -> None:
    if not (np.isfinite(reference) and reference > 0):
        raise ValueError(f"{name}: the reference pressure must be positive, got {reference}")
