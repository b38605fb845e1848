"""Designs of curved foundations, friction bounds, membranes, regions and point loads."""

from __future__ import annotations

import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.meshes import shapes

RADIUS = rm.DesignVariable("R", 6.0, (3.0, 12.0))
CENTRE = rm.DesignVariable("c", -5.98, (-6.1, -5.9))
BOUND = rm.DesignVariable("g", 5.0, (0.0, 20.0))
STIFFNESS = rm.DesignVariable("k", 1.0, (0.5, 3.0))
HEIGHT = rm.DesignVariable("psi", -0.03, (-0.06, -0.01))
LOAD = rm.DesignVariable("P", 1.0, (0.0, 3.0))


def on_a_disc(order: int = 1) -> rm.ContactProblem:
    """A block over a disc of any radius and centre, with any friction bound."""
    return rm.ContactProblem(
        shapes.rectangle(8, 4, x=(-1, 1), y=(0, 1)),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        "top",
        rm.Obstacle.circle("bottom", (0.0, CENTRE.symbol), RADIUS.symbol, friction=BOUND.symbol),
        rm.Motion(0),
        tractions=rm.Traction("right", (5.0, 0.0)),
        order=order,
        design=(RADIUS, CENTRE, BOUND),
    )


def membrane(order: int = 1) -> rm.ContactProblem:
    """A membrane over an obstacle of any height, with any stiffness and load."""
    return rm.ContactProblem(
        shapes.rectangle(6, 6),
        rm.Laplace(lambda x, y: -4 * LOAD.symbol * (1 + x), STIFFNESS.symbol),
        ("left", "right", "top", "bottom"),
        rm.Obstacle.interior(lambda x, y: HEIGHT.symbol + 0.02 * x),
        rm.Motion(0),
        order=order,
        design=(STIFFNESS, HEIGHT, LOAD),
    )


def two_regions(order: int = 1) -> rm.ContactProblem:
    """A cantilever under a point load of any size, one half of any stiffness."""
    mesh = shapes.rectangle(6, 3, x=(0, 2), y=(0, 1))
    mesh = mesh.with_subdomains({"a": lambda x: x[0] < 1, "b": lambda x: x[0] > 1})
    node = int(np.argmin(np.hypot(mesh.p[0] - 2, mesh.p[1] - 1)))
    soft = rm.PlaneStress.from_young(1000 * STIFFNESS.symbol, 0.3)
    return rm.ContactProblem(
        mesh,
        {"a": soft, "b": rm.PlaneStress.from_young(2000.0, 0.3)},
        "left",
        rm.Obstacle("bottom", (0, 1), 0.001),
        rm.Motion(0),
        point_loads=rm.PointLoad(node, (0.0, -3.0 * LOAD.symbol)),
        order=order,
        design=(STIFFNESS, LOAD),
    )


MORE = {"disc": on_a_disc, "membrane": membrane, "two regions": two_regions}
