"""Levels of a cascade of meshes: coarser meshes, and prolongation of a map to a finer one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import Discretisation
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import ROUNDING, Array, Index, magnitude
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.coarsening import Lines, decimated
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.optimize.budget import checkpoint
from rmesh_nlp.problem import ContactProblem, Relative, signed_areas
from rmesh_nlp.problem.body import Body, gradients
from rmesh_nlp.problem.contact_problem import renumbered
from rmesh_nlp.problem.lines import line_facets, on_curve, sliding_directions
from rmesh_nlp.problem.rigid import rigid_motions

TURN = 0.3
"""Radians by which a curve may turn along an edge of a coarser mesh."""

WORTHWHILE = 2.0
"""Least factor by which a coarser mesh must be coarser."""


def coarsened(problem: ContactProblem, least: int = 60) -> ContactProblem | None:
    """The same problem on a coarser mesh with at least ``least`` nodes; None if there is none.

    Nodes are taken out. Those that the problem names by number stay, and are renumbered.
    """
    if problem.pairs:
        return None  # nodes would be taken out on one side alone
    try:
        return _on(problem, *_decimated(problem), least)
    except ValueError:
        return None  # nothing is left of a boundary or a subdomain


def hierarchy(problem: ContactProblem, coarsest: int) -> list[ContactProblem]:
    """The problem on coarser and coarser meshes, coarsest first, itself last."""
    levels = [problem]
    while True:
        checkpoint()
        coarser = coarsened(levels[-1], coarsest)
        if coarser is None or not _is_fixed(coarser):
            return levels[::-1]
        levels.append(coarser)


def _is_fixed(problem: ContactProblem) -> bool:
    """Whether no rigid-body mode is left: a coarse mesh may touch at one node where contact excludes it."""
    if rigid_motions(problem).size > 0:
        try:
            ContactSolver(problem)
        except ProblemError:
            return False
    return True


def _numbers(problem: ContactProblem) -> list[int]:
    """Nodes that the problem names by number."""
    return [*problem.motion.numbers, *(load.node for load in problem.point_loads)]


def _on(problem: ContactProblem, mesh: MeshTri, nodes: Index, least: int) -> ContactProblem | None:
    """The problem on a coarser mesh of some of its nodes; None if that is not what it should be."""
    n, size = problem.n_vertices, mesh.p.shape[1]
    if size < least or WORTHWHILE * size > n:
        return None
    delta = problem.motion.delta
    if isinstance(delta, Relative):
        delta = Relative(delta.fraction * np.sqrt(size / n))
        problem = replace(problem, motion=replace(problem.motion, delta=delta))
    try:
        coarser = renumbered(problem, mesh, {int(old): new for new, old in enumerate(nodes)})
    except ProblemError:
        return None  # too coarse for what the problem says
    return coarser if Body(coarser, coarser.mesh.p).is_upright() else None  # too coarse for its curves


def _turning(curve: Curve, nodes: Index, points: Array) -> Index:
    """Some of the nodes on a curve, between which it turns by little more than ``TURN``."""
    t = curve.nearest(points[:, nodes])
    order = np.argsort(t)
    angle = np.unwrap(np.arctan2(*curve.velocity(t[order])[::-1]))
    turned = np.floor(np.abs(angle - angle[0]) / TURN)
    return nodes[order][np.append(True, np.diff(turned) > 0)]


def _decimated(problem: ContactProblem) -> tuple[MeshTri, Index]:
    """The mesh with nodes taken out, and the numbers that its nodes had.

    Corners, nodes with a number, at kinks and enough on curves stay.
    """
    mesh = problem.mesh
    on_line, tangent = sliding_directions(problem)
    kept = np.zeros(mesh.p.shape[1], dtype=bool)
    kept[on_line] = ~(np.any(tangent[:, on_line] != 0, axis=0) | (on_curve(problem)[on_line] >= 0))
    kept[[*_numbers(problem), *problem.kink_nodes]] = True
    for name, curve in problem.motion.curves.items():
        kept[_turning(curve, problem.boundary_nodes(name), mesh.p)] = True
    lines = Lines(kept, mesh.facets[:, line_facets(mesh)])
    result = decimated(mesh.p, problem.triangles, lines)
    nodes = np.unique(result.triangles)
    number, place = np.full(mesh.p.shape[1], -1), np.full(mesh.nelements, -1)
    number[nodes], place[result.element] = np.arange(nodes.size), np.arange(result.element.size)
    boundaries = {}
    for name, facets in (mesh.boundaries or {}).items():
        ends = result.into[mesh.facets[:, facets]]
        boundaries[name] = number[np.unique(np.sort(ends[:, ends[0] != ends[1]], axis=0), axis=1)].T
    subdomains = {}
    for name, elements in (mesh.subdomains or {}).items():
        members = place[elements]
        subdomains[name] = members[members >= 0]
    coarse = from_arrays(mesh.p[:, nodes].T, number[result.triangles].T, boundaries, subdomains)
    return coarse, nodes


CANDIDATES = 16
"""Elements with the nearest centres that are looked at first."""


def interpolated(nodes: Array, triangles: NDArray, values: Array, points: Array) -> Array:
    """Piecewise linear interpolation of nodal ``values`` (components, nodes) at ``points`` (2, points).

    A point outside the mesh (between a curve and its chord) has the value of the nearest place in the
    element that it is least outside of.
    """
    vertices, weights = located(nodes, triangles, points)
    return np.einsum("cvk,vk->ck", values[:, vertices], weights)


def located(nodes: Array, triangles: NDArray, points: Array) -> tuple[Index, Array]:
    """Vertices (3, points) of the element around each point and its barycentric coordinates there."""
    corner = nodes[:, triangles]
    tree = cKDTree(corner.mean(axis=1).T)
    k = min(CANDIDATES, triangles.shape[1])
    _, near = tree.query(points.T, k=k)
    near = np.reshape(near, (points.shape[1], k))
    weights = _barycentric(corner[:, :, near], points[:, :, None])
    best = np.argmax(weights.min(axis=0), axis=1)
    rows = np.arange(points.shape[1])
    element, weights = near[rows, best], weights[:, rows, best]
    for number in np.flatnonzero(weights.min(axis=0) < -ROUNDING):
        everywhere = _barycentric(corner, points[:, number, None])
        element[number] = int(np.argmax(everywhere.min(axis=0)))
        weights[:, number] = everywhere[:, element[number]]
    weights = np.maximum(weights, 0.0)
    return triangles[:, element], weights / weights.sum(axis=0)


def _barycentric(corner: Array, point: Array) -> Array:
    return 1 / 3 + np.einsum("dv...,d...->v...", gradients(corner), point - corner.mean(axis=1))


def prolonged(coarse_nodes: Array, coarse_triangles: NDArray, shift: Array, fine: Discretisation) -> Array:
    """Outer variables of a finer mesh that follow the ``shift`` (2, coarse nodes) of a coarser one.

    An element that lies across several may be inverted: then the shift is made smaller as a whole.
    """
    X0, triangles, mesh_map = fine.problem.mesh.p, fine.problem.triangles, fine.mesh_map
    before, after = (signed_areas(x, coarse_triangles) for x in (coarse_nodes, coarse_nodes + shift))
    # slivers that the coarse map makes on purpose are kept, and are no reason to damp the map
    least = np.clip(0.5 * float(np.min(after / before)), 1e-9, 1e-3) * signed_areas(X0, triangles)
    q = mesh_map.clipped(mesh_map.q_of(X0 + interpolated(coarse_nodes, coarse_triangles, shift, X0)))
    while not np.all(signed_areas(mesh_map.positions.values(q), triangles) > least):
        q = 0.9 * q
        if magnitude(q) < 1e-6:
            return np.zeros_like(q)
    return q
