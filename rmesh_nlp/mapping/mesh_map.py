"""Outer variables q -> node positions X(q) and design variables: what varies, and how far."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Index, cross
from rmesh_nlp.fem.fields import NONE, Bends, Design, Field, Modes, unknown_field
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, lengths
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.lines import on_curve, sliding_directions
from rmesh_nlp.problem.motion import Relative


class Mobility(IntEnum):
    """How a node may move."""

    PINNED = 0
    SLIDING = 1
    FREE = 2
    TIED = 3


@dataclass(frozen=True)
class MeshMap:
    """Node positions and design variables as functions of the outer variables q.

    X = X0 + P q, and X = c(t0 + q) along curves. q is measured in units of the node's own move limits, so
    that -1 <= q <= 1; without them in units of the shortest edge at the node, unbounded. Along a curve the
    limit is a length of the curve.

    Design variables follow the positions in q, each from its start in units of half the width of its bounds.
    Shapes add their motions to all positions. At q = 0 are the mesh as given and the first design.

    Attributes
    ----------
    mobility : (nodes,) array of Mobility
    positions : Field
        (2, nodes), the positions as a function of q; ``positions.design`` has the design variables.
    n : int
        Length of q.
    lower, upper : (n,) arrays
        ``lower <= q <= upper``; of positions -1 and 1, or infinite without move limits.
    curves : tuple of Curve
        Curve number k owns the functions 2 k (x) and 2 k + 1 (y) of ``positions.bends``.
    """

    mobility: Index
    positions: Field
    n: int
    lower: Array
    upper: Array
    curves: tuple[Curve, ...] = ()

    @property
    def n_positions(self) -> int:
        """How many of the outer variables are those of positions; the others are design variables."""
        return self.n - (0 if self.positions.design is None else len(self.positions.design.names))

    def design(self, q: Array) -> Array:
        """(design variables,) their values."""
        design = self.positions.design
        return np.zeros(0) if design is None else design.values.values(q)[0]

    def clipped(self, q: Array) -> Array:
        """The nearest outer variables within their limits."""
        return np.clip(q, self.lower, self.upper)

    def q_of(self, nodes: Array, design: Array | None = None) -> Array:
        """The unknowns q that give these positions (2, nodes), in the least-squares sense.

        ``design`` (design variables,) are those of the first design by default.
        """
        index, scale = self.positions.index, self.positions.scale
        moving, affine, result = index != NONE, np.array(nodes, dtype=float), np.zeros(self.n)
        if self.positions.design is not None and design is not None:
            values = self.positions.design.values
            result[values.index[0]] = (design - values.offset[0]) / values.scale[0]
        if self.positions.modes is not None:
            affine = affine - self.positions.modes.values(result)
        if self.positions.bends is not None:  # there it is the parameter of the curve that is affine in q
            for number, curve in enumerate(self.curves):
                on_arc = self.positions.bends.which[0] == 2 * number
                affine[:, on_arc] = curve.near(affine[:, on_arc], self.positions.offset[0, on_arc])
        shift = (affine - self.positions.offset)[moving] * scale[moving]
        n = self.n_positions
        result[:n] = np.bincount(index[moving], shift, n) / np.bincount(index[moving], scale[moving] ** 2, n)
        return result

    @staticmethod
    def of(problem: ContactProblem) -> MeshMap:
        """Classify every node and number its outer variables.

        Raises
        ------
        ValueError
            If a rule of the motion cannot be obeyed: a node is to slide where its piece is not
            straight, or is tied to a node that is tied itself or cannot follow it.
        """
        mesh, unit, curves = problem.mesh, _units(problem), tuple(problem.motion.curves.values())
        along = on_curve(problem)
        mobility, tangent = _mobility(problem, along)
        free, sliding = mobility == Mobility.FREE, mobility == Mobility.SLIDING
        count = np.cumsum(2 * free + sliding)
        first, n = np.append(0, count[:-1]), int(count[-1])
        index, scale, offset = np.full(mesh.p.shape, NONE), np.ones(mesh.p.shape), np.array(mesh.p, float)
        index[:, free], scale[:, free] = first[free] + np.array([[0], [1]]), unit[:, free]
        with np.errstate(divide="ignore"):
            reach = np.min(unit[:, sliding] / np.abs(tangent[:, sliding]), axis=0)
        step = reach * tangent[:, sliding]
        index[:, sliding] = np.where(step != 0, first[sliding], NONE)
        scale[:, sliding] = np.where(step != 0, step, 1.0)
        which, shape = np.full(mesh.p.shape, NONE), (len(curves), mesh.p.shape[1])
        parameters = Field(np.full(shape, NONE), np.ones(shape), np.zeros(shape))
        for number, (name, curve) in enumerate(problem.motion.curves.items()):
            inner = np.flatnonzero(sliding & (along == number))
            t = curve.nearest(mesh.p[:, inner])
            index[:, inner], offset[:, inner] = first[inner], t
            scale[:, inner] = np.min(unit[:, inner], axis=0) / np.linalg.norm(curve.velocity(t), axis=0)
            which[:, inner] = np.array([[2 * number], [2 * number + 1]])
            nodes = problem.boundary_nodes(name)  # also the ends of the curve, which do not slide
            parameters.offset[number, nodes] = curve.nearest(mesh.p[:, nodes])
            parameters.index[number, inner] = index[0, inner]
            parameters.scale[number, inner] = scale[0, inner]
        for node, leader in problem.tied:
            index[:, node], scale[:, node] = index[:, leader], scale[:, leader]
            which[:, node] = which[:, leader]
            if which[0, leader] != NONE:  # of a pair on a circle, which is a curve of both boundaries
                offset[:, node] = offset[:, leader]
                parameters.index[along[node], node] = index[0, leader]
                parameters.scale[along[node], node] = scale[0, leader]
                parameters.offset[along[node], node] = offset[0, leader]
        positions = Field(index, scale, offset)
        if curves:
            bends = Bends(which, tuple(f for curve in curves for f in curve.functions))
            positions = replace(positions, bends=bends, along=parameters)
        limit = np.full(n, np.inf if problem.motion.delta is None else 1.0)
        if not problem.design:
            return MeshMap(mobility, positions, n, -limit, limit, curves)
        positions, lower, upper = _with_design(problem, positions, n)
        lower, upper = np.append(-limit, lower), np.append(limit, upper)
        return MeshMap(mobility, positions, lower.size, lower, upper, curves)


def _with_design(problem: ContactProblem, positions: Field, first: int) -> tuple[Field, Array, Array]:
    """Positions with the design variables, numbered from ``first``, and the limits of these."""
    start = np.array([variable.start for variable in problem.design])
    least, largest = np.array([variable.bounds for variable in problem.design]).T
    unit = (largest - least) / 2
    names, index = tuple(problem.start), first + np.arange(start.size)
    values = Field(index[None], unit[None], start[None])
    modes = None
    if problem.shapes:
        chosen = np.array([names.index(shape.name) for shape in problem.shapes])
        modes = Modes(values.elements(chosen), problem.shape_motions)
    positions = replace(positions, modes=modes, design=Design(names, values))
    return positions, (least - start) / unit, (largest - start) / unit


class VertexParameters:
    """Vertex positions and design variables as parameters ``symbol`` of a function.

    Also where on the curves the vertices are.
    """

    def __init__(self, problem: ContactProblem) -> None:
        n = problem.n_vertices
        self._curves = [
            (curve, problem.boundary_nodes(name)) for name, curve in problem.motion.curves.items()
        ]
        positions = unknown_field((2, n), source=1)
        along = unknown_field((len(self._curves), n), 2 * n, source=1) if self._curves else None
        first = (2 + len(self._curves)) * n
        self._start = np.array(list(problem.start.values()))
        values = unknown_field((1, self._start.size), first, source=1)
        design = Design(tuple(problem.start), values) if problem.design else None
        self.positions = replace(positions, along=along, design=design)
        self.symbol = ca.MX.sym("X", first + self._start.size)

    def values(self, nodes: Array, design: Array | None = None) -> Array:
        """The parameters at vertex positions (2, vertices) and a design, by default the first one."""
        along = np.zeros((len(self._curves), nodes.shape[1]))
        for row, (curve, members) in zip(along, self._curves, strict=True):
            row[members] = curve.nearest(nodes[:, members])
        parts = nodes.ravel(order="F"), along.ravel(order="F"), self._start if design is None else design
        return np.concatenate(parts)


def _mobility(problem: ContactProblem, along: NDArray) -> tuple[Index, Array]:
    """Mobility of every node and unit tangent (2, nodes) of those that may slide."""
    mesh, motion = problem.mesh, problem.motion
    on_line, tangent = sliding_directions(problem)
    any_tangent = sliding_directions(problem, geometry_only=True)[1]
    for number, curve in enumerate(motion.curves.values()):
        nodes = np.flatnonzero(along == number)
        velocity = curve.velocity(curve.nearest(mesh.p[:, nodes]))
        tangent[:, nodes] = any_tangent[:, nodes] = velocity / np.linalg.norm(velocity, axis=0)
    mobility = np.full(mesh.p.shape[1], int(Mobility.FREE))
    mobility[on_line] = Mobility.PINNED
    mobility[np.any(tangent != 0, axis=0)] = Mobility.SLIDING
    varying = [d.boundary for d in problem.supports if any(map(callable, d.value))]
    held = problem.boundary_nodes(*varying).tolist()
    loaded = [load.node for load in problem.point_loads]
    mobility[problem.kink_nodes] = Mobility.PINNED
    mobility[problem.boundary_nodes(*(shape.boundary for shape in problem.shapes))] = Mobility.PINNED
    mobility[[*held, *loaded, *np.setdiff1d(np.arange(mobility.size), mesh.t)]] = Mobility.PINNED
    rules = (motion.free, Mobility.FREE), (motion.slides, Mobility.SLIDING), (motion.pinned, Mobility.PINNED)
    for places, mobile in rules:
        names = (place for place in places if isinstance(place, str))
        mobility[problem.boundary_nodes(*names)] = mobile
    for places, mobile in rules:  # that for a node overrides those for its boundaries
        mobility[[place for place in places if isinstance(place, int)]] = mobile
    both = problem.matches  # what stops one node of a pair stops both
    mobility[both] = np.min(mobility[both], axis=0)
    tied, by_user = dict(problem.tied), dict(motion.tied)
    for still, what in ((held, "held at a function of position"), (loaded, "under a point load")):
        moved = [node for node in still if mobility[node] != Mobility.PINNED or node in by_user]
        if moved:  # its given value or load would not follow, or would go along
            raise BadInputError(f"node {moved[0]} is {what} and cannot move")
    mobility[problem.on_axis & (mobility == Mobility.FREE)] = Mobility.SLIDING
    forced = (mobility == Mobility.SLIDING) & ~np.any(tangent != 0, axis=0)
    lost = np.flatnonzero(forced & ~np.any(any_tangent != 0, axis=0))
    if lost.size:
        x, y = mesh.p[:, lost[0]]
        raise BadInputError(
            f"node {lost[0]} at ({x:.6g}, {y:.6g}) is to slide, but it is on no straight piece of boundary "
            "or interface, and on no curve that is given"
        )
    tangent = np.where(forced, any_tangent, tangent)
    for node, leader in motion.tied:
        if node == leader or leader in tied:
            raise BadInputError(f"node {node} cannot be tied to node {leader}, which is tied itself")
        if mobility[leader] != Mobility.PINNED and mobility[node] != Mobility.FREE:
            both_slide = mobility[node] == mobility[leader] == Mobility.SLIDING
            if not (
                both_slide
                and along[leader] < 0
                and abs(cross(tangent[:, node], tangent[:, leader])) < SEVEN_DIGITS
            ):
                raise BadInputError(
                    f"node {node} cannot be tied to node {leader}: it cannot make the moves of that node"
                )
    mobility[list(tied)] = Mobility.TIED
    if motion.is_fixed:
        mobility[:] = Mobility.PINNED
    return mobility, tangent


def _units(problem: ContactProblem) -> Array:
    """Move limits (2, nodes) in x and y, or the shortest edge at each node where there are none."""
    delta, mesh = problem.motion.delta, problem.mesh
    if delta is not None and not isinstance(delta, Relative) and not problem.motion.is_fixed:
        return np.broadcast_to(np.asarray(delta, dtype=float)[:, None], mesh.p.shape)
    a, b = mesh.facets
    length = lengths(mesh.p, mesh.facets)
    shortest = np.full(mesh.p.shape[1], np.inf)
    np.minimum.at(shortest, a, length)
    np.minimum.at(shortest, b, length)
    return np.vstack([(delta.fraction if isinstance(delta, Relative) else 1.0) * shortest] * 2)
