"""Problems with design variables of every kind."""

from collections.abc import Callable

import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.contact_pressure import vertex_pressures

E, F, H0, LOAD = (
    rm.DesignVariable(name, start, bounds)
    for name, start, bounds in (
        ("E", 1.0, (0.5, 2.0)),
        ("F", 0.05, (0.0, 0.1)),
        ("h0", 0.0, (-0.02, 0.02)),
        ("load", 1.0, (0.5, 1.5)),
    )
)
FILE = """
[mesh]
shape = "rectangle"
nx = 6
ny = 2
x = [0.0, 4.0]
[material]
law = "plane-strain"
young = "1000*E"
poisson = 0.3
[dirichlet]
top = [0.0, -0.02]
[contact]
boundary = "bottom"
height = "h - 0.002*(x - 2)**2"
[design]
E = { start = 1.0, bounds = [0.5, 2.0] }
h = { start = 0.0, bounds = [-0.02, 0.02] }
"""
"""A block that is pressed onto a foundation, as a problem file."""

BOW = rm.Shape("bow", "bottom", (0.0, lambda x, y: x * (4 - x) / 4), (-0.05, 0.05))


def block(
    *design: rm.DesignVariable | rm.Shape,
    constraints: tuple[rm.Constraint, ...] = (),
    order: int = 1,
    n: tuple[int, int] = (6, 3),
    gaps: str = "node",
) -> rm.ContactProblem:
    """A block held at its top that a foundation presses from below; it depends on the given variables."""
    names = {variable.name for variable in design}

    def value(variable: rm.DesignVariable) -> object:
        return variable.symbol if variable.name in names else variable.start

    gap: Callable[..., object] = lambda x, y: value(H0) - 0.01 + 0.01 * (x - 1) ** 2  # noqa: E731
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(*n, x=(0, 4), y=(0, 1)),
        law=rm.PlaneStrain.from_young(1e4 * value(E), 0.3, (0.0, lambda x, y: -100 * value(LOAD) * x)),
        dirichlet="top",
        obstacle=rm.Obstacle("bottom", (0, 1), gap, coulomb=value(F) if "F" in names else 0.0, gap=gaps),
        tractions=rm.Traction("right", (20.0, lambda x, y: -60 * value(LOAD) * (1 + y))),
        motion=rm.Motion(delta=0.05),
        order=order,
        design=design,
        constraints=constraints,
    )


DESIGNS = {
    "gaps along edges": lambda order: block(H0, BOW, order=order, n=(4, 2), gaps="edge"),
    "modulus, load, foundation, Coulomb's coefficient, shape": lambda order: block(
        E, LOAD, H0, F, BOW, order=order, n=(4, 2)
    ),
}

LIMITED = (
    rm.Constraint("boundary(bottom, ux)", (-0.1, 0.01)),
    rm.Constraint("max-pressure(bottom)", (-np.inf, 200.0)),
    rm.Constraint("body(ux**2)", (-np.inf, 1e-4)),
)


def largest_mean(problem: rm.ContactProblem) -> float:
    """The largest mean pressure of a vertex in the contact solution."""
    solver = ContactSolver(problem)
    space, force = solver.discretisation.space, solver.given.normal_force
    means = (vertex_pressures(space, problem.mesh.p, part, force) for part in space.contact_sets)
    return float(max(np.max(values) for values in means))
