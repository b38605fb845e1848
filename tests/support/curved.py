"""Problems with curved boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.meshes import shapes
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain, Traction

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
) -> ContactProblem:
    """A quarter-symmetric plate with a hole, pulled to the right."""
    return ContactProblem(
        shapes.plate_with_hole(h),
        PlaneStrain.from_young(1000.0, 0.3, load),
        (Dirichlet("left", (0.0, None)), Dirichlet("bottom", (None, 0.0))),
        tractions=(Traction("right", (10.0, 0.0)),),
        motion=Motion(delta, curves=curves or {}),
        quadrature=6,
        name="plate",
    )


def disc(curves: Mapping[str, Curve] | None = None, *, delta: Any = None) -> ContactProblem:
    """A quarter of a disc, pressed onto a flat foundation below its arc."""
    return ContactProblem(
        shapes.half_disc(0.3, contact=0.2, h_contact=0.08),
        PlaneStrain.from_young(1000.0, 0.3),
        (Dirichlet("axis", (0.0, None)), Dirichlet("top", (None, -0.05))),
        Obstacle.graph("contact", 0.0),
        motion=Motion(delta, curves=curves or {}),
        name="disc",
    )


def spline_of_the_hole() -> Spline:
    """The hole as a closed spline through 40 points."""
    return Spline(tuple((5 + 2.5 * np.cos(a), 5 + 2.5 * np.sin(a)) for a in ANGLES), closed=True)
