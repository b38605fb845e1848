"""Outer variables q -> node positions X(q): which nodes move, in which direction, and how far."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT, STRAIGHT, Bends, Field, constant_field, unknown_field
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.lines import on_curve, parameters_of, sliding_directions
from rmesh_nlp.problem.motion import Relative


class Mobility(IntEnum):
    """How a node may move."""

    PINNED = 0
    SLIDING = 1
    FREE = 2
    TIED = 3


@dataclass(frozen=True)
class MeshMap:
    """Node positions and parameters as functions of the outer variables q.

    X = X0 + P q, and X = c(t0 + q) along curves. q is measured in units of the node's own move limits, so
    that -1 <= q <= 1; without them in units of the shortest edge at the node, unbounded. Along a curve the
    limit is a length of the curve.

    Attributes
    ----------
    mobility : (nodes,) array of Mobility
    positions : Field
        (2, nodes), the positions as a function of q.
    n : int
        Length of q.
    bound : (n,) array
        ``-bound <= q <= bound``; 1, or infinity without move limits.
    curves : tuple of Curve
        Curve number k owns the functions 2 k (x) and 2 k + 1 (y) of ``positions.bends``.
    """

    mobility: NDArray[np.int64]
    positions: Field
    n: int
    bound: Array
    curves: tuple[Curve, ...] = ()

    @property
    def parameters(self) -> Field:
        """(1, n_p) parameters p(q) of loads, moduli and shapes: none yet."""
        return constant_field(np.zeros((1, 0)))

    def q_of(self, nodes: Array) -> Array:
        """The unknowns q that give these positions (2, nodes), in the least-squares sense."""
        index, scale = self.positions.index, self.positions.scale
        moving = index != CONSTANT
        affine = np.array(nodes, dtype=float)
        if self.positions.bends is not None:  # there it is the parameter of the curve that is affine in q
            for number, curve in enumerate(self.curves):
                here = self.positions.bends.which[0] == 2 * number
                affine[:, here] = curve.near(affine[:, here], self.positions.offset[0, here])
        shift = (affine - self.positions.offset)[moving] * scale[moving]
        weight = scale[moving] ** 2
        q = np.bincount(index[moving], shift, self.n) / np.bincount(index[moving], weight, self.n)
        return np.asarray(q)

    @staticmethod
    def of(problem: ContactProblem) -> MeshMap:
        """Classify every node and number its outer variables.

        Raises
        ------
        ValueError
            If a rule of the motion cannot be obeyed: a node is to slide where its piece is not
            straight, or is tied to a node that is tied itself or cannot follow it.
        """
        mesh, unit = problem.mesh, _units(problem)
        mobility, tangent = _mobility(problem)
        index, scale = np.full(mesh.p.shape, CONSTANT), np.ones(mesh.p.shape)
        count = np.where(mobility == Mobility.FREE, 2, np.where(mobility == Mobility.SLIDING, 1, 0))
        first = np.concatenate([[0], np.cumsum(count)])
        free, sliding = mobility == Mobility.FREE, mobility == Mobility.SLIDING
        index[:, free] = first[:-1][free] + np.array([[0], [1]])
        scale[:, free] = unit[:, free]
        with np.errstate(divide="ignore"):
            reach = np.min(unit[:, sliding] / np.abs(tangent[:, sliding]), axis=0)
        step = reach * tangent[:, sliding]
        index[:, sliding] = np.where(step != 0, first[:-1][sliding], CONSTANT)
        scale[:, sliding] = np.where(step != 0, step, 1.0)
        offset, which = np.array(mesh.p, dtype=float), np.full(mesh.p.shape, STRAIGHT)
        curves = tuple(problem.motion.curves.values())
        along = np.where(sliding, on_curve(problem), -1)
        for number, curve in enumerate(curves):
            here = np.flatnonzero(along == number)
            t, speed = parameters_of(curve, mesh.p[:, here])
            index[:, here], offset[:, here] = first[:-1][here], t
            scale[:, here] = np.min(unit[:, here], axis=0) / speed
            which[:, here] = np.array([[2 * number], [2 * number + 1]])
        for node, leader in problem.motion.tied:
            index[:, node], scale[:, node] = index[:, leader], scale[:, leader]
        bound = np.full(int(first[-1]), np.inf if problem.motion.delta is None else 1.0)
        bends = Bends(which, tuple(f for curve in curves for f in curve.functions)) if curves else None
        positions = Field(index, scale, offset, bends=bends, along=_along(problem, along, index, scale))
        return MeshMap(mobility, positions, int(first[-1]), bound, curves)


class VertexParameters:
    """Vertex positions as parameters of a function, and with them where on the curves the vertices are.

    Attributes
    ----------
    positions : Field
        (2, vertices), of the parameters.
    symbol : MX symbol
        The parameters.
    """

    def __init__(self, problem: ContactProblem) -> None:
        n = problem.mesh.p.shape[1]
        self._curves = [
            (curve, problem.boundary_nodes((name,))) for name, curve in problem.motion.curves.items()
        ]
        positions = unknown_field((2, n), parameter=True)
        along = unknown_field((len(self._curves), n), 2 * n, parameter=True) if self._curves else None
        self.positions = replace(positions, along=along)
        self.symbol = ca.MX.sym("X", (2 + len(self._curves)) * n)

    def values(self, nodes: Array) -> Array:
        """The parameters at vertex positions (2, vertices)."""
        along = np.zeros((len(self._curves), nodes.shape[1]))
        for row, (curve, here) in zip(along, self._curves, strict=True):
            row[here] = curve.nearest(nodes[:, here])
        return np.concatenate([nodes.ravel(order="F"), along.ravel(order="F")])


def _along(problem: ContactProblem, slides: NDArray, index: NDArray, scale: Array) -> Field | None:
    """Parameters (curves, nodes) of the nodes on each curve, also of its ends, which do not slide."""
    curves = problem.motion.curves
    if not curves:
        return None
    found = constant_field(np.zeros((len(curves), index.shape[1])))
    for number, (name, curve) in enumerate(curves.items()):
        nodes = problem.boundary_nodes((name,))
        found.offset[number, nodes] = curve.nearest(problem.mesh.p[:, nodes])
        here = nodes[slides[nodes] == number]
        found.index[number, here], found.scale[number, here] = index[0, here], scale[0, here]
    return found


def _mobility(problem: ContactProblem) -> tuple[NDArray[np.int64], Array]:
    """Mobility of every node and unit tangent (2, nodes) of those that may slide."""
    mesh, motion = problem.mesh, problem.motion
    on_line, tangent = sliding_directions(problem)
    any_tangent = sliding_directions(problem, geometry_only=True)[1]
    along = on_curve(problem)
    for number, curve in enumerate(problem.motion.curves.values()):
        nodes = np.flatnonzero(along == number)
        velocity = curve.velocity(curve.nearest(mesh.p[:, nodes]))
        tangent[:, nodes] = any_tangent[:, nodes] = velocity / np.linalg.norm(velocity, axis=0)
    mobility = np.full(mesh.p.shape[1], int(Mobility.FREE))
    mobility[on_line] = Mobility.PINNED
    mobility[np.any(tangent != 0, axis=0)] = Mobility.SLIDING
    varying = [d.boundary for d in problem.supports if any(callable(value) for value in d.value)]
    mobility[problem.boundary_nodes(tuple(varying))] = Mobility.PINNED
    mobility[np.setdiff1d(np.arange(mobility.size), mesh.t)] = Mobility.PINNED
    for part in problem.contact_sets:
        at_kink = np.isclose(mesh.p[0, part.nodes, None], np.array(part.obstacle.kinks)).any(axis=1)
        mobility[part.nodes[at_kink]] = Mobility.PINNED
    loaded = [load.node for load in problem.point_loads]
    mobility[loaded] = Mobility.PINNED
    rules = (
        (motion.free, Mobility.FREE),
        (motion.slides, Mobility.SLIDING),
        (motion.pinned, Mobility.PINNED),
    )
    for kind in (str, int):
        for places, mobile in rules:
            for place in places:
                if isinstance(place, kind):
                    at = problem.boundary_nodes((place,)) if isinstance(place, str) else np.array([place])
                    mobility[at] = mobile
    _check_still(problem, mobility, problem.boundary_nodes(tuple(varying)), "held at a function of position")
    _check_still(problem, mobility, np.array(loaded, dtype=np.int64), "under a point load")
    forced = (mobility == Mobility.SLIDING) & ~np.any(tangent != 0, axis=0)
    lost = np.flatnonzero(forced & ~np.any(any_tangent != 0, axis=0))
    if lost.size:
        node = int(lost[0])
        x, y = mesh.p[:, node]
        raise ValueError(
            f"node {node} at ({x:.6g}, {y:.6g}) is to slide, but it is on no straight piece of boundary "
            "or interface, and on no curve that is given"
        )
    tangent = np.where(forced, any_tangent, tangent)
    for node, leader in motion.tied:
        _check_tie(problem, mobility, tangent, along, node, leader)
    for node, _ in motion.tied:
        mobility[node] = Mobility.TIED
    return mobility, tangent


def _check_still(problem: ContactProblem, mobility: NDArray, nodes: NDArray, what: str) -> None:
    """No rule may move a node whose given value or load would not follow, or would go along."""
    tied = {node for node, _ in problem.motion.tied}
    moved = [int(node) for node in nodes if mobility[node] != Mobility.PINNED or int(node) in tied]
    if moved:
        raise ValueError(f"node {moved[0]} is {what} and cannot move")


def _check_tie(
    problem: ContactProblem, mobility: NDArray, tangent: Array, along: NDArray, node: int, leader: int
) -> None:
    """A tied node must be able to follow its leader, whose way is straight."""
    if node == leader or leader in {n for n, _ in problem.motion.tied}:
        raise ValueError(f"node {node} cannot be tied to node {leader}, which is tied itself")
    if mobility[leader] == Mobility.PINNED or mobility[node] == Mobility.FREE:
        return
    one, two = tangent[:, node], tangent[:, leader]
    parallel = mobility[node] == mobility[leader] == Mobility.SLIDING and along[leader] < 0
    if not (parallel and abs(one[0] * two[1] - one[1] * two[0]) < 1e-8):
        raise ValueError(
            f"node {node} cannot be tied to node {leader}: it cannot make the moves of that node"
        )


def _units(problem: ContactProblem) -> Array:
    """Move limits (2, nodes) in x and y, or the shortest edge at each node where there are none."""
    delta, mesh = problem.motion.delta, problem.mesh
    if delta is not None and not isinstance(delta, Relative):
        return np.broadcast_to(np.asarray(delta, dtype=float)[:, None], mesh.p.shape)
    a, b = mesh.facets
    length = np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0)
    shortest = np.full(mesh.p.shape[1], np.inf)
    np.minimum.at(shortest, a, length)
    np.minimum.at(shortest, b, length)
    fraction = delta.fraction if isinstance(delta, Relative) else 1.0
    return np.vstack([fraction * shortest] * 2)
