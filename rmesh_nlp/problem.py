"""What a user states: a frozen contact problem on a mesh whose nodes may move.

Functions of position (sources, tractions, obstacles, exact solutions) are written with
CasADi or numpy operations on ``x`` and ``y``; they are called with CasADi symbols, because
loads move with the nodes and must be differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

PositionFunction = Callable[[Any, Any], Any]
Coefficient = float | PositionFunction
"""A number, or a function of position (x, y)."""


def at(coefficient: Coefficient, x: Any, y: Any) -> Any:
    """Value of a coefficient at a point."""
    return coefficient(x, y) if callable(coefficient) else coefficient


@dataclass(frozen=True)
class Laplace:
    """Scalar problem (3.1): ``-Laplace(u) = source``; energy 1/2 a(u, u) - (source, u)."""

    source: Coefficient = 0.0
    components: ClassVar[int] = 1


@dataclass(frozen=True)
class PlaneStrain:
    """Plane-strain elasticity (3.7), isotropic with Lamé coefficients in N/m^2.

    ``body_force`` in N/m^3, per component a number or a function of position.
    """

    lame_lambda: float
    lame_mu: float
    body_force: tuple[Coefficient, Coefficient] = (0.0, 0.0)
    components: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if not (self.lame_mu > 0 and self.lame_lambda + self.lame_mu > 0):
            raise ValueError(
                f"Lamé coefficients lambda={self.lame_lambda}, mu={self.lame_mu} are not those of an elastic "
                "solid: mu > 0 and lambda + mu > 0 are needed"
            )


Law = Laplace | PlaneStrain


@dataclass(frozen=True)
class Traction:
    """A load per unit length on a named boundary, one coefficient per component."""

    boundary: str
    value: tuple[Coefficient, ...]


@dataclass(frozen=True)
class PiecewiseLinear:
    """Continuous piecewise-linear function of x_1, extended linearly beyond its ends.

    Attributes
    ----------
    x, y : tuples of float
        Breakpoints, ``x`` strictly increasing, and values.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.x) != len(self.y) or len(self.x) < 2:
            raise ValueError(
                f"a piecewise-linear function needs 2 or more points, got x={self.x}, y={self.y}"
            )
        if np.any(np.diff(self.x) <= 0):
            raise ValueError(f"breakpoints must increase, got x={self.x}")

    def __call__(self, x: Any, y: Any = None) -> Any:
        """Value at x_1 = ``x``; ``y`` is ignored, so that it serves as a function of position."""
        slopes = np.diff(self.y) / np.diff(self.x)
        value = self.y[0] + slopes[0] * (x - self.x[0])
        for corner, jump in zip(self.x[1:-1], np.diff(slopes), strict=True):
            value = value + jump * ca.fmax(x - corner, 0)
        return value


@dataclass(frozen=True)
class Obstacle:
    """Unilateral contact on a named boundary, with or without Tresca friction.

    The gap of a contact node at X with displacement u is ``normal . u + offset(X) >= 0``.
    (3.1): normal (1,), offset 0. (3.10): normal (0, 1), offset alpha(x_1).

    Attributes
    ----------
    boundary : str
    normal : tuple of float
        Unit vector, one number for a scalar problem.
    offset : float or function of position
        Initial distance to the foundation, in units of length.
    friction : float
        Tresca bound g in N/m^2, 0 without friction. It acts along the tangent, ``normal``
        turned by -90 degrees.
    """

    boundary: str
    normal: tuple[float, ...] = (0.0, 1.0)
    offset: Coefficient = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if abs(length - 1) > 1e-12:
            raise ValueError(f"the contact normal {self.normal} has length {length}, not 1")
        if not self.friction >= 0:
            raise ValueError(f"the friction bound must not be negative, got {self.friction}")
        if self.friction > 0 and len(self.normal) == 1:
            raise ValueError("friction needs a problem with two displacement components")

    @property
    def tangent(self) -> tuple[float, ...]:
        """Unit tangent; (1, 0) for the normal (0, 1), empty for a scalar problem."""
        if len(self.normal) == 1:
            return ()
        return (self.normal[1], -self.normal[0])


@dataclass(frozen=True)
class Motion:
    """How far nodes may move: the set M of (2.1), (2.2), kept valid.

    Attributes
    ----------
    delta : (float, float)
        Half-widths of the box around each initial position, in units of length.
    pinned : tuple of str
        Boundaries whose nodes do not move. Corners of the domain and ends of boundary
        parts never move, and other boundary nodes slide along their straight piece.
    min_area_fraction : float
        Smallest allowed signed area of an element, as a fraction of its initial one.
    """

    delta: tuple[float, float]
    pinned: tuple[str, ...] = ()
    min_area_fraction: float = 0.01

    def __post_init__(self) -> None:
        for value in self.delta:
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"delta must be positive and finite, got {value}")
        if not 0 < self.min_area_fraction < 1:
            raise ValueError(f"min_area_fraction must lie between 0 and 1, got {self.min_area_fraction}")


@dataclass(frozen=True)
class ExactSolution:
    """A known solution: ``value(x, y)`` of the displacement and its energy J(u)."""

    value: PositionFunction
    energy: float


@dataclass(frozen=True)
class ContactProblem:
    """A contact problem on a mesh with movable nodes.

    Attributes
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries.
    law : Laplace or PlaneStrain
    dirichlet : tuple of str
        Boundaries where the displacement is zero.
    obstacle : Obstacle
    motion : Motion
    tractions : tuple of Traction
    quadrature : "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), or a degree.
    exact : ExactSolution, optional
    name, size : str
        For records and file names.
    """

    mesh: MeshTri
    law: Law
    dirichlet: tuple[str, ...]
    obstacle: Obstacle
    motion: Motion
    tractions: tuple[Traction, ...] = ()
    quadrature: str | int = "midpoint"
    exact: ExactSolution | None = None
    name: str = "problem"
    size: str = field(default="")

    def __post_init__(self) -> None:
        if type(self.mesh).__name__ != "MeshTri1":
            raise ValueError(
                f"the mesh must be a skfem.MeshTri of first order, got {type(self.mesh).__name__}"
            )
        known = sorted(self.mesh.boundaries or {})
        loaded = [t.boundary for t in self.tractions]
        for name in (*self.dirichlet, self.obstacle.boundary, *self.motion.pinned, *loaded):
            if name not in known:
                raise ValueError(
                    f"the mesh has no boundary named {name!r}; it has {', '.join(known) or 'none'}"
                )
        if not self.dirichlet:
            raise ValueError("at least one boundary must be held (dirichlet), or the energy has no minimum")
        if len(self.obstacle.normal) != self.components:
            raise ValueError(
                f"the contact normal {self.obstacle.normal} has {len(self.obstacle.normal)} components, "
                f"the displacement has {self.components}"
            )
        for traction in self.tractions:
            if len(traction.value) != self.components:
                raise ValueError(
                    f"traction {traction.value} on {traction.boundary!r} needs {self.components} values"
                )

    @property
    def components(self) -> int:
        """Number of displacement components, 1 or 2."""
        return self.law.components

    @property
    def triangles(self) -> NDArray[np.int64]:
        """(3, elements) vertex numbers, each triangle counter-clockwise."""
        p, t = self.mesh.p, np.array(self.mesh.t, dtype=np.int64)
        clockwise = signed_areas(p, t) < 0
        t[1:, clockwise] = t[:0:-1, clockwise]
        return t

    def boundary_nodes(self, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Sorted numbers of the nodes on the named boundaries."""
        facets = [self.mesh.boundaries[name] for name in names]
        if not facets:
            return np.zeros(0, np.int64)
        return np.unique(self.mesh.facets[:, np.concatenate(facets)]).astype(np.int64)

    @property
    def contact_nodes(self) -> NDArray[np.int64]:
        """Nodes of the contact boundary that are not held."""
        contact = self.boundary_nodes((self.obstacle.boundary,))
        return np.setdiff1d(contact, self.boundary_nodes(self.dirichlet))


def signed_areas(nodes: NDArray, triangles: NDArray) -> NDArray:
    """Signed area of each triangle, positive if counter-clockwise.

    ``nodes`` is (2, nodes), ``triangles`` (3, elements).
    """
    a, b, c = (nodes[:, vertex] for vertex in triangles)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]))
