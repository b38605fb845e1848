"""The problems of the benchmark, without boxes, and how the error of a mesh is measured on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import free_boundary
import l_shape
import numpy as np
import signorini
import wedge
from best_mesh.adaptive import Laplacian
from best_mesh.reference import Reference, local_errors, reference
from numpy.polynomial import Polynomial

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objectives import error_energy
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.refining import refined

RULE, JUDGE = 6, 10
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
        (elements,) exact errors, for h-refinement with an oracle.
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


def _free(problem: ContactProblem) -> ContactProblem:
    return replace(problem, motion=Motion(None), quadrature=RULE)


def energy(problem: ContactProblem) -> float:
    """By the judge's rule."""
    return float(ContactModel(replace(problem, quadrature=JUDGE)).solve(problem.mesh.p).energy)


def exact_errors(problem: ContactProblem) -> np.ndarray:
    """(elements,) half the squared energy norm of the error against the exact solution."""
    judged = replace(problem, quadrature=JUDGE)
    model = ContactModel(judged)
    values = model.displacement.values(model.solve(problem.mesh.p).u)
    fields = (constant_field(problem.mesh.p), constant_field(values), constant_field(values))
    return element_values(error_energy(judged, *fields))(np.zeros(0))[0]


def _by_reference(
    name: str,
    sizes: tuple[int, ...],
    make: Callable[[int], ContactProblem],
    exact: float | None = None,
    laplacian: Laplacian | None = None,
) -> Case:
    @cache
    def fine() -> Reference:
        return reference(make(sizes[0]), REFERENCE_NODES)

    return Case(
        name,
        sizes,
        make,
        lambda problem: energy(problem) - (fine().limit if exact is None else exact),
        lambda problem: local_errors(problem, fine()),
        laplacian,
        float("nan") if exact is None else exact,
    )


def _by_norm(name: str, sizes: tuple[int, ...], make: Callable[[int], ContactProblem]) -> Case:
    def norm(problem: ContactProblem) -> float:
        return float(exact_errors(problem).sum())

    return Case(name, sizes, make, norm, exact_errors)


def _times_refined(problem: ContactProblem, times: int) -> ContactProblem:
    for _ in range(times):
        problem = refined(problem)
    return problem


def _paper_61(n: int) -> ContactProblem:
    return _free(EXAMPLES["6.1"](n=n))


def _source_61(x: np.ndarray) -> np.ndarray:
    """-Laplace(u) of the exact solution (6.2), in closed form."""
    y = Polynomial([0, 1])
    halves = []
    for factor, w in ((200 * y * (0.5 - y) ** 4, 2 * np.pi), (100 * (1 - y) * (0.5 - y) ** 4, np.pi / 2)):
        halves.append((w**2 * factor(x[1]) - factor.deriv(2)(x[1])) * np.sin(w * x[0]))
    return np.where(x[1] <= 0.5, *halves)


LAPLACIAN_61 = Laplacian(_source_61, lambda x: (x[0] == 0) | (x[1] == 0) | (x[1] == 1), lambda x: x[0] == 1)


def _error_61(problem: ContactProblem) -> float:
    assert problem.exact is not None
    return energy(problem) - problem.exact.energy


CASES = {
    case.name: case
    for case in (
        Case("6.1", (8, 16, 32, 64, 128), _paper_61, _error_61, exact_errors, LAPLACIAN_61, EXACT_ENERGY_61),
        _by_reference(
            "L-shape",
            (0, 1, 2),
            lambda times: _times_refined(_free(l_shape.problem(6)), times),
            l_shape.EXACT_ENERGY,
            Laplacian(lambda x: np.ones_like(x[0]), lambda x: np.ones(x.shape[1], dtype=bool)),
        ),
        _by_reference("6.3", (6, 12, 24), lambda n: _free(EXAMPLES["6.3"](n=(2 * n, n)))),
        _by_reference("wedge", (6, 12), lambda n: _free(wedge.problem(n))),
        _by_norm("free boundary", (8, 16, 32), lambda n: _free(free_boundary.problem(n))),
        _by_norm("Signorini", (10, 20), lambda n: _free(signorini.problem(n))),
    )
}
