"""Two boundaries whose nodes coincide: contact between two bodies, or between the sides of an interface.

The gap of a pair of nodes is ``n . (u+ - u-) + g``, with the normal n from the second boundary to the first.
It is that of their edges: of a straight line, or of a circle that is a curve of the motion, along which both
nodes move. So a pair is an obstacle without a place of its own, whose gap depends on two nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.errors import Place, ProblemError, contradicting
from rmesh_nlp.evaluation import ROUNDING, Array, Index, largest_side
from rmesh_nlp.meshes.arrays import repaired
from rmesh_nlp.meshes.curves import Circle, Curve
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, edges_on, mismatch, nodes_of
from rmesh_nlp.meshes.interfaces import opened
from rmesh_nlp.problem.obstacle import BEHIND, Obstacle
from rmesh_nlp.problem.surfaces import off_circle

Curves = Mapping[str, Curve]


def united(mesh: MeshTri, obstacles: tuple[Obstacle, ...]) -> tuple[MeshTri, tuple[Obstacle, ...]]:
    """Obstacles of one foundation, on boundaries with a common node, as one on a boundary of all their names.

    At such a node they would have two equal gaps, whose forces nothing tells apart.
    """
    names = mesh.boundaries or {}
    for a, b in combinations([one for one in obstacles if one.boundary in names], 2):
        both = names[a.boundary], names[b.boundary]
        meet = np.intersect1d(*(mesh.facets[:, each] for each in both)).size
        if meet and a.boundary != b.boundary and a.surface == b.surface:
            name = f"{a.boundary} and {b.boundary}"
            rest = (one for one in obstacles if one is not a and one is not b)
            mesh = mesh.with_boundaries({name: np.union1d(*both)})
            return united(mesh, (replace(a, boundary=name), *rest))
    return mesh, obstacles


def paired(
    mesh: MeshTri, obstacles: tuple[Obstacle, ...], curves: Curves
) -> tuple[MeshTri, tuple[Obstacle, ...], Curves]:
    """The mesh with interfaces opened and nodes of pairs at one place, and pairs with their normals.

    Two names of one line inside the mesh are an interface as well. A curve of one boundary of a pair is one
    of both. A ProblemError names what cannot be paired.
    """
    mesh, obstacles = united(mesh, obstacles)
    result, curves = list(obstacles), dict(curves)
    for number, obstacle in enumerate(obstacles):
        if not (isinstance(obstacle.boundary, str) and obstacle.other):
            continue
        first, second, place = obstacle.boundary, obstacle.other, ("contact", number)
        facets = mesh.boundaries[first]
        if set(facets) == set(mesh.boundaries[second]):
            second += BEHIND * (first == second)
            with contradicting(place):
                normal, sides, _ = _normal(mesh, first, curves.get(first))
                is_front = sides * (normal @ obstacle.normal or 1.0) > 0
                mesh = opened(mesh, first, second, np.where(is_front, *mesh.f2t[:, facets]))
        if curve := curves.get(first, curves.get(second)):
            curves |= {first: curve, second: curve}
        nodes, others = matched(mesh, first, second, place)
        p, far = np.array(mesh.p), np.max(np.abs(mesh.p[:, others] - mesh.p[:, nodes]))
        if far > ROUNDING * largest_side(p):
            said = f"put the nodes of {second!r} on those of {first!r}, at most {far:.2g} away"
            repaired(said)
        p[:, others] = p[:, nodes]
        if far > 0:
            mesh = replace(mesh, doflocs=p)
        if curve is None and obstacle.level is not None:  # a polygon keeps the normals of its circle
            continue
        with contradicting(place):
            normal, sides, level = _normal(mesh, first, curve)
            if np.any(sides != sides[0]):
                raise ValueError(f"the body of {first!r} is on both sides of it")
        sign, signed = float(sides[0]), tuple((sides[0] * normal).tolist())
        result[number] = replace(obstacle, other=second, normal=signed, level=level and partial(level, sign))
    return mesh, tuple(result), curves


def matched(mesh: MeshTri, first: str, second: str, place: Place) -> tuple[Index, Index]:
    """Nodes of a boundary, and those of another one at the same places; the ends of cracks have both."""
    nodes, others = nodes_of(mesh, first), nodes_of(mesh, second)
    if wrong := mismatch(mesh.p, (nodes, others), (first, second)):
        raise ProblemError(place, wrong)
    nearest = cKDTree(mesh.p[:, others].T).query(mesh.p[:, nodes].T)[1]
    same = np.full(mesh.p.shape[1], -1)
    same[nodes] = others[nearest]
    edges, images = edges_on(mesh, second), same[edges_on(mesh, first)]
    edges, images = (np.unique(np.sort(each, axis=0), axis=1) for each in (edges, images))
    if not np.array_equal(edges, images):
        raise ProblemError(place, f"the edges of {first!r} and {second!r} do not coincide")
    return nodes, others[nearest]


def edges_of_pair(mesh: MeshTri, first: str, second: str) -> Index:
    """(2, edges) facets of both boundaries, each beside the one at its place."""
    both = [np.unique(mesh.boundaries[name]) for name in (first, second)]
    middles = [mesh.p[:, mesh.facets[:, facets]].mean(axis=1).T for facets in both]
    return np.stack([both[0], both[1][cKDTree(middles[1]).query(middles[0])[1]]])


def _normal(mesh: MeshTri, name: str, curve: Curve | None) -> tuple[Array, Array, partial | None]:
    """A normal of a boundary, on which side of each edge its first element is, and ``level(sign, x, y)``.

    Without a curve the normal points up, or to the right.
    """
    facets = mesh.boundaries[name]
    a, b = mesh.p[:, mesh.facets[:, facets]].transpose(1, 0, 2)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1)
    if isinstance(curve, Circle):
        x, y = curve.centre
        off = np.hypot(*(inside - [[x], [y]])) - np.hypot(*((a + b) / 2 - [[x], [y]]))
        return np.array([0.0, 1.0]), np.sign(off), partial(off_circle, curve.centre, curve.radius)
    if curve is not None:
        raise ValueError(f"{name!r} is on a curve that is no circle: a pair is straight or on a circle")
    x, y = b - a
    normals = np.stack([-y, x]) / np.hypot(x, y)
    normals *= np.where(np.abs(normals[1]) > SEVEN_DIGITS, np.sign(normals[1]), np.sign(normals[0]))
    normal = normals.mean(axis=1)
    if np.max(np.abs(normals - normal[:, None])) > SEVEN_DIGITS:
        said = f"{name!r} bends: a pair is straight or on a circle; name its straight pieces one by one, or "
        raise ValueError(f"{said}give its curve, as in [curves] {name} = 'circle'")
    normal[np.abs(normal) < SEVEN_DIGITS] = 0.0
    normal /= np.linalg.norm(normal)
    return normal, np.sign(normal @ (inside - a)), None
