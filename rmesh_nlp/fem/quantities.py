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

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.fem.bernstein import size
from rmesh_nlp.fem.element import corners, plain
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.fem.fields import ElementGroup
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.objective import Density, Fields, Groups, Objective, Term
from rmesh_nlp.fem.space import DisplacementSpace, Index, contact_edges, outward_edges
from rmesh_nlp.problem import ContactProblem, Law
from rmesh_nlp.problem.coefficients import OPEN, is_nonzero
from rmesh_nlp.problem.data import ContactSet

__all__ = ["at_point", "body_integral", "boundary_integral", "nodal", "peak_pressure"]

DEGREE = 8
"""Degree of the rules for densities of one's own."""


def _quantity(name: str) -> Callable[[Groups], Objective]:
    """Makes an objective of the element groups of one term."""
    return lambda groups: Objective(((1.0, Term(name, groups)),))


def _integral(
    on: Fields, name: str, cells: Index, degree: int, density: Density, factor: float = 1.0
) -> list[ElementGroup]:
    def scalar(*arguments: Any) -> Any:
        return _scalar(density(*arguments), name)

    return [on.integral("quantity", cells, degree, scalar, factor=factor)]


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
        gradient (components, 2). Elements are taken with straight sides, also beside curves.
    name : str
    subdomain : str, optional
    degree : int
        Of the quadrature.
    """

    @_quantity(name)
    def quantity(on: Fields) -> list[ElementGroup]:
        triangles = on.problem.triangles
        if subdomain is not None:
            triangles = triangles[:, _named(on.problem, "subdomain", subdomain)]
        return _integral(on, name, triangles, degree, density)

    return quantity


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
        ``density(x, y, u, n)`` with the position, the displacement and the outward unit normal (2,). Edges
        are straight, also on curves.
    name : str
    mean : bool
        Whether to divide by the length of the boundary on the initial mesh.
    degree : int
        Of the quadrature.
    """

    @_quantity(name)
    def quantity(on: Fields) -> list[ElementGroup]:
        if np.any(on.problem.mesh.f2t[1, _named(on.problem, "boundary", boundary)] >= 0):
            raise ValueError(f"{boundary!r} is an interface inside the body, not a boundary")
        edges = outward_edges(on.problem, boundary)
        return _integral(on, name, edges, degree, density, 1 / _length(on.problem, edges) if mean else 1.0)

    return quantity


def nodal(
    nodes: Sequence[int], function: Callable[[Any, Any], Any], *, name: str = "nodal quantity"
) -> Objective:
    """A function of the positions and displacements of some vertices, at once.

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

    @_quantity(name)
    def quantity(on: Fields) -> list[ElementGroup]:
        n = on.problem.mesh.p.shape[1]
        if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n:
            raise ValueError(f"{name}: node numbers must lie between 0 and {n - 1}, got {list(nodes)}")
        X, u = corners(chosen.size, on.problem.components)
        return [on.group("quantity", X, u, _scalar(function(X, u), name), chosen, on.space.number[chosen])]

    return quantity


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

    @_quantity(name)
    def quantity(on: Fields) -> Functional:
        p = on.problem.mesh.p
        distance = np.linalg.norm(p - np.array(point)[:, None], axis=0)
        node = int(np.argmin(distance))
        if not distance[node] <= tolerance * float(np.max(np.ptp(p, axis=1))):
            near = tuple(float(c) for c in p[:, node])
            raise ValueError(f"{name}: no node at {tuple(point)}; the nearest is node {node} at {near}")
        one = nodal([node], lambda X, u: function(X[0, 0], X[1, 0], u[:, 0]), name=name)
        return one.on(on)

    return quantity


def peak_pressure(
    boundary: str, reference: float, *, exponent: int = 8, name: str = "peak pressure"
) -> Objective:
    """The peak of the contact pressure, smoothed: the mean of ``(pressure / reference)^exponent``.

    The pressure at a node is the force with which its elements pull at it, less their load, over the node's
    share omega_i of the boundary (5.9): at equilibrium the pressure that solutions report, its mean weighted
    by the node's shape function. Of order 2 edges have nodes too. Stresses of the elements would be less
    accurate; an optimiser lowers them while the forces grow.

    The mean is over the length of the contact boundary on the initial mesh, with the weights omega_i.
    ``reference * value**(1 / exponent)`` lies between the mean and the peak; it is not taken as the
    objective itself, because its second derivatives would couple all nodes of the boundary,
    while the minimisers are the same. Tractions and point loads at contact nodes are not taken off.

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
    if not (np.isfinite(reference) and reference > 0):
        raise ValueError(f"{name}: the reference pressure must be positive, got {reference}")
    if not exponent >= 3:
        raise ValueError(f"{name}: the exponent must be at least 3, got {exponent}")

    @_quantity(name)
    def quantity(on: Fields) -> list[ElementGroup]:
        problem, space = on.problem, on.space
        part = contact_on(space, boundary)
        obstacle, contact = part.obstacle, part.nodes
        forces = [_forces(law, problem.rule, space.order) for law, _ in problem.regions]
        edges = contact_edges(problem, obstacle)
        length, per, result = _length(problem, edges), size(space.order, 3), []
        for (laws, carriers, ends), patches in _patches(space, contact, edges).items():
            vertices = np.array(patches).T
            nodes = np.vstack([space.nodes_of(vertices[3 * k : 3 * k + 3]) for k in range(len(laws))])
            n = len(vertices)
            X, u = corners(n, 2)[0], corners(len(nodes), problem.components)[1]
            own, force = 0 if carriers == 1 else 3, ca.SX.zeros(problem.components)
            for k, law in enumerate(laws):
                pulls = forces[law](ca.vec(X[:, 3 * k : 3 * k + 3]), ca.vec(u[:, per * k : per * (k + 1)]))
                force += pulls[:, own]
            share = sum(ca.norm_2(X[:, n - 1 - k] - X[:, 0]) for k in range(ends)) / size(space.order, 2)
            x, y = ca.vertsplit(X[:, :carriers] @ np.full(carriers, 1 / carriers))
            pressure = ca.fmax(ca.dot(obstacle.direction(x, y), force) / share, 0)
            value = share / length * (pressure / reference) ** exponent
            result.append(on.group("peak_pressure", X, u, value, vertices, nodes))
        return result

    return quantity


def contact_on(space: DisplacementSpace, boundary: str) -> ContactSet:
    """The contact set of a boundary."""
    for part in space.contact_sets:
        if part.obstacle.boundary == boundary:
            return part
    every = space.problem.obstacles
    known = [str(obstacle.boundary) for obstacle in every if isinstance(obstacle.boundary, str)]
    raise ValueError(f"{boundary!r} is not a contact boundary: choose from {', '.join(known) or 'none'}")


def _forces(law: Law, quadrature: str | int, order: int) -> ca.Function:
    """``(X_e, u_e) ->`` what a triangle pulls with at its nodes, its load taken off (components, nodes)."""
    symbols = corners(3, law.components, order=order)
    X, u = (ca.vec(part) for part in symbols)
    energy = strain_energy(law, order)(X, u)[0]
    if any(is_nonzero(component) for component in law.load):
        energy += plain(*load_energy(law, quadrature, order))(X, u)[0]
    pulls = ca.reshape(ca.gradient(energy, u), *symbols[1].shape)
    return ca.Function("forces", [X, u], [pulls], OPEN)


def _patches(
    space: DisplacementSpace, contact: Index, edges: Index
) -> dict[tuple[tuple[int, ...], int, int], list[list[int]]]:
    """Vertices around each contact node, by the laws of its triangles and the numbers of vertices and edges.

    Those of its triangles, in each first the vertex or the two of the edge that carry the node, then the
    other ends of its contact edges.
    """
    problem = space.problem
    law_of = np.empty(problem.mesh.t.shape[1], dtype=int)
    for number, (_, elements) in enumerate(problem.regions):
        law_of[elements] = number
    patches: dict[tuple[tuple[int, ...], int, int], list[list[int]]] = defaultdict(list)
    triangles, near = problem.triangles, np.flatnonzero(np.isin(problem.triangles, edges).any(axis=0))
    for _, carriers, _ in space.kinds(contact):
        for own in carriers.T:
            element = near[np.isin(triangles[:, near], own).sum(axis=0) == own.size]
            element = element[np.argsort(law_of[element], kind="stable")]
            around = [_turned(triangles[:, i], own) for i in element]
            beside = edges[:, np.isin(edges, own).sum(axis=0) == own.size]
            ends = [int(pair[pair != around[0][0]][0]) for pair in beside.T]
            key = tuple(int(law_of[i]) for i in element), own.size, len(ends)
            patches[key].append([*(int(vertex) for vertex in np.concatenate(around)), *ends])
    return patches


def _turned(triangle: Index, own: Index) -> Index:
    """The vertices of a triangle, counter-clockwise, those of ``own`` first."""
    turns = (np.roll(triangle, -k) for k in range(3))
    return next(turned for turned in turns if np.isin(turned[: own.size], own).all())


def _length(problem: ContactProblem, edges: Index) -> float:
    p = problem.mesh.p
    return float(np.linalg.norm(p[:, edges[1]] - p[:, edges[0]], axis=0).sum())


def _named(problem: ContactProblem, kind: str, name: str) -> Index:
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
