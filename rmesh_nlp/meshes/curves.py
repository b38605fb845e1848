"""Curves that a mesh was made from, along which its boundary nodes slide.

A curve is a pair of functions ``x(t), y(t)`` of one parameter, twice differentiable: they enter the models
as CasADi Functions, so that derivatives of the positions are exact to second order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Array, is_finite, is_pair, kind_of, magnitude, slope_of
from rmesh_nlp.meshes.geometry import edges_on, lines_of
from rmesh_nlp.settings import Number
from rmesh_nlp.vectorised import Vectorised, is_vectorisable

SAMPLES = 4000
"""Points of a curve among which the nearest to a node is looked for, before Newton's method."""

Two = tuple[float, float]
"""A point, or the ends of an interval."""

Pair = tuple[ca.Function, ca.Function]


class Curve(ABC):
    """A curve ``t -> (x, y)``.

    Attributes
    ----------
    interval : (float, float)
        Parameters of its ends.
    closed : bool
        Whether it goes on at the first point after the last one.
    """

    interval: Two
    closed: bool

    @cached_property
    @abstractmethod
    def functions(self) -> Pair:
        """``t -> x`` and ``t -> y``."""

    @cached_property
    def _first(self) -> Pair:
        return _slopes(self.functions)

    @cached_property
    def _second(self) -> Pair:
        return _slopes(self._first)

    @cached_property
    def _sampled(self) -> tuple[Array, cKDTree]:
        samples = np.linspace(*self.interval, SAMPLES)
        return samples, cKDTree(self.at(samples).T)

    def at(self, t: Array) -> Array:
        """Points (2, n) at parameters (n,)."""
        return on_values(self.functions, t)

    def velocity(self, t: Array) -> Array:
        """Derivatives (2, n) by the parameter."""
        return on_values(self._first, t)

    def nearest(self, points: Array) -> Array:
        """Parameters (n,) of the points of the curve nearest to ``points`` (2, n)."""
        (low, high), (samples, tree) = self.interval, self._sampled
        t = samples[tree.query(points.T)[1]]
        step = (high - low) / SAMPLES
        for _ in range(20):
            off = self.at(t) - points
            velocity = self.velocity(t)
            slope, square = np.sum(off * velocity, axis=0), np.sum(velocity**2, axis=0)
            curvature = square + np.sum(off * on_values(self._second, t), axis=0)
            move = -slope / np.where(curvature > 0.1 * square, curvature, square)
            move = np.clip(move, -step, step)
            t = t + move if self.closed else np.clip(t + move, low, high)
            if magnitude(move) < 1e-15 * (high - low):
                break
        return t

    def near(self, points: Array, t: Array) -> Array:
        """Parameters of the nearest points, without a jump of whole turns from ``t``."""
        parameters = self.nearest(points)
        if self.closed:
            period = self.interval[1] - self.interval[0]
            parameters = parameters - period * np.round((parameters - t) / period)
        return parameters


def on_values(functions: tuple[ca.Function, ...], t: Array) -> Array:
    """Values (functions, n) of scalar Functions of a scalar."""
    function = _joined(functions)
    if t.size == 0 or is_vectorisable(function):  # ten to a hundred times faster
        return Vectorised(function, t.size)([t.reshape(1, -1)])[0]
    return function(ca.DM(t).T).full().reshape(len(functions), -1)


@lru_cache(maxsize=256)
def _joined(functions: tuple[ca.Function, ...]) -> ca.Function:
    """Once looked up for all; the derivative of a constant has no entry of its own."""
    t = kind_of(*functions).sym("t")
    return ca.Function("joined", [t], [ca.densify(ca.vertcat(*[function(t) for function in functions]))])


def _slopes(functions: Pair) -> Pair:
    return slope_of(functions[0]), slope_of(functions[1])


@dataclass(frozen=True)
class Circle(Curve):
    """A circle; the parameter is the angle."""

    centre: Two
    radius: float

    def __post_init__(self) -> None:
        require(is_pair(self.centre), "centre", "be two finite numbers", self.centre)
        Number().check("radius", self.radius)

    interval = (-np.pi, np.pi)
    closed = True

    @cached_property
    def functions(self) -> Pair:  # noqa: D102
        t = ca.SX.sym("t")
        (x, y), r = self.centre, self.radius
        return ca.Function("x", [t], [x + r * ca.cos(t)]), ca.Function("y", [t], [y + r * ca.sin(t)])

    def nearest(self, points: Array) -> Array:  # noqa: D102
        return np.arctan2(points[1] - self.centre[1], points[0] - self.centre[0])


@dataclass(frozen=True)
class Spline(Curve):
    """The cubic spline through given points; the parameter is nearly its arc length.

    Attributes
    ----------
    points : tuple of (float, float)
        At least four, in order. The first is not repeated at the end of a closed spline.
    closed : bool
        Whether it ends where it begins.
    """

    points: tuple[Two, ...]
    closed: bool = False

    def __post_init__(self) -> None:
        if not is_finite(self.points) or np.shape(self.points)[1:] != (2,) or len(self.points) < 4:
            raise BadInputError("a spline needs four or more points of two finite numbers each", "points")
        if not np.all(np.any(np.diff(self._through, axis=0) != 0, axis=1)):
            raise BadInputError("two points of a spline that follow each other are the same")

    @property
    def _through(self) -> Array:
        p = np.asarray(self.points, dtype=float)
        return np.vstack([p, p[:1]]) if self.closed else p

    @cached_property
    def interval(self) -> Two:  # type: ignore[override]
        """Parameters of its ends."""
        return float(self._knots[0]), float(self._knots[-1])

    @cached_property
    def _knots(self) -> Array:
        """Parameters of the points: lengths of the spline between them, found in a few rounds."""
        t = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self._through, axis=0), axis=1)))
        for _ in range(3):
            fine = np.append(np.linspace(t[:-1], t[1:], 20, endpoint=False, axis=1), t[-1])
            length = np.linalg.norm(np.diff(self._spline(t, self._through)(fine), axis=0), axis=1)
            t = np.append(0.0, np.cumsum(length.reshape(-1, 20).sum(axis=1)))
        return t

    def _spline(self, t: Array, p: Array) -> BSpline:
        return make_interp_spline(t, p, k=3, bc_type="periodic" if self.closed else "natural")

    @cached_property
    def functions(self) -> Pair:  # noqa: D102
        spline, t, (low, high) = self._spline(self._knots, self._through), ca.MX.sym("t"), self.interval
        # a node may slide across the place where a closed spline begins
        s = t - (high - low) * ca.floor((t - low) / (high - low)) if self.closed else t
        knots = [spline.t.tolist()]
        x, y = (ca.bspline(s, column.tolist(), knots, [3], 1) for column in spline.c.T)
        return ca.Function("x", [t], [x]), ca.Function("y", [t], [y])


@dataclass(frozen=True)
class Parametrised(Curve):
    """A curve by two functions of a parameter, made of CasADi or numpy operations on it.

    Attributes
    ----------
    x, y : functions of t
        Twice differentiable.
    interval : (float, float)
        Ends of t.
    closed : bool
        Whether it ends where it begins.
    """

    x: Callable[[Any], Any]
    y: Callable[[Any], Any]
    interval: Two
    closed: bool = False

    def __post_init__(self) -> None:
        for name, function in (("x", self.x), ("y", self.y)):
            require(callable(function), name, "be a function of t", function)
        if not (is_pair(self.interval) and np.diff(self.interval) > 0):
            raise BadInputError(
                f"the interval of a curve must increase and be finite, got {self.interval}", "interval"
            )
        low, high = self.interval
        points = self.at(np.linspace(low, high, 50))
        if not is_finite(points):
            raise BadInputError("a curve must be finite over its interval")
        ends = points[:, [0, -1]]
        if self.closed and magnitude(ends[:, 0] - ends[:, 1]) > 1e-9 * np.max(np.abs(ends) + 1e-300):
            raise BadInputError("a closed curve must end where it begins")

    @cached_property
    def functions(self) -> Pair:  # noqa: D102
        t = ca.SX.sym("t")
        return ca.Function("x", [t], [self.x(t)]), ca.Function("y", [t], [self.y(t)])


def fitted_circle(points: Array) -> Circle:
    """The circle through ``points`` (2, n) in the least-squares sense (I. Kasa, IEEE Trans. Instrum. Meas.
    25 (1976) 8-14).
    """  # noqa: D205
    if points.shape[1] < 3:
        raise BadInputError(f"a circle cannot be fitted to {points.shape[1]} nodes")
    middle = points.mean(axis=1)
    x, y = points - middle[:, None]
    matrix = np.column_stack([2 * x, 2 * y, np.ones(x.size)])
    (a, b, c), _, rank, _ = np.linalg.lstsq(matrix, x**2 + y**2, rcond=1e-10)
    if rank < 3:
        raise BadInputError("a circle cannot be fitted to nodes on a straight line")
    return Circle((float(middle[0] + a), float(middle[1] + b)), float(np.sqrt(c + a**2 + b**2)))


def spline_through(points: Array, edges: NDArray) -> Spline:
    """The spline through the nodes of a boundary, its edges (2, edges) between columns of ``points``."""
    line, *others = lines_of(edges, points)
    if others or np.max(np.bincount(edges.ravel())) > 2:
        raise BadInputError("a spline needs a boundary of one piece without branches")
    closed = bool(line[0] == line[-1])
    return Spline(tuple((float(a), float(b)) for a, b in points[:, line[: line.size - closed]].T), closed)


FITTED = ("circle", "spline")
"""Kinds of curves that are fitted to nodes."""


def fitted(mesh: MeshTri, name: str, kind: str) -> Curve:
    """The circle or the spline through the nodes of a named boundary; a ValueError if there is none."""
    edges = edges_on(mesh, name)
    return fitted_circle(mesh.p[:, np.unique(edges)]) if kind == "circle" else spline_through(mesh.p, edges)
