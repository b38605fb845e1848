"""Penetration between contact nodes: gaps are imposed at nodes, and foundations may pass in between."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import contact_edges, nodal_weights
from rmesh_nlp.problem import ContactProblem, Obstacle, Place

_FRACTIONS = np.arange(9) / 8
ON_EDGE = np.vstack([1 - _FRACTIONS, _FRACTIONS])
"""Barycentric coordinates (2, points) of the points on an edge where penetration is looked for: also its
ends, where a node whose displacement is given may have moved into the foundation."""

ON_TRIANGLE = np.array([[6, 0, 0, 3, 3, 0, 2], [0, 6, 0, 3, 0, 3, 2], [0, 0, 6, 0, 3, 3, 2]]) / 6
"""The same in a triangle: its vertices, the midpoints of its edges, and its centre."""

OF_DISPLACEMENT = 0.1
"""Penetration that is allowed, as a part of the largest displacement along the normal, ..."""

OF_EDGE = 0.05
"""... or, where displacements are lengths, of the local edge, whichever is larger. An edge of length h over a
foundation of curvature k penetrates it by k h^2 / 8: a twentieth of its length where it spans 0.4 radians."""

NO_DEPTH = 1e-12
"""A penetration that is rounding."""


def penetration(problem: ContactProblem, nodes: Array, displacement: Array) -> float:
    """Largest negative gap on the contact edges or triangles, as a positive length; 0 without."""
    deepest = 0.0
    for obstacle in problem.obstacles:
        depth, _ = penetrations(problem, obstacle, nodes, displacement)
        deepest = max(deepest, float(np.max(depth, initial=0.0)))
    return deepest


def penetrations(
    problem: ContactProblem, obstacle: Obstacle, nodes: Array, displacement: Array
) -> tuple[Array, Array]:
    """Deepest penetration of each contact edge, or triangle of an interior contact set, and its length.

    Returns
    -------
    depth, length : (cells,) arrays
        Depth >= 0 in units of the gap; the length of the edge, or of the first edge of the triangle.
    """
    if obstacle.boundary is Place.INTERIOR:
        cells, points = problem.triangles, ON_TRIANGLE
    else:
        cells, points = contact_edges(problem, obstacle), ON_EDGE
    length = np.linalg.norm(nodes[:, cells[1]] - nodes[:, cells[0]], axis=0)
    where = np.einsum("cve,vk->cek", nodes[:, cells], points).reshape(2, -1)
    u = np.einsum("cve,vk->cek", displacement[:, cells], points).reshape(displacement.shape[0], -1)
    gap = np.sum(obstacle.normals(where) * u, axis=0) + obstacle.distances(where)
    return np.maximum(0.0, -gap.reshape(cells.shape[1], -1)).max(axis=1, initial=0.0), length


def penetration_work(problem: ContactProblem, nodes: Array, displacement: Array, pressure: Array) -> float:
    """Energy that penetration between contact nodes is worth: the integral of pressure times depth.

    To first order the energy would be higher by this if the gap held everywhere on the contact
    boundaries; interior contact sets are left out.

    Parameters
    ----------
    pressure : (nodes,) array
    """
    work = 0.0
    for obstacle in problem.obstacles:
        if isinstance(obstacle.boundary, Place):
            continue
        edges = contact_edges(problem, obstacle)
        length = np.linalg.norm(nodes[:, edges[1]] - nodes[:, edges[0]], axis=0)
        where = np.einsum("cve,vk->cek", nodes[:, edges], ON_EDGE).reshape(2, -1)
        u = np.einsum("cve,vk->cek", displacement[:, edges], ON_EDGE).reshape(displacement.shape[0], -1)
        gap = np.sum(obstacle.normals(where) * u, axis=0) + obstacle.distances(where)
        depth = np.maximum(0.0, -gap).reshape(edges.shape[1], -1)
        pressing = np.einsum("ve,vk->ek", pressure[edges], ON_EDGE)
        work += float(length @ np.mean(pressing * depth, axis=1))
    return work


def penetration_work_of(model: ContactModel, nodes: Array, state: Equilibrium) -> float:
    """The same of a contact solution ``state`` at node positions ``nodes`` (2, nodes)."""
    pressure = np.zeros(nodes.shape[1])
    if state.normal_force.size:
        weights = nodal_weights(model.problem, nodes)
        np.add.at(pressure, model.contact_nodes, state.normal_force / weights)
    return penetration_work(model.problem, nodes, model.displacement.values(state.u), pressure)


def penetration_excess(problem: ContactProblem, nodes: Array, displacement: Array) -> float:
    """The largest part of what is allowed that a penetration takes, above 1 for one that is too deep."""
    worst = 0.0
    for obstacle in problem.obstacles:
        depth, length = penetrations(problem, obstacle, nodes, displacement)
        place = obstacle.boundary
        touched = problem.triangles if isinstance(place, Place) else contact_edges(problem, obstacle)
        at = np.unique(touched)
        along = np.sum(obstacle.normals(nodes[:, at]) * displacement[:, at], axis=0)
        allowed = np.full(depth.size, OF_DISPLACEMENT * np.max(np.abs(along), initial=0.0))
        if problem.components == 2:
            allowed = np.maximum(allowed, OF_EDGE * length)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(depth > NO_DEPTH * (1 + allowed), depth / allowed, 0.0)
        worst = max(worst, float(np.max(part, initial=0.0)))
    return worst
