"""Quantities of interest: outer objectives of one's own, as densities or functions of nodes.

A quantity is written in CasADi: what it is given are symbols, and what it returns is an
expression of them. Its derivatives follow from that, and ``rmesh_nlp.verify_gradient`` tests
them. Quantities are added and weighted like numbers::

    sag = boundary_integral("top", lambda x, y, u, n: -u[1], mean=True)
    solve(problem, "nested", objective=sag + 0.01 * objective("quality"))

A quantity is minimised; a negative weight maximises it. An optimiser exploits a quadrature rule, so
integrals are taken with rules of high degree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from skfem.quadrature import get_quadrature_line

from rmesh_nlp.fem.contact_pressure import peak_pressure
from rmesh_nlp.fem.energy import objective_group, triangle_rule
from rmesh_nlp.fem.fields import ElementGroup, Field, Index
from rmesh_nlp.fem.objective import Groups, Objective, Term
from rmesh_nlp.problem import ContactProblem

__all__ = ["at_point", "body_integral", "boundary_integral", "nodal", "peak_pressure"]

DEGREE = 8
"""Degree of the rules for densities of one's own."""


def body_integral(
    density: Callable[[Any, Any, Any, Any], Any],
    *,
    name: str = "body integral",
    subdomain: str | None = None,
    degree: int = DEGREE,
) -> Objective:
    """Integral of a density over the elements of the body, or of a subdomain.

    Parameters
    ----------
    density : function
        ``density(x, y, u, slope)`` with the position, the displacement (components,) and its
        gradient (components, 2), constant on each element.
    name : str
    subdomain : str, optional
    degree : int
        Of the quadrature.
    """

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, _: Field
    ) -> list[ElementGroup]:
        triangles = problem.triangles
        if subdomain is not None:
            triangles = triangles[:, _named(problem, "subdomain", subdomain)]
        X, u = _corners(problem, 3)
        det, slope = _affine(X, u)
        barycentric, weights = triangle_rule(degree)
        total = ca.SX(0)
        for point, weight in zip(barycentric.T, weights, strict=True):
            x, y = ca.vertsplit(X @ point)
            total += weight * _scalar(density(x, y, u @ point, slope), name)
        return [_group(X, u, total * det / 2, triangles, positions, displacement)]

    return _objective(name, groups)


def boundary_integral(
    boundary: str,
    density: Callable[[Any, Any, Any, Any], Any],
    *,
    name: str = "boundary integral",
    mean: bool = False,
    degree: int = DEGREE,
) -> Objective:
    """Integral of a density over a named boundary, the contact boundary or another.

    Parameters
    ----------
    boundary : str
    density : function
        ``density(x, y, u, n)`` with the position, the displacement and the outward unit normal (2,).
    name : str
    mean : bool
        Whether to divide by the length of the boundary on the initial mesh.
    degree : int
        Of the quadrature.
    """

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, _: Field
    ) -> list[ElementGroup]:
        edges = _edges(problem, boundary)[:2]
        X, u = _corners(problem, 2)
        length, normal = _outward(X)
        total = ca.SX(0)
        points, weights = get_quadrature_line(degree)
        for point, weight in zip(np.vstack([1 - points, points]).T, weights, strict=True):
            x, y = ca.vertsplit(X @ point)
            total += weight * _scalar(density(x, y, u @ point, normal), name)
        share = 1 / _length(problem, edges) if mean else 1.0
        return [_group(X, u, share * length * total, edges, positions, displacement)]

    return _objective(name, groups)


def nodal(
    nodes: Sequence[int], function: Callable[[Any, Any], Any], *, name: str = "nodal quantity"
) -> Objective:
    """A function of the positions and displacements of some nodes, at once.

    It becomes one dense block of second derivatives: meant for a few nodes.

    Parameters
    ----------
    nodes : sequence of int
        Their numbers.
    function : function
        ``function(X, u)`` with the positions (2, nodes) and displacements (components, nodes).
    name : str
    """
    chosen = np.asarray(nodes, dtype=np.int64).reshape(-1, 1)

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, _: Field
    ) -> list[ElementGroup]:
        n = problem.mesh.p.shape[1]
        if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n:
            raise ValueError(f"{name}: node numbers must lie between 0 and {n - 1}, got {list(nodes)}")
        X, u = _corners(problem, chosen.size)
        return [_group(X, u, _scalar(function(X, u), name), chosen, positions, displacement)]

    return _objective(name, groups)


def at_point(
    point: tuple[float, float],
    function: Callable[[Any, Any, Any], Any],
    *,
    name: str = "value at a point",
    tolerance: float = 1e-6,
) -> Objective:
    """A function of the displacement at the node that is at ``point`` on the initial mesh.

    Parameters
    ----------
    point : (float, float)
    function : function
        ``function(x, y, u)`` with the node's position after the relocation. A node that is not
        pinned may move away from the point.
    name : str
    tolerance : float
        Largest distance of the node, relative to the extent of the mesh.

    Raises
    ------
    ValueError
        When it meets a mesh without a node there.
    """

    def groups(
        problem: ContactProblem, positions: Field, displacement: Field, slip: Field
    ) -> list[ElementGroup]:
        p = problem.mesh.p
        distance = np.linalg.norm(p - np.array(point)[:, None], axis=0)
        node = int(np.argmin(distance))
        if not distance[node] <= tolerance * float(np.max(np.ptp(p, axis=1))):
            near = tuple(float(c) for c in p[:, node])
            raise ValueError(f"{name}: no node at {tuple(point)}; the nearest is node {node} at {near}")
        one = nodal([node], lambda X, u: function(X[0, 0], X[1, 0], u[:, 0]), name=name)
        return one.groups(problem, positions, displacement, slip)

    return _objective(name, groups)


def _objective(name: str, groups: Groups) -> Objective:
    return Objective(((1.0, Term(name, groups)),))


def _corners(problem: ContactProblem, n: int) -> tuple[Any, Any]:
    """Symbols for the positions (2, n) and displacements (components, n) of n nodes."""
    X, u = ca.SX.sym("X", 2 * n), ca.SX.sym("u", problem.components * n)
    return ca.reshape(X, 2, n), ca.reshape(u, problem.components, n)


def _group(X: Any, u: Any, value: Any, nodes: Index, positions: Field, displacement: Field) -> ElementGroup:
    function = ca.Function("quantity", [ca.vec(X), ca.vec(u)], [value, ca.SX(0, 1)])
    return objective_group(function, (positions.at(nodes), displacement.at(nodes)))


def _affine(X: Any, u: Any) -> tuple[Any, Any]:
    """Twice the area of a triangle, and the displacement gradient (components, 2) on it."""
    edges = ca.horzcat(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    det = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    adjugate = ca.vertcat(ca.horzcat(edges[1, 1], -edges[0, 1]), ca.horzcat(-edges[1, 0], edges[0, 0]))
    return det, ca.horzcat(u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]) @ adjugate / det


def _outward(X: Any) -> tuple[Any, Any]:
    """Length and outward unit normal of the edge from the first to the second node, the body on its left."""
    tangent = X[:, 1] - X[:, 0]
    length = ca.norm_2(tangent)
    return length, ca.vertcat(tangent[1], -tangent[0]) / length


def _edges(problem: ContactProblem, boundary: str) -> Index:
    """(3, edges): the ends of the edges of a boundary, the body on their left, and the vertex there."""
    facets = _named(problem, "boundary", boundary)
    ends, beside = np.sort(problem.mesh.facets[:, facets], axis=0), problem.mesh.f2t[:, facets]
    if np.any(beside[1] >= 0):
        raise ValueError(f"{boundary!r} is an interface inside the body, not a boundary")
    result = np.zeros((3, facets.size), dtype=np.int64)
    for turn in range(3):
        corners = np.roll(problem.triangles[:, beside[0]], turn, axis=0)
        here = np.all(np.sort(corners[:2], axis=0) == ends, axis=0)
        result[:, here] = corners[:, here]
    return result


def _length(problem: ContactProblem, edges: Index) -> float:
    p = problem.mesh.p
    return float(np.linalg.norm(p[:, edges[1]] - p[:, edges[0]], axis=0).sum())


def _named(problem: ContactProblem, kind: str, name: str) -> Any:
    """Numbers of the facets of a boundary, or of the elements of a subdomain."""
    known = (problem.mesh.boundaries if kind == "boundary" else problem.mesh.subdomains) or {}
    if name not in known:
        raise ValueError(f"the mesh has no {kind} {name!r}: choose from {', '.join(known) or 'none'}")
    return np.asarray(known[name])


def _scalar(value: Any, name: str) -> Any:
    value = ca.SX(value)
    if value.shape != (1, 1):
        raise ValueError(f"{name}: the function must return one value, got one of shape {value.shape}")
    return value
