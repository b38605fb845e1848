"""Contact sets: a boundary over a rigid foundation or another boundary, or an obstacle below a membrane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import casadi as ca
import numpy as np

from rmesh_nlp.display import describe, figure
from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Array, Expression, is_finite, is_pair
from rmesh_nlp.problem.coefficients import (
    OPEN,
    POSITION,
    Coefficient,
    Parameter,
    PiecewiseLinear,
    PositionFunction,
    at,
    convert,
    each,
    evaluated,
    is_number,
    numeric,
    on_points,
)
from rmesh_nlp.problem.friction import Friction
from rmesh_nlp.problem.surfaces import Centre, Vector, above, gradient, minus, off_circle, off_line, unit
from rmesh_nlp.settings import check_positive

MOVES = ("x", "y", "xy")
"""Coordinates along which a tool may move."""

BEHIND = "'s other side"
"""What follows the name of an interface in that of its second boundary."""

GAPS = ("node", "edge")
"""Where gaps hold: at contact nodes, or along their edges."""


class Place(Enum):
    """Where contact may happen when it is not on a named boundary."""

    INTERIOR = "interior"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Obstacle:
    """Unilateral contact, with or without friction.

    The gap of a contact node at X with displacement u is ``normal . u + offset(X) >= 0``.
    (3.1): normal (1,), offset 0. (3.10): normal (0, 1), offset alpha(x_1). Contact is
    geometrically linear: the gap is measured along ``normal`` at the place where the node is
    before the displacement.

    A foundation with a ``level`` function phi, positive where the body may be, has a normal of its own
    at every place: the gap is the linearisation of ``phi(X + u) >= 0`` at the undeformed node,
    ``(phi(X) + grad phi(X) . u) / |grad phi(X)|``, a distance along the curve's normal there. Friction acts
    along the curve's tangent at the same place, so that slip, too, is linear in the displacement.

    Parameters
    ----------
    boundary : str or Place
        Name of the contact boundary; ``Place.INTERIOR`` for all nodes of a scalar problem.
    normal : tuple of float
        Unit vector, one number for a scalar problem; (0, 1) by default. It points from the foundation to the
        body. Not used with a ``level`` function.
    offset : float or function of position
        Initial distance to the foundation, in units of length; 0 by default. With a ``level`` function it
        adds to the distance to the curve.
    friction : float or function of position
        Tresca bound g >= 0 in units of stress; 0, the default, without friction. It acts along the tangent,
        the normal turned by -90 degrees.
    coulomb : float or function of position
        Coulomb's coefficient F >= 0, without unit: the bound is F times the contact pressure, in addition to
        g. With it there is no energy that the displacement minimises.
    kinks : tuple of float
        Values of x_1 where the offset has a kink, found for a :class:`PiecewiseLinear` one.
        Contact nodes there do not move: the gap is imposed at nodes, and beside its node a kink
        of the foundation would pass into the body.
    level : function of position, optional
        phi, smooth and with a gradient that is not zero near the contact boundary.
    gap : str
        "node", the default: it holds at contact nodes; a convex foundation passes into the body between them.
        "edge": it holds along the edges as well, since the foundation counts as nearer at a node by twice
        the mean height of its arcs above their chords beside the node (:mod:`rmesh_nlp.fem.edge_gaps`).
        The two are the same where the foundation is straight.
    force : tuple of float, optional
        Of a tool: it moves as a whole until it presses on the body with this force, per unit of thickness or
        of a whole body of revolution.
    move : "x", "y" or "xy", optional
        Along which coordinates a force moves it; by default those along which the force acts.
    displacement : tuple of float, optional
        Given displacement of the foundation, in units of length, in the place of a force.
    other : str
        The boundary that is met in the place of a rigid foundation, see :meth:`pair`; none by default.
    """

    boundary: str | Place
    normal: tuple[float, ...] = (0.0, 1.0)
    offset: Coefficient = 0.0
    friction: Coefficient = 0.0
    kinks: tuple[float, ...] = ()
    level: PositionFunction | None = None
    gap: str = "node"
    coulomb: Coefficient = 0.0
    force: tuple[float, ...] | None = None
    move: str | None = None
    displacement: tuple[float, ...] | None = None
    other: str = ""

    def __post_init__(self) -> None:
        convert(self)
        if isinstance(self.offset, PiecewiseLinear) and not self.kinks:
            object.__setattr__(self, "kinks", self.offset.kinks)
        length = np.linalg.norm(self.normal) if is_finite(self.normal) else np.nan
        if not abs(length - 1) <= 1e-12:
            raise BadInputError(f"the contact normal {self.normal} has length {length}, not 1", "normal")
        if self.friction_law and (len(self.normal) == 1 or self.boundary is Place.INTERIOR):
            raise BadInputError("friction needs a problem with two displacement components", "friction")
        require(self.gap in GAPS, "gap", f"be {' or '.join(map(repr, GAPS))}", self.gap)
        self._check_tool()

    def _check_tool(self) -> None:
        for name in ("force", "displacement"):
            if (given := getattr(self, name)) is None:
                continue
            require(is_pair(given), name, "be two finite numbers", given)
            if len(self.normal) == 1 or self.boundary is Place.INTERIOR:
                raise BadInputError("a tool needs a problem with two displacement components", name)
            if self.other:
                raise BadInputError("two bodies that touch are no tool: load one of them", name)
        if self.force is None:
            require(self.move is None, "move", "come with a force", self.move)
            return
        require(self.displacement is None, "displacement", "not come with a force", self.displacement)
        along = "".join(axis for axis, part in zip("xy", self.force, strict=True) if part)
        object.__setattr__(self, "move", (along or "xy") if self.move is None else self.move)
        require(self.move in MOVES, "move", f"be {', '.join(map(repr, MOVES))}", self.move)
        must = f"act along {' or '.join(self.move or '')}, along which the tool moves, and not across"
        require(along != "" and set(along) <= set(self.move or ""), "force", must, self.force)

    @classmethod
    def line(
        cls,
        boundary: str,
        point: Centre,
        normal: Vector,
        friction: Coefficient = 0.0,
        coulomb: Coefficient = 0.0,
    ) -> Obstacle:
        """A rigid straight line, with the gap ``normal^T (X + u - point)``.

        Parameters
        ----------
        boundary : str
            Name of the contact boundary.
        point : tuple of float
            Any point of the line, in units of length.
        normal : tuple of float
            Direction from the line to the body, of any length but zero.
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        n, place = unit(normal), each("point", point)
        require(len(place) == 2, "point", "have 2 components", point)
        return cls(boundary, n, partial(off_line, n, place), friction=friction, coulomb=coulomb)

    @classmethod
    def graph(
        cls, boundary: str, height: Coefficient, friction: Coefficient = 0.0, coulomb: Coefficient = 0.0
    ) -> Obstacle:
        """A foundation below the graph ``y = height(x)``, gap measured vertically.

        The gap ``X_2 + u_2 - height(X_1)`` is that of (3.10) with alpha = X_2 - height.

        Parameters
        ----------
        boundary : str
            Name of the contact boundary.
        height : float or function of position
            Height of the foundation, in units of length: smooth, or a :class:`PiecewiseLinear`; called as
            height(x, y).
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        kinks = height.kinks if isinstance(height, PiecewiseLinear) else ()
        return cls(boundary, (0.0, 1.0), partial(above, height), friction, kinks, coulomb=coulomb)

    @classmethod
    def curve(
        cls,
        boundary: str,
        level: PositionFunction,
        friction: Coefficient = 0.0,
        coulomb: Coefficient = 0.0,
    ) -> Obstacle:
        """A foundation bounded by the curve ``level(x, y) = 0``, with ``level > 0`` where the body may be.

        The gap is measured along the curve's normal at the undeformed node, the slip along its tangent
        there, both linearly in the displacement.

        Parameters
        ----------
        boundary : str
            Name of the contact boundary.
        level : function of position
            Smooth, with a gradient that is not zero near the boundary. Its scale does not matter to first
            order.
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        require(callable(level), "curve", "be an expression of x and y that is zero on it", level)
        return cls(boundary, friction=friction, level=level, coulomb=coulomb)

    @classmethod
    def circle(
        cls,
        boundary: str,
        centre: Centre,
        radius: Parameter,
        *,
        inside: bool = False,
        friction: Coefficient = 0.0,
        coulomb: Coefficient = 0.0,
    ) -> Obstacle:
        """A rigid disc that the body touches from outside, or a round hole with the body ``inside``.

        The gap at zero displacement is the distance to the circle, the normal that at the
        undeformed node; both are exact, the dependence on the displacement is linear.

        Parameters
        ----------
        boundary : str
            Name of the contact boundary.
        centre : tuple of float
            Centre of the circle, in units of length.
        radius : float
            Its radius, positive, in units of length.
        inside : bool
            Whether the body is inside the circle; outside by default.
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        radius = numeric("radius", radius)
        if is_number(radius):
            check_positive(radius=radius)
        pair = each("centre", centre)
        is_place = len(pair) == 2 and is_finite([*filter(is_number, pair)])
        require(is_place, "centre", "be two finite numbers", centre)
        sign = -1.0 if inside else 1.0
        return cls.curve(boundary, partial(off_circle, pair, radius, sign), friction, coulomb)

    @classmethod
    def pair(
        cls,
        first: str,
        second: str,
        interference: Coefficient = 0.0,
        friction: Coefficient = 0.0,
        coulomb: Coefficient = 0.0,
    ) -> Obstacle:
        """Two boundaries with nodes at the same places, of two bodies or of one.

        The gap is ``normal^T (u_first - u_second) - interference``, the normal from the second boundary to
        the first, of a straight line or of a circle among the curves of the motion. Relocation moves both
        nodes of a pair alike.

        Parameters
        ----------
        first, second : str
            Names of the two boundaries; results have the name of the first.
        interference : float or function of position
            How far the bodies overlap before any load, in units of length; a negative one is a gap.
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        gap = numeric("interference", interference)
        gap = partial(minus, gap) if callable(gap) else 0.0 - gap
        return cls(first, offset=gap, friction=friction, coulomb=coulomb, other=second)

    @classmethod
    def interface(
        cls,
        name: str,
        interference: Coefficient = 0.0,
        friction: Coefficient = 0.0,
        coulomb: Coefficient = 0.0,
    ) -> Obstacle:
        """A named line inside the mesh that may open, with two nodes in the place of each.

        Its ends inside the body stay closed, those on the boundary open. The first side of the pair that it
        becomes is the upper one, the right one of a vertical line, and the outer one of a circle.

        Parameters
        ----------
        name : str
            Name of the line, and of its first side in results.
        interference : float or function of position
            How far the two sides overlap before any load, in units of length; a negative one is a gap.
        friction : float or function of position
            Tresca's bound, in units of stress; 0 by default.
        coulomb : float or function of position
            Coulomb's coefficient, without unit; 0 by default.
        """
        return cls.pair(name, name, interference, friction, coulomb)

    @classmethod
    def interior(cls, psi: Coefficient) -> Obstacle:
        """The scalar obstacle problem ``u >= psi`` in the whole domain, imposed at the nodes.

        Parameters
        ----------
        psi : float or function of position
            Height of the obstacle, in the unit of the displacement.
        """
        return cls(Place.INTERIOR, (1.0,), partial(minus, psi))

    @property
    def place(self) -> str:
        """The name of its boundary or interface, or both names of a pair."""
        name = str(self.boundary)
        return name if self.other in ("", name, name + BEHIND) else f"{name} and {self.other}"

    def in_words(self) -> str:
        """Where contact is, along which normal and with which friction."""
        where = "in the interior" if self.boundary is Place.INTERIOR else f"on {self.place}"
        normal = f"normal ({', '.join(figure(v) for v in self.normal)})"
        if self.level is not None:
            normal = "the normal of the curve at each undeformed node"
        gap = [f"gap {describe(self.offset)}"] if self.other else []
        motions = ("pressed by", self.force), ("moved by", self.displacement)
        tool = [f"{how} ({', '.join(map(figure, vector))})" for how, vector in motions if vector]
        return ", ".join([f"{where}, {normal}, {self.friction_law.in_words()}", *gap, *tool])

    def direction(self, x: Expression, y: Expression) -> Expression:
        """Unit normal at a point as a CasADi column."""
        if self.level is None:
            return ca.DM(self.normal)
        slope = gradient(self.level)(x, y)
        return slope / ca.norm_2(slope)

    def tangential(self, x: Expression, y: Expression) -> Expression:
        """Unit tangent at a point as a CasADi column, the normal turned by -90 degrees."""
        normal = self.direction(x, y)
        return ca.vertcat(normal[1], -normal[0])

    def distance(self, x: Expression, y: Expression) -> Expression:
        """The gap without displacement of the body at a point."""
        gap = at(self.offset, x, y)
        if self.level is not None and not self.other:
            # off a circle it is a distance already
            is_circle = isinstance(self.level, partial) and self.level.func is off_circle
            gap += at(self.level, x, y) / (1 if is_circle else ca.norm_2(gradient(self.level)(x, y)))
        if self.displacement is None:
            return gap
        return gap - ca.dot(self.direction(x, y), ca.DM(self.displacement))

    @property
    def surface(self) -> tuple[object, ...]:
        """Equal for obstacles of one foundation with one friction law; that of a tool is its own."""
        x, y = POSITION
        parts = (at(each, x, y) for each in (self.clearance, self.friction, self.coulomb))
        graph = ca.Function("surface", [x, y], [self.direction(x, y), *parts], OPEN).serialize()
        return graph, self.gap, self.other, self.force and self.boundary

    @property
    def unmoved(self) -> tuple[Obstacle, ca.DM]:
        """The foundation without its displacement, and that."""
        if self.displacement is None:
            return self, ca.DM.zeros(len(self.normal))
        return replace(self, displacement=None), ca.DM(self.displacement)

    @property
    def clearance(self) -> Coefficient:
        """The gap without displacement, as a coefficient."""
        if self.level is None and self.displacement is None:
            return self.offset
        if self.level is None and is_number(self.offset):
            return float(self.offset - np.dot(self.normal, self.displacement or 0.0))
        return self.distance

    def normals(self, points: Array) -> Array:
        """Unit normals (components, ...) at ``points`` (2, ...)."""
        if self.level is None:
            return np.multiply.outer(np.array(self.normal), np.ones(points.shape[1:]))
        slope = evaluated(gradient(self.level), points)
        return slope / np.linalg.norm(slope, axis=0)

    def distances(self, points: Array) -> Array:
        """Gaps (...) without displacement at ``points`` (2, ...), all finite or a ValueError."""
        return on_points(self.clearance, points, "the obstacle")

    def feet(self, points: Array) -> Array:
        """Points (2, points) of the foundation that ``points`` would meet, for pictures.

        Along the contact normal; on a curve as far as its level function says.
        """
        feet = points - self.normals(points) * self.distances(points)
        for _ in range(FOOT_STEPS if self.level is not None and not self.other else 0):
            feet = feet - self.normals(feet) * self.distances(feet)
        return feet

    @property
    def moves(self) -> tuple[bool, ...]:
        """Per displacement component whether a force may move the foundation."""
        return tuple(axis in (self.move or "") for axis in "xy"[: len(self.normal)])

    @property
    def friction_law(self) -> Friction:
        """Both bounds of friction as one law."""
        return Friction(self.friction, self.coulomb)


FOOT_STEPS = 5
"""Newton steps from a node to a curved foundation."""


NO_CONTACT: tuple[Obstacle, ...] = ()
"""A problem without contact."""
