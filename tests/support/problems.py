"""Problems that several tests use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from skfem import MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import Discretisation
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PiecewiseLinear, PlaneStrain, Traction


def sloped_block(friction: float = 60.0) -> ContactProblem:
    alpha = PiecewiseLinear((0.0, 2.0, 4.0), (0.0, 0.02, 0.1))
    mesh = MeshTri.init_tensor(np.linspace(0, 4, 9), np.linspace(0, 1, 4))
    p = mesh.p.copy()
    height = np.interp(p[0], alpha.x, alpha.y)
    p[1] = height + p[1] * (1 - height)
    mesh = replace(mesh, doflocs=p).with_boundaries(
        {
            "left": lambda x: np.isclose(x[0], 0),
            "top": lambda x: np.isclose(x[1], 1),
            "contact": lambda x: (x[1] < 0.11) & (x[0] > 1e-9) & (x[0] < 4 - 1e-9),
        }
    )
    return ContactProblem(
        mesh=mesh,
        law=PlaneStrain(1.15e4, 0.83e4, body_force=(0.0, lambda x, y: -20 * x)),
        dirichlet=("left",),
        obstacle=Obstacle("contact", normal=(0.0, 1.0), offset=alpha, friction=friction),
        motion=Motion((0.1, 0.05)),
        tractions=(Traction("top", (-20.0, lambda x, y: -30 * x)),),
        name="sloped",
    )


def renumbered(problem: ContactProblem, seed: int = 7) -> Discretisation:
    """The same with the nodes of the displacement in another order than the vertices and edges."""
    order = np.random.default_rng(seed).permutation(DisplacementSpace.of(problem).n_nodes)
    return Discretisation(problem, displacement_space=DisplacementSpace(problem, order))


def signorini(n: int = 8) -> ContactProblem:
    """Example 6.1 without move limits, its load by a rule of degree 6."""
    return replace(EXAMPLES["6.1"](n=n), motion=Motion(None), quadrature=6)


def energy_error(problem: ContactProblem) -> float:
    """Error of the energy on the mesh of a problem whose solution is known."""
    return ContactSolver(replace(problem, quadrature=10)).solve(problem.mesh.p).energy - problem.exact.energy


def no_move_limits(problem: ContactProblem) -> ContactProblem:
    """The same without boxes, elements kept by a small least area."""
    return replace(problem, motion=replace(problem.motion, delta=None, min_area_fraction=0.01))
