"""Small problems of contact: curves, two foundations, bodies that contact holds."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.meshes import named

LAW = rm.PlaneStrain(1.15e4, 0.83e4)


def block(name: str, n: int, length: int = 2, **parts: Any) -> rm.ContactProblem:
    """A block (0, length) x (0, 1), held on the left unless said otherwise."""
    usual = {"law": LAW, "dirichlet": ("left",), "motion": rm.Motion(rm.Relative(0.3)), "name": name}
    return rm.ContactProblem(**{"mesh": rm.shapes.rectangle(length * n, n, x=(0, length)), **usual, **parts})


def block_on_a_circle(n: int = 4) -> rm.ContactProblem:
    """A block pressed onto a disc below its lower side."""
    return block(
        "circle",
        n,
        obstacle=rm.Obstacle.circle("bottom", (1.4, -3.004), 3.0),
        motion=rm.Motion(rm.Relative(0.3), pinned=("top",)),
        tractions=(rm.Traction("top", (-20.0, -120.0)),),
    )


def block_along_a_circle(n: int = 4) -> rm.ContactProblem:
    """The block on the disc with gaps that hold along edges."""
    return with_edge_gaps(replace(block_on_a_circle(n), name="along"))


def block_sliding_on_a_circle(n: int = 3) -> rm.ContactProblem:
    """The block on the disc with friction, of which some contact nodes stick and some slide."""
    disc = rm.Obstacle.circle("bottom", (1.4, -3.004), 3.0, friction=lambda x, y: 60.0 + 200 * (x - 1) ** 2)
    return replace(block_on_a_circle(n), obstacle=disc, name="sliding")


def block_between_two_foundations(n: int = 4) -> rm.ContactProblem:
    """A block that swells against a flat foundation below, with friction, and a curved one above."""
    floor = rm.Obstacle.line("bottom", (0, -0.002), (0, 1), friction=30.0)
    ceiling = rm.Obstacle.curve("top", lambda x, y: 1.004 + 0.01 * ca.sin(3 * x) - y)
    load = (rm.Traction("right", (-400.0, 100.0)),)
    return block("between", n, obstacle=(floor, ceiling), tractions=load)


def block_in_a_corner(n: int = 3) -> rm.ContactProblem:
    """A block on a floor and against a wall, held by nothing else; node 0 meets both."""
    floor, wall = rm.Obstacle.line("bottom", (0, 0), (-0.1, 1)), rm.Obstacle.line("left", (0, 0), (1, 0.2))
    loads = (rm.Traction("top", (-30.0, lambda x, y: -100 * (1 + x))), rm.Traction("right", (-80.0, 0.0)))
    return block("corner", n, 1, dirichlet=(), obstacle=(floor, wall), tractions=loads)


def punch_held_by_symmetry(n: int = 4) -> rm.ContactProblem:
    """Right half of a block pressed on a floor: symmetry on the left, contact below, nothing else."""
    mesh = named(rm.shapes.rectangle(n, n), {"middle": lambda p: np.isclose(p[1], 0) & (p[0] < 0.6)})
    return block(
        "punch",
        n,
        mesh=mesh,
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=rm.Obstacle("middle", offset=lambda x, y: 0.01 * x**2),
        tractions=(rm.Traction("top", (0.0, -200.0)),),
        point_loads=(rm.PointLoad(mesh.p.shape[1] - 1, (5.0, -3.0)),),
    )
