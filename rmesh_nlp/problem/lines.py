"""Lines of a mesh: outer boundary, interfaces between subdomains, named interior facets.

A node of a line may slide if exactly two of its facets are on lines, these are collinear, and
both belong to the same named parts and separate the same subdomains. Else it is a corner, the
end of a part, or a point where a coefficient jumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.contact_problem import ContactProblem

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
