"""Meshes and starting points that tests of certificates use."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from skfem import MeshTri

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.certificate.bracket import Bracket, bracket
from rmesh_nlp.certificate.equilibration import Guess
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Obstacle, Traction
from rmesh_nlp.solving.certify import with_upper


def distorted(mesh: MeshTri, amount: float, seed: int) -> MeshTri:
    """Interior nodes moved at random by up to ``amount`` times the shortest edge; no element turns over."""
    p, inside = mesh.p.copy(), mesh.interior_nodes()
    edges = mesh.p[:, mesh.facets[1]] - mesh.p[:, mesh.facets[0]]
    step = amount * np.min(np.linalg.norm(edges, axis=0))
    p[:, inside] += np.random.default_rng(seed).uniform(-step, step, (2, inside.size))
    return replace(mesh, doflocs=p)


def guess_on(problem: ContactProblem, displacement: np.ndarray | None = None) -> Guess:
    """The contact solution, or a displacement without contact stresses."""
    space = DisplacementSpace(problem)
    pressure, friction = np.zeros((2, space.n_nodes))
    if displacement is None:
        model, weights = ContactSolver(problem), space.weights(np.asarray(problem.mesh.p))
        found, displacement = model.given, model.displacement.values(model.given.u)
        pressure[model.contact_nodes] = found.normal_force / weights
        friction[model.contact_nodes] = found.tangential_force / weights
    return Guess(displacement, pressure, friction)


def proved(problem: ContactProblem) -> Bracket:
    """The bracket of the contact solution, the upper bound by an admissible displacement."""
    return with_upper(bracket(problem, problem.mesh.p, guess_on(problem)), admissible(problem))


def of_values(problem: ContactProblem, fields: Sequence[Callable]) -> np.ndarray:
    """Coefficients of the displacement that has the values of the components at the nodes' points."""
    space = DisplacementSpace(problem)
    return space.coefficients(np.stack([field(*space.points(problem.mesh.p)) for field in fields]))


def signorini(n: int, order: int) -> ContactProblem:
    """r^(3/2) cos(3 t / 2), which leaves the obstacle at the origin; held where it touches left of -1/2."""
    parts = {
        "held": lambda x: np.isclose(x[1], 0) & (x[0] < -0.5),
        "free": lambda x: np.isclose(x[1], 0) & (x[0] > -0.5),
    }
    mesh = rectangle(2 * n + 1, n, x=(-1, 1)).with_boundaries(parts)
    size = lambda x, y: 1.5 * (x * x + y * y) ** 0.25  # noqa: E731
    ux = lambda x, y: size(x, y) * ca.cos(ca.atan2(y, x) / 2)  # noqa: E731
    uy = lambda x, y: -size(x, y) * ca.sin(ca.atan2(y, x) / 2)  # noqa: E731
    fluxes = {"left": lambda x, y: -ux(x, y), "right": ux, "top": uy}
    pulls = tuple(Traction(side, (flux,)) for side, flux in fluxes.items())
    return ContactProblem(mesh, Laplace(), "held", Obstacle("free", (1.0,)), tractions=pulls, order=order)
