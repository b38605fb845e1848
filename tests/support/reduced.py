"""Reduced energies of small problems with every kind of contact."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate, regularised
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain, PointLoad
from support.contact_geometry import (
    block_along_a_circle,
    block_between_two_foundations,
    block_in_a_corner,
    block_sliding_on_a_circle,
    punch_held_by_symmetry,
)
from support.curved import disc
from support.problems import no_move_limits, sloped_block

CONTACTS: dict[str, Callable[[], ContactProblem]] = {
    "6.1": lambda: rm.EXAMPLES["6.1"](4),
    "6.2": lambda: rm.EXAMPLES["6.2"]((4, 2)),
    "6.3": lambda: rm.EXAMPLES["6.3"]((6, 2)),
    "sloped, stick and slip": lambda: sloped_block(n=(6, 2)),
    "curved foundation, stick and slip": block_sliding_on_a_circle,
}


def disc_on_its_arc() -> ContactProblem:
    """A quarter of a disc that meets the foundation with its arc, along which nodes slide."""
    arc = rm.Circle((0.0, 1.0), 1.0)
    return replace(disc({"arc": arc}, delta=0.02), obstacle=Obstacle.graph("arc", 0.0))


def tied_membrane() -> ContactProblem:
    """Two inner nodes that move alike, a force at one of them, and a wall that is met in part."""
    problem = rm.EXAMPLES["6.1"](4)
    one, two = (int(np.argmin(np.abs(problem.mesh.p.T - at).sum(axis=1))) for at in ((0.25, 0.5), (0.5, 0.5)))
    return replace(
        problem,
        motion=Motion(0.05, tied=((one, two),)),
        point_loads=(PointLoad(two, (0.3,)),),
        obstacle=Obstacle("contact", (1.0,), lambda x, y: 0.3 * y),
        quadrature=8,
        exact=None,
    )


def membrane_over_a_bump() -> ContactProblem:
    """Gaps hold inside of elements too."""
    bump = Obstacle.interior(lambda x, y: 0.05 * ca.exp(-3 * ((x - 1) ** 2 + (y - 0.4) ** 2)) - 0.2)
    problem = random_problem(2, kind="membrane")
    return replace(problem, obstacle=replace(bump, gap="edge"), motion=Motion(0.05))


def bumpy(friction: float) -> ContactProblem:
    """A gap along edges depends on the positions of two neighbours, which are of no common element."""
    foundation = Obstacle("bottom", (0.0, 1.0), lambda x, y: 0.02 * ca.sin(2 * x) ** 2, friction, gap="edge")
    law = PlaneStrain(50.0, 50.0, (1.0, -4.0))
    return ContactProblem(rm.shapes.rectangle(4, 3, x=(0, 2)), law, ("left",), foundation, Motion(None))


OTHERS: dict[str, Callable[[], ContactProblem]] = {
    "gaps along edges": lambda: block_along_a_circle(2),
    "two foundations": lambda: block_between_two_foundations(2),
    "graph, no normal varies": punch_held_by_symmetry,
    "interior obstacle": lambda: random_problem(2, kind="membrane"),
    "bump, gaps along edges": membrane_over_a_bump,
    "two materials": lambda: random_problem(8),
    "contact on an arc": disc_on_its_arc,
    "two obstacles at a node": lambda: block_in_a_corner(2),
    "tied nodes, point load, given gap": tied_membrane,
}
"""More kinds of contact."""


def of_order_2(make: Callable[[], ContactProblem]) -> Callable[[], ContactProblem]:
    """The same problem with quadratic displacements."""
    return lambda: replace(make(), order=2)


QUADRATIC = {f"{name}, order 2": of_order_2(make) for name, make in (CONTACTS | OTHERS).items()}


def free_membrane() -> ContactProblem:
    """Example 6.1 without move limits."""
    return replace(no_move_limits(rm.EXAMPLES["6.1"](n=4)), quadrature=4)


def reduced(problem: ContactProblem, objective: str = "energy") -> ReducedEnergy:
    """The energy with terms in the positions, as a function of the outer variables."""
    return ReducedEnergy(ContactSolver(problem), parse_objective(objective))


def with_distortion(problem: ContactProblem, weight: float = 0.01) -> ReducedEnergy:
    """The energy with a distortion, weighted relative to what is to be gained."""
    objective = regularised(gain_estimate(ContactSolver(problem)), weight)
    return ReducedEnergy(ContactSolver(problem), objective)
