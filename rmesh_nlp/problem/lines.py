"""Lines of a mesh: outer boundary, interfaces between subdomains, named interior facets.

A node of a line may slide if exactly two of its facets are on lines, these are collinear, and
both belong to the same named parts and separate the same subdomains. Else it is a corner, the
end of a part, or a point where a coefficient jumps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Curve

if TYPE_CHECKING:
    from rmesh_nlp.problem.contact_problem import ContactProblem

OFF = 1e-3
"""Distance from its curve, in units of the shortest edge of the boundary, at which a given node is not on it.
Mesh generators write nodes with 1e-10 or better; a wrong radius is off by more."""

EXACT = 1e-14
"""Distance, in units of the extent of the mesh, that is rounding."""


def nodes_of(mesh: MeshTri, name: str) -> NDArray[np.int64]:
    """Sorted numbers of the nodes on a named boundary."""
    return np.unique(mesh.facets[:, np.asarray(mesh.boundaries[name])]).astype(np.int64)


def onto_curves(mesh: MeshTri, curves: Mapping[str, Curve], *, anywhere: bool = False) -> MeshTri:
    """The mesh with the nodes of named boundaries exactly on their curves.

    Parameters
    ----------
    mesh : MeshTri
    curves : mapping from boundary names to Curve
    anywhere : bool
        Whether nodes may be far from their curve, as new ones in the middle of an edge are.

    Raises
    ------
    ValueError
        If a node is not on the curve that its boundary is said to be on.
    """
    moved = np.array(mesh.p, dtype=float)
    for name, curve in curves.items():
        nodes = nodes_of(mesh, name)
        places = curve.at(curve.nearest(mesh.p[:, nodes]))
        off = np.linalg.norm(places - mesh.p[:, nodes], axis=0)
        if not anywhere:
            a, b = mesh.facets[:, np.asarray(mesh.boundaries[name])]
            shortest = float(np.min(np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0)))
            if np.max(off, initial=0.0) > OFF * shortest:
                worst = int(np.argmax(off))
                x, y = mesh.p[:, nodes[worst]]
                raise ValueError(
                    f"node {nodes[worst]} of {name!r} at ({x:.6g}, {y:.6g}) is {off[worst]:.3g} off its curve"
                )
        shifted = off > EXACT * float(np.max(np.ptp(mesh.p, axis=1)))
        moved[:, nodes[shifted]] = places[:, shifted]
    return mesh if np.array_equal(moved, mesh.p) else replace(mesh, doflocs=moved)


def parameters_of(curve: Curve, points: Array) -> tuple[Array, Array]:
    """Parameters (n,) of points (2, n) on a curve and the length (n,) of curve per unit of the parameter."""
    t = curve.nearest(points)
    return t, np.linalg.norm(curve.velocity(t), axis=0)


STRAIGHT = 1e-8
"""Largest sine of the angle between two facets that count as one straight piece."""


def sliding_directions(
    problem: ContactProblem, *, geometry_only: bool = False
) -> tuple[NDArray[np.int64], Array]:
    """Nodes on lines, and unit tangents (2, nodes) of those that may slide, zero elsewhere.

    With ``geometry_only`` the ends of named parts and jumps of coefficients do not stop a node:
    only the geometry does. Kinks of the outer boundary always stop it.
    """
    mesh = problem.mesh
    label = _labels(problem)
    outer = np.zeros(mesh.facets.shape[1], dtype=bool)
    outer[mesh.boundary_facets()] = True
    facets = np.flatnonzero(label > 0)
    ends, label, outer = mesh.facets[:, facets], label[facets], outer[facets]
    direction = mesh.p[:, ends[1]] - mesh.p[:, ends[0]]
    direction = direction / np.linalg.norm(direction, axis=0)
    tangent = np.zeros(mesh.p.shape)
    on_line = np.unique(ends)
    if geometry_only:
        # the outer boundary decides where there is one; interfaces that end there move along
        for part in (~outer, outer):
            owner, one, two = _pairs(ends[:, part])
            number = np.flatnonzero(part)
            _fill(tangent, direction, owner, number[one], number[two], np.ones(owner.size, dtype=bool))
        return on_line, tangent
    owner, one, two = _pairs(ends)
    _fill(tangent, direction, owner, one, two, label[one] == label[two])
    return on_line, tangent


def on_curve(problem: ContactProblem) -> NDArray[np.int64]:
    """Number (nodes,) of the curve of the motion that each node may slide along, -1 where there is none.

    Such a node has exactly two facets on lines, of the same named parts and between the same
    subdomains, and both are on the boundary that the curve is of: ends of parts stay.
    """
    mesh, curves = problem.mesh, problem.motion.curves
    result = np.full(mesh.p.shape[1], -1)
    if not curves:
        return result
    label = _labels(problem)
    facets = np.flatnonzero(label > 0)
    owner, one, two = _pairs(mesh.facets[:, facets])
    alike = label[facets[one]] == label[facets[two]]
    for number, name in enumerate(curves):
        part = np.zeros(mesh.facets.shape[1], dtype=bool)
        part[np.asarray(mesh.boundaries[name])] = True
        here = alike & part[facets[one]] & part[facets[two]]
        result[owner[here]] = np.where(result[owner[here]] < 0, number, result[owner[here]])
    return result


def line_facets(problem: ContactProblem) -> NDArray[np.int64]:
    """Numbers of the facets on lines."""
    return np.flatnonzero(_labels(problem) > 0)


def _pairs(ends: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes with exactly two of these facets, and the numbers of both."""
    node = ends.ravel()
    facet = np.tile(np.arange(ends.shape[1]), 2)
    order = np.argsort(node, kind="stable")
    node, facet = node[order], facet[order]
    owner, start, count = np.unique(node, return_index=True, return_counts=True)
    regular = count == 2
    return owner[regular], facet[start[regular]], facet[start[regular] + 1]


def _fill(
    tangent: Array, direction: Array, owner: NDArray, one: NDArray, two: NDArray, alike: NDArray
) -> None:
    turn = direction[0, one] * direction[1, two] - direction[1, one] * direction[0, two]
    slides = (np.abs(turn) < STRAIGHT) & alike
    chosen = direction[:, one[slides]]
    # exactly axis-parallel where it is so up to rounding, so that a coordinate really stays put
    tangent[:, owner] = 0.0
    tangent[:, owner[slides]] = np.where(np.abs(chosen) < STRAIGHT, 0.0, chosen)


def _labels(problem: ContactProblem) -> NDArray[np.int64]:
    """A number per facet: 0 off all lines, else which names and subdomains it has on its sides."""
    mesh = problem.mesh
    n_facets = mesh.facets.shape[1]
    names = sorted(name for name in (mesh.boundaries or {}) if not name.startswith("gmsh:"))
    member = np.zeros((n_facets, len(names)), dtype=np.int64)
    for column, name in enumerate(names):
        member[np.asarray(mesh.boundaries[name]), column] = 1
    zone = element_zones(problem)
    left, right = mesh.f2t
    inside = right >= 0
    sides = np.vstack([zone[left], np.where(inside, zone[right], -1)])
    on_line = ~inside | (sides[0] != sides[1]) | np.any(member > 0, axis=1)
    result = np.zeros(n_facets, dtype=np.int64)
    key = np.hstack([np.sort(sides[:, on_line], axis=0).T, member[on_line]])
    result[on_line] = 1 + np.unique(key, axis=0, return_inverse=True)[1].ravel()
    return result


def element_zones(problem: ContactProblem) -> NDArray[np.int64]:
    """A number per element: which set of named subdomains it belongs to."""
    mesh = problem.mesh
    names = sorted(name for name in (mesh.subdomains or {}) if not name.startswith("gmsh:"))
    if not names:
        return np.zeros(mesh.t.shape[1], dtype=np.int64)
    member = np.zeros((mesh.t.shape[1], len(names) + 1), dtype=bool)
    for column, name in enumerate(names):
        member[np.asarray(mesh.subdomains[name]), column] = True
    return np.unique(member, axis=0, return_inverse=True)[1].ravel()
