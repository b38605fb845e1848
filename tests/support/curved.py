"""Problems with curved boundaries."""

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline

HOLE = Circle((5.0, 5.0), 2.5)
ANGLES = np.arange(40) * np.pi / 20
CURVES: dict[str, Curve] = {
    "circle": HOLE,
    "parametrised": Parametrised(
        lambda t: 5 + 2.5 * ca.cos(t), lambda t: 5 + 2.5 * ca.sin(t), (0.0, 2 * np.pi), closed=True
    ),
}


def plate(
    curves: Mapping[str, Curve] | None = None,
    *,
    h: float = 2.0,
    delta: Any = None,
    load: tuple[Any, Any] = (0.0, 0.0),
) -> rm.ContactProblem:
    """A quarter-symmetric plate with a hole, pulled to the right."""
    return rm.ContactProblem(
        rm.shapes.plate_with_hole(h),
        rm.PlaneStrain.from_young(1000.0, 0.3, load),
        (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("bottom", (None, 0.0))),
        tractions=(rm.Traction("right", (10.0, 0.0)),),
        motion=rm.Motion(delta, curves=curves or {}),
        quadrature=6,
        name="plate",
    )


def disc(curves: Mapping[str, Curve] | None = None, *, delta: Any = None) -> rm.ContactProblem:
    """A quarter of a disc, pressed onto a flat foundation below its arc."""
    return rm.ContactProblem(
        rm.shapes.half_disc(0.3, contact=0.2, h_contact=0.08),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("axis", (0.0, None)), rm.Dirichlet("top", (None, -0.05))),
        rm.Obstacle.graph("contact", 0.0),
        motion=rm.Motion(delta, curves=curves or {}),
        name="disc",
    )


def spline_of_the_hole() -> Spline:
    """The hole as a closed spline through 40 points."""
    return Spline(tuple((5 + 2.5 * np.cos(a), 5 + 2.5 * np.sin(a)) for a in ANGLES), closed=True)
