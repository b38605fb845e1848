"""Lines of a mesh, along which nodes slide: outer boundary, interfaces, named facets, and their curves.

A node of a line may slide if exactly two of its facets are on lines, these are collinear, and
both belong to the same named parts and separate the same subdomains. Else it is a corner, the
end of a part, or a point where a coefficient jumps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from skfem import Basis, ElementTriP1, MeshTri
from skfem.models.poisson import laplace

from rmesh_nlp.errors import ProblemError, contradicting
from rmesh_nlp.evaluation import Array, Index, Mask, cross, largest_side
from rmesh_nlp.meshes.arrays import repaired
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import (
    EPSILON,
    SEVEN_DIGITS,
    edges_on,
    last_digit,
    lengths,
    named_by_user,
    nodes_of,
    pieces_of,
)
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.problem.data import ProblemData

OFF = 1e-3
"""Distance from its curve, in units of the shortest edge of the boundary, at which a given node is not on it.
Mesh generators write nodes with 1e-10 or better; a wrong radius is off by more."""


FLAT = 2e-4
"""Largest distance from its line of a node of a straight piece, in units of the length of the piece."""

BENT = 1e-2
"""The same of a piece that may be meant straight: few digits may be exact, a square of four cells has one."""


def onto_lines(mesh: MeshTri) -> MeshTri:
    """The mesh with nodes that are on straight lines up to rounding exactly on these; a warning says so.

    Coordinates in files often have five to eight digits, which bends nodes by larger angles the shorter their
    edges are, while a flat arc of many edges is within rounding at each of them. So lines are cut where a
    node is farther from that through its neighbours than rounding explains. What lies between two cuts is
    straight if all of it is within rounding of the line through its ends; arcs are not, unless they are no
    higher than that. Where rounding is more than ``FLAT`` nodes stay, with a warning. Cuts are ten times
    farther, or edges of an arc that are short enough were a piece.
    """
    close = 1.5 * last_digit(mesh.p)  # a node and the line are half a unit off in two directions: sqrt(2)
    exact = 100 * EPSILON * largest_side(mesh.p)
    if close < exact:
        return mesh
    ends = mesh.facets[:, line_facets(mesh)]
    node, *beside = joints(ends)
    neighbours = [mesh.p[:, ends[:, facet].sum(axis=0) - node] for facet in beside]
    smooth = _distances(mesh.p[:, node], *neighbours) <= 10 * close
    piece = np.tile(pieces_of(np.stack(beside)[:, smooth], ends.shape[1]), 2)
    (piece, node), count = np.unique([piece, ends.ravel()], axis=1, return_counts=True)
    is_open = np.isin(piece, np.flatnonzero(np.bincount(piece[count == 1]) == 2))
    piece, node, count = np.unique(piece[is_open], return_inverse=True)[1], node[is_open], count[is_open]
    a, b = mesh.p[:, node[count == 1]].reshape(2, -1, 2).transpose(2, 0, 1)[..., piece]
    off, length = _distances(mesh.p[:, node], a, b), np.linalg.norm(b - a, axis=0)
    bent, curved = (
        np.bincount(piece, off > np.minimum(close, most * length))[piece] > 0 for most in (FLAT, BENT)
    )
    if np.any(doubtful := bent & ~curved & (off > exact)):
        said = f"left {doubtful.sum()} nodes up to {np.max(off[doubtful]):.2g} off straight lines, which "
        repaired(said + "rounding would explain: they do not slide; write coordinates with more digits")
    moved = ~bent & (off > exact)
    if not np.any(moved):
        return mesh
    said = f"put {moved.sum()} nodes on the straight lines that they are on but for rounding, at most "
    repaired(f"{said}{np.max(off[moved]):.2g} away")
    X, share = np.array(mesh.p), np.sum((mesh.p[:, node] - a) * (b - a), axis=0) / length**2
    X[:, node[moved]] = (a + share * (b - a))[:, moved]
    return replace(mesh, doflocs=X)


def _distances(points: Array, a: Array, b: Array) -> Array:
    """Of points (2, n) from the lines through ``a`` and ``b``."""
    return np.abs(cross(b - a, points - a)) / np.maximum(np.linalg.norm(b - a, axis=0), 1e-300)


def onto_curves(mesh: MeshTri, curves: Mapping[str, Curve], *, anywhere: bool = False) -> MeshTri:
    """The mesh with the nodes of named boundaries exactly on their curves.

    Nodes may be far from their curve if ``anywhere``, as new ones in the middle of an edge are; else a
    ProblemError names one that is not on it.
    """
    moved = np.array(mesh.p, dtype=float)
    for name, curve in curves.items():
        nodes = nodes_of(mesh, name)
        places = curve.at(curve.nearest(mesh.p[:, nodes]))
        off = np.linalg.norm(places - mesh.p[:, nodes], axis=0)
        worst = int(np.argmax(off))
        if not anywhere and off[worst] > OFF * np.min(lengths(mesh.p, edges_on(mesh, name))):
            x, y = mesh.p[:, nodes[worst]]
            raise ProblemError(
                ("curves", name),
                f"node {nodes[worst]} of {name!r} at ({x:.6g}, {y:.6g}) is {off[worst]:.3g} off its curve",
            )
        shifted = off > 100 * EPSILON * largest_side(mesh.p)
        moved[:, nodes[shifted]] = places[:, shifted]
    return mesh if np.array_equal(moved, mesh.p) else replace(mesh, doflocs=moved)


def bent(mesh: MeshTri, curves: Mapping[str, Curve]) -> MeshTri:
    """The mesh with the nodes of named boundaries on their curves, however far these are.

    Nodes on other lines stay; the others go along by a harmonic map, so that no element is folded where the
    arcs leave their chords far behind.
    """
    target = onto_curves(mesh, curves, anywhere=True)
    if target is mesh:
        return mesh
    fixed = np.unique(mesh.facets[:, line_facets(mesh)])
    moved = mesh.p + _harmonic(mesh, target.p - mesh.p, fixed, np.zeros(mesh.p.shape))
    moved[:, fixed] = target.p[:, fixed]
    return replace(mesh, doflocs=moved)


def harmonic_motions(problem: ProblemData) -> Array:
    """(shapes, 2, nodes) displacements at amplitude 1: given on the boundary of a shape, harmonic elsewhere.

    Nodes that may slide along a straight line do so, all others on lines stay. A ProblemError names a node
    that would move although a displacement is given there as a function of position.
    """
    mesh, displacements = problem.mesh, np.zeros((len(problem.shapes), *problem.mesh.p.shape))
    on_line, tangent = sliding_directions(problem)
    held = [s.boundary for s in problem.supports if any(map(callable, s.value))]
    for moved, shape in zip(displacements, problem.shapes, strict=True):
        given, along, place = nodes_of(mesh, shape.boundary), tangent.copy(), ("design", "shapes", shape.name)
        with contradicting((*place, "motion")):
            for row, component in zip(moved, shape.motion, strict=True):
                row[given] = on_points(component, mesh.p[:, given], f"the motion of the shape {shape.name!r}")
        along[:, given] = 0.0
        moved[:] = _harmonic(mesh, moved, np.union1d(on_line, given), along)
        for name in held:
            for node in nodes_of(mesh, name)[np.any(moved[:, nodes_of(mesh, name)] != 0, axis=0)][:1]:
                said = f"the shape {shape.name!r} would move node {node}, where a displacement is given"
                raise ProblemError(place, f"{said} on {name!r} as a function of position")
    return displacements


def _harmonic(mesh: MeshTri, given: Array, fixed: Index, tangent: Array) -> Array:
    """Displacements (2, nodes): those given at ``fixed`` nodes, and harmonic elsewhere.

    Fixed nodes with a tangent slide along it besides.
    """
    n = mesh.p.shape[1]
    free = np.setdiff1d(np.arange(n), fixed)
    slides = np.flatnonzero(np.any(tangent != 0, axis=0))
    row = np.concatenate([free, n + free, slides, n + slides])
    column = np.concatenate([np.arange(2 * free.size), np.tile(2 * free.size + np.arange(slides.size), 2)])
    value = np.concatenate([np.ones(2 * free.size), *tangent[:, slides]])
    basis = sp.csr_array((value, (row, column)), shape=(2 * n, 2 * free.size + slides.size))
    stiffness = laplace.assemble(Basis(mesh, ElementTriP1()))
    stiffness = sp.block_diag([stiffness, stiffness], format="csr")
    start = given.ravel()
    right = -basis.T @ (stiffness @ start)
    if right.size:
        start = start + basis @ splu(sp.csc_matrix(basis.T @ stiffness @ basis)).solve(right)
    return start.reshape(2, n)


def sliding_directions(problem: ProblemData, *, geometry_only: bool = False) -> tuple[Index, Array]:
    """Nodes on lines, and unit tangents (2, nodes) of those that may slide, zero elsewhere.

    With ``geometry_only`` the ends of named parts and jumps of coefficients do not stop a node:
    only the geometry does. Kinks of the outer boundary always stop it.
    """
    mesh, label = problem.mesh, _labels(problem.mesh)
    facets = np.flatnonzero(label > 0)
    ends, label = mesh.facets[:, facets], label[facets]
    direction = mesh.p[:, ends[1]] - mesh.p[:, ends[0]]
    direction = direction / np.linalg.norm(direction, axis=0)
    tangent, every = np.zeros(mesh.p.shape), np.arange(facets.size)
    parts = [every]
    if geometry_only:
        # the outer boundary, last, decides where there is one; interfaces that end there move along
        outer = np.isin(facets, mesh.boundary_facets())
        parts, label = [every[~outer], every[outer]], np.zeros_like(label)
    for part in parts:
        owner, first, second = joints(ends[:, part])
        first, second = part[first], part[second]
        turn = cross(direction[:, first], direction[:, second])
        slides = (np.abs(turn) < SEVEN_DIGITS) & (label[first] == label[second])
        chosen = direction[:, first[slides]]
        # exactly axis-parallel where it is so up to rounding, so that a coordinate really stays put
        tangent[:, owner] = 0.0
        tangent[:, owner[slides]] = np.where(np.abs(chosen) < SEVEN_DIGITS, 0.0, chosen)
    return np.unique(ends), tangent


def on_curve(problem: ProblemData) -> Index:
    """Number (nodes,) of the curve of the motion that each node may slide along, -1 where there is none.

    Such a node has exactly two facets on lines, of the same named parts and between the same
    subdomains, and both are on the boundary that the curve is of: ends of parts stay.
    """
    mesh, curves = problem.mesh, problem.motion.curves
    result = np.full(mesh.p.shape[1], -1)
    if not curves:
        return result
    label = _labels(mesh)
    facets = np.flatnonzero(label > 0)
    owner, first, second = joints(mesh.facets[:, facets])
    first, second = facets[first], facets[second]
    for number, name in enumerate(curves):
        part = _members(mesh.boundaries, name, label.size)
        nodes = owner[(label[first] == label[second]) & part[first] & part[second]]
        result[nodes] = np.where(result[nodes] < 0, number, result[nodes])
    return result


def line_facets(mesh: MeshTri) -> Index:
    """Numbers of the facets on lines."""
    return np.flatnonzero(_labels(mesh) > 0)


def joints(ends: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes with exactly two of these facets, and the numbers of both."""
    order = np.argsort(ends.ravel(), kind="stable")
    owner, start, count = np.unique(ends.ravel()[order], return_index=True, return_counts=True)
    facet, start = order % ends.shape[1], start[count == 2]
    return owner[count == 2], facet[start], facet[start + 1]


def _labels(mesh: MeshTri) -> Index:
    """A number per facet: 0 off all lines, else which names and subdomains it has on its sides."""
    member = _table(mesh.boundaries, mesh.nfacets)
    zone = np.append(element_zones(mesh), -1)  # the last one outside, where f2t is -1
    sides = np.sort(zone[mesh.f2t], axis=0)
    on_line = (mesh.f2t[1] < 0) | (sides[0] != sides[1]) | np.any(member, axis=1)
    result = np.zeros(on_line.size, dtype=np.int64)
    key = np.hstack([sides[:, on_line].T, member[on_line]])
    result[on_line] = 1 + np.unique(key, axis=0, return_inverse=True)[1].ravel()
    return result


def element_zones(mesh: MeshTri) -> Index:
    """A number per element: which set of named subdomains it belongs to."""
    member = _table(mesh.subdomains, mesh.nelements)
    if member.shape[1] == 0:
        return np.zeros(len(member), dtype=np.int64)
    return np.unique(member, axis=0, return_inverse=True)[1].ravel()


def _table(groups: Mapping[str, Any] | None, count: int) -> Mask:
    """(count, names) which of so many facets or elements belong to each name; those of gmsh aside."""
    names = sorted(named_by_user(groups))
    return np.array([_members(groups, name, count) for name in names]).reshape(len(names), count).T


def _members(groups: Any, name: str, count: int) -> Mask:
    member = np.zeros(count, dtype=bool)
    member[groups[name]] = True
    return member
