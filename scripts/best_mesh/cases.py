"""The problems of the benchmark, without boxes, and how the error of a mesh is measured on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import free_boundary
import hertz
import l_shape
import numpy as np
import plate_with_hole
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
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.problem import ContactProblem, Motion, signed_areas
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


def _free(problem: ContactProblem, motion: Motion | None = None) -> ContactProblem:
    return replace(problem, motion=motion or Motion(None), quadrature=RULE)


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


def _plate(times: int) -> ContactProblem:
    motion = Motion(None, curves={"hole": Circle((5.0, 5.0), 2.5)})
    return _times_refined(_free(plate_with_hole.problem(8), motion), times)


class _OfPolygon:
    """References of polygons that are seen: where nodes slide along a curve, each mesh is one of its own."""

    def __init__(self, nodes: int) -> None:
        self._nodes, self._known = nodes, dict[float, Reference]()

    def __call__(self, problem: ContactProblem) -> Reference:
        area = round(float(signed_areas(problem.mesh.p, problem.triangles).sum()), 10)
        if area not in self._known:
            self._known[area] = reference(problem, max(self._nodes, 4 * problem.mesh.p.shape[1]))
        return self._known[area]

    def energy(self, problem: ContactProblem) -> float:
        """Error of the energy on the polygon of a mesh."""
        return energy(problem) - self(problem).limit

    def local(self, problem: ContactProblem) -> np.ndarray:
        """(elements,) half the squared energy norm of the error."""
        return local_errors(problem, self(problem))

    def norm(self, problem: ContactProblem) -> float:
        """Half the squared energy norm of the error."""
        return float(self.local(problem).sum())


def _hertz(n: int) -> ContactProblem:
    # the arc is held, so that the polygon is that of the mesh as given
    return _free(hertz.problem(n), Motion(None, pinned=("arc", "top")))


_PLATE, _HERTZ = _OfPolygon(5_000), _OfPolygon(6_000)


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
        Case("plate", (0, 1), _plate, _PLATE.energy, _PLATE.local),
        Case("Hertz", (4, 8), _hertz, _HERTZ.norm, _HERTZ.local),
        _by_norm("Signorini", (10, 20), lambda n: _free(signorini.problem(n))),
    )
}
