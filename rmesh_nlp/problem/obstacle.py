"""Contact sets: a boundary part over a rigid foundation, or an obstacle below a membrane."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from rmesh_nlp.problem.coefficients import Coefficient, PiecewiseLinear, PositionFunction, at


class Place(Enum):
    """Where contact may happen when it is not on a named boundary."""

    INTERIOR = "interior"
    NOWHERE = "nowhere"


@dataclass(frozen=True)
class Obstacle:
    """Unilateral contact, with or without Tresca friction.

    The gap of a contact node at X with displacement u is ``normal . u + offset(X) >= 0``.
    (3.1): normal (1,), offset 0. (3.10): normal (0, 1), offset alpha(x_1). Contact is
    geometrically linear: the gap is measured along ``normal`` at the place where the node is
    before the displacement.

    Attributes
    ----------
    boundary : str or Place
        Name of the contact boundary; ``Place.INTERIOR`` for all nodes of a scalar problem.
    normal : tuple of float
        Unit vector, one number for a scalar problem. It points from the foundation to the body.
    offset : float or function of position
        Initial distance to the foundation, in units of length.
    friction : float or function of position
        Tresca bound g >= 0 in N/m^2, 0 without friction. It acts along the tangent, ``normal``
        turned by -90 degrees.
    kinks : tuple of float
        Values of x_1 where the offset has a kink, found for a :class:`PiecewiseLinear` one.
        Contact nodes there do not move: the gap is imposed at nodes, and beside its node a kink
        of the foundation would pass into the body.
    """

    boundary: str | Place
    normal: tuple[float, ...] = (0.0, 1.0)
    offset: Coefficient = 0.0
    friction: Coefficient = 0.0
    kinks: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.offset, PiecewiseLinear) and not self.kinks:
            object.__setattr__(self, "kinks", self.offset.kinks)
        length = float(np.linalg.norm(self.normal))
        if not abs(length - 1) <= 1e-12:
            raise ValueError(f"the contact normal {self.normal} has length {length}, not 1")
        if not callable(self.friction) and not self.friction >= 0:
            raise ValueError(f"the friction bound must not be negative, got {self.friction}")
        if self.frictional and (len(self.normal) == 1 or self.boundary is Place.INTERIOR):
            raise ValueError("friction needs a problem with two displacement components")

    @classmethod
    def line(
        cls,
        boundary: str,
        point: tuple[float, float],
        normal: tuple[float, float],
        friction: Coefficient = 0.0,
    ) -> Obstacle:
        """A rigid straight line through ``point``; the gap is ``normal . (X + u - point)``.

        ``normal`` points from the line to the body and may have any length but zero.
        """
        length = float(np.hypot(*normal))
        if not (np.isfinite(length) and length > 0):
            raise ValueError(f"the normal of the rigid line must be a non-zero vector, got {normal}")
        n = (normal[0] / length, normal[1] / length)
        return cls(boundary, n, lambda x, y: n[0] * (x - point[0]) + n[1] * (y - point[1]), friction=friction)

    @classmethod
    def graph(cls, boundary: str, height: PositionFunction | float, friction: Coefficient = 0.0) -> Obstacle:
        """A foundation below the graph ``y = height(x)``, gap measured vertically.

        The gap ``X_2 + u_2 - height(X_1)`` is that of (3.10) with alpha = X_2 - height. The
        height is any smooth function or a :class:`PiecewiseLinear`, called as height(x, y).
        """
        kinks = height.kinks if isinstance(height, PiecewiseLinear) else ()
        return cls(boundary, (0.0, 1.0), lambda x, y: y - at(height, x, y), friction, kinks)

    @classmethod
    def interior(cls, psi: Coefficient) -> Obstacle:
        """The scalar obstacle problem ``u >= psi`` in the whole domain, imposed at the nodes."""
        return cls(Place.INTERIOR, (1.0,), lambda x, y: -at(psi, x, y))

    @property
    def frictional(self) -> bool:
        """Whether there is a friction bound at all."""
        return callable(self.friction) or self.friction > 0

    @property
    def tangent(self) -> tuple[float, ...]:
        """Unit tangent; (1, 0) for the normal (0, 1), empty for a scalar problem."""
        if len(self.normal) == 1:
            return ()
        return (self.normal[1], -self.normal[0])


NO_CONTACT = Obstacle(Place.NOWHERE)
"""A problem without contact."""
