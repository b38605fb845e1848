"""Problems that several tests use."""

from dataclasses import replace
from typing import Any

import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.problem import PiecewiseLinear


def sloped_block(friction: float = 60.0, n: tuple[int, int] = (8, 3)) -> rm.ContactProblem:
    alpha = PiecewiseLinear((0.0, 2.0, 4.0), (0.0, 0.02, 0.1))
    mesh = MeshTri.init_tensor(np.linspace(0, 4, n[0] + 1), np.linspace(0, 1, n[1] + 1))
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
    return rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain(1.15e4, 0.83e4, body_force=(0.0, lambda x, y: -20 * x)),
        dirichlet=("left",),
        obstacle=rm.Obstacle("contact", normal=(0.0, 1.0), offset=alpha, friction=friction),
        motion=rm.Motion((0.1, 0.05)),
        tractions=(rm.Traction("top", (-20.0, lambda x, y: -30 * x)),),
        name="sloped",
    )


def coulomb_slab(coulomb: Any = 0.5, n: tuple[int, int] = (12, 6), **changes: Any) -> rm.ContactProblem:
    """Example 6.3 with a coefficient of Coulomb in the place of its bound."""
    problem = rm.EXAMPLES["6.3"](n)
    obstacle = replace(problem.obstacle, friction=0.0, coulomb=coulomb)
    return replace(problem, obstacle=obstacle, **changes)


SHEAR, PRESSURE, COULOMB, LENGTH = 50.0, 3.0, 0.4, 2.0
"""Shear modulus of the next block, its pressure, its coefficient of friction, its length."""


def sliding_block(order: int = 1) -> rm.ContactProblem:
    """Pressure p and shear F p everywhere: displacements are linear, the bottom slides by 0.02."""
    F, p = COULOMB, PRESSURE
    return rm.ContactProblem(
        rm.shapes.rectangle(5, 3, x=(0, LENGTH)),
        rm.PlaneStrain(0.0, SHEAR),
        rm.Dirichlet("top", (0.02 + F * p / SHEAR, -p / (2 * SHEAR))),
        rm.Obstacle("bottom", coulomb=F),
        rm.Motion(0.05),
        (rm.Traction("right", (0.0, F * p)), rm.Traction("left", (0.0, -F * p))),
        order=order,
    )


def signorini(n: int = 8) -> rm.ContactProblem:
    """Example 6.1 without move limits, its load by a rule of degree 6."""
    return replace(rm.EXAMPLES["6.1"](n=n), motion=rm.Motion(None), quadrature=6)


def energy_error(problem: rm.ContactProblem) -> float:
    """Error of the energy on the mesh of a problem whose solution is known."""
    return ContactSolver(replace(problem, quadrature=10)).solve(problem.mesh.p).energy - problem.exact.energy


def no_move_limits(problem: rm.ContactProblem) -> rm.ContactProblem:
    """The same without boxes, elements kept by a small least area."""
    return replace(problem, motion=replace(problem.motion, delta=None, min_area_fraction=0.01))


def tied_neighbours() -> rm.ContactProblem:
    """Two vertices of one triangle share their outer variables: local derivatives fold onto the diagonal."""
    problem = rm.EXAMPLES["6.1"](3, 0.1)
    inside = problem.mesh.interior_nodes()
    edge = next(e for e in problem.mesh.facets.T.tolist() if set(e) <= set(inside.tolist()))
    return replace(problem, motion=replace(problem.motion, tied=(tuple(edge),)))


def shuffled(mesh: MeshTri, seed: int) -> tuple[MeshTri, np.ndarray]:
    """The same mesh with its nodes and triangles in another order, and the new number of each node."""
    rng = np.random.default_rng(seed)
    new, order = rng.permutation(mesh.p.shape[1]), rng.permutation(mesh.t.shape[1])
    nodes, place = np.empty_like(mesh.p), np.argsort(order)
    nodes[:, new] = mesh.p
    triangles = [np.roll(t, rng.integers(3)) for t in new[counter_clockwise(mesh.p, mesh.t)].T[order]]
    edges = {name: new[mesh.facets[:, facets]].T for name, facets in mesh.boundaries.items()}
    parts = {name: place[elements] for name, elements in (mesh.subdomains or {}).items()}
    return from_arrays(nodes.T, np.array(triangles), edges, parts), new
