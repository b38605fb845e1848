"""The problems of the benchmark, without move limits, and how the error of a mesh is measured on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import common
import free_boundary
import l_shape
import numpy as np
import signorini
import wedge
from matplotlib.tri import Triangulation

from best_mesh.adaptive import Laplacian
from peer_solvers import source_61
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES
from rmesh_nlp.fem.stress import gradients
from rmesh_nlp.models.edge_gains import edge_gains, marked
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, signed_areas
from rmesh_nlp.problem.contact_problem import locally_refined, refined

RULE, FINE = 6, 10
REFERENCE_NODES = 12_000


@dataclass(frozen=True)
class Case:
    """A problem at several sizes.

    Attributes
    ----------
    name : str
    sizes : tuple of int
    problem : callable
        Of a size.
    error : callable
        Error of a mesh: of its energy, or half its square in the energy norm.
    local : callable
        (elements,) errors, half their squares in the energy norm.
    laplacian : Laplacian, optional
        The same as scikit-fem has it, with its exact energy ``exact``.
    """

    name: str
    sizes: tuple[int, ...]
    problem: Callable[[int], ContactProblem]
    error: Callable[[ContactProblem], float]
    local: Callable[[ContactProblem], np.ndarray]
    laplacian: Laplacian | None = None
    exact: float = float("nan")


def energy(problem: ContactProblem) -> float:
    """By a rule of high degree."""
    return float(ContactSolver(replace(problem, quadrature=FINE)).solve(problem.mesh.p).energy)


@dataclass(frozen=True)
class Reference:
    """A problem on a locally refined mesh, and the energy that such meshes tend to."""

    problem: ContactProblem
    limit: float


def reference(problem: ContactProblem, nodes: int) -> Reference:
    """Refine where new nodes gain most; the polygon of the mesh stays.

    The energy is extrapolated from the last mesh and the one that had half as many nodes, with the rate of
    optimal meshes, one over the number of nodes.
    """
    here = replace(problem, motion=Motion(None), exact=None, reference=None)
    found: list[tuple[int, float]] = []
    while not found or found[-1][0] < nodes:
        here = locally_refined(here, marked(edge_gains(here))) if found else here
        found.append((int(here.mesh.p.shape[1]), float(ContactSolver(here).solve(here.mesh.p).energy)))
    last, least = found[-1]
    before, higher = next((one for one in reversed(found) if one[0] <= last / 2), found[0])
    return Reference(here, least - (higher - least) * before / (last - before))


def _gradients(problem: ContactProblem) -> np.ndarray:
    """(components, 2, elements) of the contact solution on the mesh as given."""
    return gradients(problem, np.asarray(problem.mesh.p), _displacement(problem))


def _displacement(problem: ContactProblem) -> np.ndarray:
    """Nodal values of the contact solution on the mesh as given."""
    model = ContactSolver(problem)
    return model.displacement.values(model.solve(problem.mesh.p).u)


def local_errors(problem: ContactProblem, fine: ContactProblem) -> np.ndarray:
    """(elements,) half the squared energy norm of the difference to a finer solution; one material.

    An element of the finer mesh counts where its centroid is.
    """
    there, t = np.asarray(fine.mesh.p), fine.triangles
    finder = Triangulation(*np.asarray(problem.mesh.p), problem.triangles.T).get_trifinder()
    element = np.asarray(finder(*there[:, t].mean(axis=1)))
    g, ((law, _),) = _gradients(fine) - _gradients(problem)[..., element], fine.regions
    if isinstance(law, Laplace):
        density = law.conductivity * (g[0] ** 2).sum(axis=0) / 2
    else:
        strain = (g + np.swapaxes(g, 0, 1)) / 2
        trace = strain[0, 0] + strain[1, 1]
        density = law.in_plane_lambda * trace**2 / 2 + law.lame_mu * (strain**2).sum(axis=(0, 1))
    inside = element >= 0
    energies = density * signed_areas(there, t)
    return np.bincount(element[inside], energies[inside], problem.triangles.shape[1])


def exact_errors(problem: ContactProblem) -> np.ndarray:
    """(elements,) half the squared energy norm of the error against the exact solution."""
    fine = replace(problem, quadrature=FINE)
    return common.exact_errors(fine, problem.mesh.p, _displacement(fine))


def _case(
    name: str,
    sizes: tuple[int, ...],
    make: Callable[[int], ContactProblem],
    laplacian: Laplacian | None = None,
    exact: float | None = None,
) -> Case:
    """A case whose error is that of the energy, against the exact one or a reference."""

    def problem(size: int) -> ContactProblem:
        return replace(make(size), motion=Motion(None), quadrature=RULE)

    @cache
    def fine() -> Reference:
        return reference(problem(sizes[0]), REFERENCE_NODES)

    def error(given: ContactProblem) -> float:
        return energy(given) - (fine().limit if exact is None else exact)

    def local(given: ContactProblem) -> np.ndarray:
        return local_errors(given, fine().problem)

    return Case(name, sizes, problem, error, local, laplacian, exact or float("nan"))


def _by_norm(case: Case) -> Case:
    return replace(case, error=lambda problem: float(exact_errors(problem).sum()), local=exact_errors)


def _l_shape(times: int) -> ContactProblem:
    problem = l_shape.problem(6)
    for _ in range(times):
        problem = refined(problem)
    return problem


LAPLACIAN_61 = Laplacian(
    lambda x: source_61(x[0], x[1], np.sin, np.where),
    lambda x: (x[0] == 0) | (x[1] == 0) | (x[1] == 1),
    lambda x: x[0] == 1,
)


WHOLE = Laplacian(lambda x: np.ones_like(x[0]), lambda x: np.ones(x.shape[1], dtype=bool))
"""A source of one, u = 0 on the whole boundary."""

CASES = {
    case.name: case
    for case in (
        _case("6.1", (8, 16, 32, 64, 128), EXAMPLES["6.1"], LAPLACIAN_61, EXACT_ENERGY_61),
        _case("L-shape", (0, 1, 2), _l_shape, WHOLE, l_shape.EXACT_ENERGY),
        _case("6.3", (6, 12, 24), lambda n: EXAMPLES["6.3"](n=(2 * n, n))),
        _case("wedge", (6, 12), wedge.problem),
        _by_norm(_case("free boundary", (8, 16, 32), free_boundary.problem)),
        _by_norm(_case("Signorini", (10, 20), signorini.problem)),
    )
}
