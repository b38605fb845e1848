"""The admissible set M: which nodes move, in which direction, how far, and element validity."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import IntEnum

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.assembly import CONSTANT, ElementGroup, Field
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, signed_areas


class Mobility(IntEnum):
    """How a node may move."""

    PINNED = 0
    SLIDING = 1
    FREE = 2


@dataclass(frozen=True)
class Freedoms:
    """The moves of all nodes as a few unknowns q in a box: X = X0 + P q.

    q is measured in units of the node's own box, so every bound is -1 <= q <= 1.

    Attributes
    ----------
    mobility : (nodes,) array of Mobility
    positions : Field
        (2, nodes), the positions as a function of q.
    n : int
        Length of q.
    """

    mobility: NDArray[np.int64]
    positions: Field
    n: int

    def q_of(self, nodes: Array) -> Array:
        """The unknowns q that give these positions (2, nodes)."""
        index, scale = self.positions.index, self.positions.scale
        moving = index != CONSTANT
        shift = (nodes - self.positions.offset)[moving] * scale[moving]
        weight = scale[moving] ** 2
        q = np.bincount(index[moving], shift, self.n) / np.bincount(index[moving], weight, self.n)
        return np.asarray(q)


def freedoms(problem: ContactProblem) -> Freedoms:
    """Classify every node and number its moves.

    A boundary node slides if its two boundary edges are collinear and belong to the same
    named parts; else it is a corner or the end of a part, and is pinned.
    """
    mesh, motion = problem.mesh, problem.motion
    n_nodes = mesh.p.shape[1]
    mobility = np.full(n_nodes, int(Mobility.FREE))
    tangent = _sliding_directions(problem)
    on_boundary = np.unique(mesh.facets[:, mesh.boundary_facets()])
    mobility[on_boundary] = Mobility.PINNED
    mobility[np.any(tangent != 0, axis=0)] = Mobility.SLIDING
    mobility[problem.boundary_nodes(motion.pinned)] = Mobility.PINNED
    mobility[np.setdiff1d(np.arange(n_nodes), mesh.t)] = Mobility.PINNED

    delta = np.asarray(motion.delta, dtype=float)
    index = np.full((2, n_nodes), CONSTANT)
    scale = np.ones((2, n_nodes))
    count = np.where(mobility == Mobility.FREE, 2, np.where(mobility == Mobility.SLIDING, 1, 0))
    first = np.concatenate([[0], np.cumsum(count)])
    free, sliding = mobility == Mobility.FREE, mobility == Mobility.SLIDING
    index[:, free] = first[:-1][free] + np.array([[0], [1]])
    scale[:, free] = delta[:, None]
    with np.errstate(divide="ignore"):
        reach = np.min(delta[:, None] / np.abs(tangent[:, sliding]), axis=0)
    step = reach * tangent[:, sliding]
    index[:, sliding] = np.where(step != 0, first[:-1][sliding], CONSTANT)
    scale[:, sliding] = np.where(step != 0, step, 1.0)
    return Freedoms(mobility, Field(index, scale, np.array(mesh.p, dtype=float)), int(first[-1]))


def _sliding_directions(problem: ContactProblem, tolerance: float = 1e-8) -> Array:
    """Unit tangent (2, nodes) of the boundary nodes that may slide, zero elsewhere."""
    mesh = problem.mesh
    facets = mesh.boundary_facets()
    ends = mesh.facets[:, facets]
    label = _part_labels(problem)[facets]
    direction = mesh.p[:, ends[1]] - mesh.p[:, ends[0]]
    direction = direction / np.linalg.norm(direction, axis=0)
    # each facet, seen from both its ends, sorted by node: a regular boundary node owns two
    node = ends.ravel()
    facet = np.tile(np.arange(facets.size), 2)
    order = np.argsort(node, kind="stable")
    node, facet = node[order], facet[order]
    owner, start, count = np.unique(node, return_index=True, return_counts=True)
    regular = count == 2
    owner, one, two = owner[regular], facet[start[regular]], facet[start[regular] + 1]
    turn = direction[0, one] * direction[1, two] - direction[1, one] * direction[0, two]
    slides = (np.abs(turn) < tolerance) & (label[one] == label[two])
    tangent = np.zeros(mesh.p.shape)
    chosen = direction[:, one[slides]]
    # exactly axis-parallel where it is so up to rounding, so that a coordinate really stays put
    tangent[:, owner[slides]] = np.where(np.abs(chosen) < tolerance, 0.0, chosen)
    return tangent


def _part_labels(problem: ContactProblem) -> NDArray[np.int64]:
    """One number per facet that tells which set of named boundaries it belongs to."""
    mesh = problem.mesh
    names = sorted(mesh.boundaries or {})
    member = np.zeros((mesh.facets.shape[1], len(names) + 1), dtype=bool)
    for column, name in enumerate(names):
        member[np.asarray(mesh.boundaries[name]), column] = True
    return np.unique(member, axis=0, return_inverse=True)[1].ravel()


def validity_group(problem: ContactProblem, free: Freedoms, first_row: int = 0) -> tuple[ElementGroup, Array]:
    """Constraints ``signed area >= bound`` for the elements that the boxes alone do not keep valid.

    The signed area is affine in each coordinate by itself, so its least value over the
    boxes is at one of their corners; elements that cannot fail there need no constraint.

    Returns
    -------
    group : ElementGroup
        One row per constrained element, numbered from ``first_row``.
    bounds : (rows,) array
        Lower bounds of the scaled areas (area / initial area).
    """
    triangles = problem.triangles
    initial = signed_areas(problem.mesh.p, triangles)
    at_risk = np.flatnonzero(_least_areas(free, triangles) < problem.motion.min_area_fraction * initial)
    X, area0 = ca.SX.sym("X", 2, 3), ca.SX.sym("area0")
    det = (X[0, 1] - X[0, 0]) * (X[1, 2] - X[1, 0]) - (X[0, 2] - X[0, 0]) * (X[1, 1] - X[1, 0])
    function = ca.Function("area", [ca.vec(X), area0], [0, det / (2 * area0)])
    scale = Field(np.full((1, at_risk.size), CONSTANT), np.ones((1, at_risk.size)), initial[at_risk][None, :])
    group = ElementGroup(
        function,
        (free.positions.at(triangles[:, at_risk]), scale),
        first_row + np.arange(at_risk.size)[None, :],
    )
    return group, np.full(at_risk.size, problem.motion.min_area_fraction)


def _least_areas(free: Freedoms, triangles: NDArray) -> Array:
    moving = free.positions.index != CONSTANT
    reach = np.where(moving, np.abs(free.positions.scale), 0.0)
    least = np.full(triangles.shape[1], np.inf)
    for signs in itertools.product((-1.0, 1.0), repeat=6):
        corner = np.reshape(signs, (2, 3, 1))
        local = free.positions.offset[:, triangles] + corner * reach[:, triangles]
        a, b, c = local[:, 0], local[:, 1], local[:, 2]
        least = np.minimum(least, 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])))
    return least
